"""The study of accuracy: its rows are what they say, and targets are met where figures say so."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tso_cli.errors import InputError
from tso_cli.io.shipped import examples_folder
from tso_cli.prior.file import write_prior
from tso_cli.prior.network import initial
from tso_cli.refinement import refine
from tso_cli.scene.load import load_points_scene
from tso_lab.harm.scenes import gallery
from tso_lab.studies import accuracy
from tso_lab.studies.accuracy import conclude
from tso_lab.studies.cases import ABLATION, COMBINED, POINTS, with_prior
from tso_lab.studies.shapes import prior_hash


def test_a_case_of_a_kind_in_no_list_starts_as_the_warped_truth(tmp_path):
    name = "qreal_Cop.ply"
    shutil.copy(examples_folder() / "meshes" / "car" / name, tmp_path / name)
    (tmp_path / "index.csv").write_text(f"file,category\n{name},police car\n")
    scenes = gallery(None, None, "", tmp_path, 0)
    start = accuracy.unseen_case(scenes, 0, 3)
    (case,) = accuracy.refine_cases([start], {"best": POINTS["best"]})
    assert (case["kind"], case["category"], case["view"]) == ("unseen", "other kinds", 3)
    assert case["shape"] == f"police car/{tmp_path.name}/qreal_Cop"
    before = case["before"]
    assert before["floor"] < 0.3 * before["chamfer"]
    assert case["bound"] < before["chamfer"]
    assert len(start.views) == 4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["no mirror plane", "no learned prior", "one step"])
def test_an_ablation_changes_the_result(name):
    car = examples_folder() / "car"
    scene = load_points_scene(car / "initial.ply", car / "mask.png")
    plain, changed = (
        refine(scene.points, scene.view, config=ABLATION[variant].config).points
        for variant in ("best", name)
    )
    assert np.abs(changed - plain).max() > 1e-4


def test_the_default_preset_takes_the_prior_of_the_study_in_points_mode_alone():
    for variants in (POINTS, COMBINED, ABLATION):
        chosen = with_prior(variants, "mine.safetensors")
        assert list(chosen) == list(variants)
        for name, variant in chosen.items():
            for config in (variant.config, variant.then):
                smooth = config and (config.preset, config.mode) == ("best", "points")
                if not smooth:
                    assert config is None or config.prior is None
                elif name == "no learned prior":
                    assert config.prior == "none"
                else:
                    assert config.prior == "mine.safetensors"


def test_a_prior_is_known_by_its_weights_in_the_record(tmp_path):
    paths = [tmp_path / f"{name}.safetensors" for name in "abc"]
    for path, seed in zip(paths, (0, 0, 1), strict=True):
        write_prior(path, initial(seed), {"path": str(path)}, False)
    first, same, other = map(prior_hash, paths)
    assert first == same != other
    assert prior_hash(Path("none")) is None
    with pytest.raises(InputError, match="does not exist"):
        prior_hash(tmp_path / "absent.safetensors")


def fake(
    kind: str, category: str, number: int, ratios: dict[str, float], before: float = 1e-3
) -> dict:
    """A case with nothing but Chamfer in its figures."""
    rest = {"f_score": 0.5, "iou_before": 0.5, "iou": 0.6}
    names = {"kind": kind, "category": category, "shape": f"{category}/{number // 2}"}
    start = {"chamfer": before, "f_score": 0.5, "floor": 0.2 * before}
    variants = {name: {"chamfer": ratio * before, **rest} for name, ratio in ratios.items()}
    bound = {} if kind == "right" else {"bound": 0.3 * before}
    return {**names, "view": number % 2, "before": start, **bound, "variants": variants}


def several(count: int, *what, **more) -> list[dict]:
    return [fake(*what[:2], i, *what[2:], **more) for i in range(count)]


GOOD = dict(zip(POINTS, (0.95, 0.35, 0.55, 0.25, 0.2), strict=True))


def held(cases: list[dict]) -> dict[str, bool]:
    return {claim["claim"]: claim["holds"] for claim in conclude(cases)["claims"]}


def test_the_summary_is_of_the_cases_own_ratios():
    found = [(0.5, 1e-3), (1.1, 3e-3), (1.02, 1e-3)]
    cases = [fake("other", "car", i, {"best": r}, before) for i, (r, before) in enumerate(found)]
    group = conclude(cases)["summary"]["other"]["car"]
    row = group["variants"]["best"]
    assert (group["cases"], group["before"]["floor_ratio"]) == (3, pytest.approx(0.2))
    assert row["mean_ratio"] == pytest.approx((0.5 + 1.1 + 1.02) / 3, rel=1e-4)
    assert (row["worse"], row["worst_ratio"]) == (2, pytest.approx(1.1))


def test_the_bound_is_a_ratio_of_means():
    cases = [fake("other", "car", 0, GOOD), fake("other", "car", 1, GOOD, 3e-3)]
    cases[0]["bound"] = 0.7e-3
    (group,) = conclude(cases)["summary"]["other"].values()
    assert group["bound_ratio"] == pytest.approx((0.7 + 0.9) / (1.0 + 3.0))
    (aim,) = (claim for claim in conclude(cases)["claims"] if "car: best: ratio" in claim["claim"])
    assert "bound of one mask 0.40" in aim["found"]


def test_a_start_that_is_right_has_no_bound():
    assert "bound_ratio" not in conclude([fake("right", "car", 0, GOOD)])["summary"]["right"]["car"]


NEVER_WORSE = "points mode, all starts, with one, two and four masks"
NEAR = "car near the truth: mean ratio at most 1.00, worst at most 1.05"


def near(ratio: float) -> list[dict]:
    return [fake("near", "car", 20, GOOD | {"best": ratio}, 5e-4)]


@pytest.mark.parametrize(
    ("times", "more", "missed"),
    [
        (1, [], set()),
        # One of 41 is more than 2 %, but within 5 % of its start.
        (1, near(1.04), {NEVER_WORSE}),
        (3, near(1.06), {"car near the truth", NEVER_WORSE}),
        (
            1,
            several(99, "other", "airplane", GOOD | {"best, two masks": 0.32}),
            {"other, airplane: best, two masks"},
        ),
        # A start that is right can only get worse, and has targets of its own.
        (1, several(99, "right", "car", GOOD | {"best": 1.009}), set()),
        (1, several(9, "right", "car", GOOD | {"best": 1.04}), {"right, all: best"}),
    ],
)
def test_targets_are_met_only_where_the_figures_say_so(times, more, missed):
    cases = [
        case
        for kind, before in (("other", 2e-3), ("near", 5e-4))
        for category in ("airplane", "car")
        for case in several(10, kind, category, GOOD, before=before)
    ]
    aims, near_the_truth, clearly_worse = 4 + 1, 2, 2 + 1
    assert len(held(cases)) == aims + 1 + near_the_truth + clearly_worse + 1
    found = held([*cases * times, *more])
    assert {text.rpartition(": ")[0] for text, holds in found.items() if not holds} == missed


@pytest.mark.parametrize(("ratio", "count", "holds"), [(1.06, 50, False), (1.06, 51, True)])
def test_of_each_kind_of_start_few_cases_become_clearly_worse(ratio, count, holds):
    most = several(count - 1, "cut", "car", GOOD)
    found = held([*most, fake("cut", "car", count, GOOD | {"best": ratio})])
    assert found["cut: best: under 2 % of cases become worse by over 5 %"] == holds


@pytest.mark.parametrize(("count", "holds"), [(100, False), (101, True)])
def test_of_all_cases_still_fewer_become_clearly_worse(count, holds):
    most = several(50, "cut", "car", GOOD) + several(count - 51, "other", "car", GOOD)
    found = held([*most, fake("cut", "car", count, GOOD | {"best": 1.06})])
    assert found["all starts: best: under 1 % of cases become worse by over 5 %"] == holds


def test_an_aim_is_a_ratio_of_means():
    small, large = fake("other", "car", 0, GOOD | {"best": 0.9}), fake("other", "car", 1, GOOD)
    large["before"]["chamfer"] = 3e-3
    large["variants"]["best"]["chamfer"] = 0.69 * 3e-3
    found = held([small, large])
    assert found["other, car: best: ratio of means at most 0.75"]
    assert held([small, large, small])["other, car: best: ratio of means at most 0.75"] is False


def test_a_start_far_off_says_nothing_of_starts_near_the_truth():
    assert NEAR in held([fake("near", "car", 0, GOOD, 1.1e-3)])
    assert NEAR not in held([fake("near", "car", 0, GOOD, 1.3e-3)])
    assert not any("near" in text for text in held([fake("right", "car", 0, GOOD)]))


def test_a_column_must_be_clearly_below_the_papers():
    ratios = [0.65, 0.65, 1.22, 1.22] * 3
    even = [
        fake("other", "sofa", i, GOOD | {"best, no symmetry": ratio})
        for i, ratio in enumerate(ratios)
    ]
    assert not next(holds for text, holds in held(even).items() if "every column" in text)


@pytest.mark.parametrize(
    ("ablation", "header"),
    [(True, ["", "car, other", "car, near"]), (False, ["category", "variant", "other", "near"])],
)
def test_tables_have_a_row_a_variant_and_a_column_a_group(ablation, header):
    cases = [case for kind in ("other", "near") for case in several(4, kind, "car", GOOD)]
    summary = conclude(cases)["summary"]
    (table,) = accuracy.tables({"settings": {"ablation": ablation}, "summary": summary})
    assert list(table.header) == header
    assert [row[-2:] for row in table.rows if "best" in row] == [["0.35 (0, 0.35)"] * 2]
    assert [row[-2:] for row in table.rows if "bound" in row] == [["0.30"] * 2]
