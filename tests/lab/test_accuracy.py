"""The study of accuracy: its rows are what they say, its summary is of the cases, and targets are met where figures say so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tso_cli.io.shipped import examples_folder
from tso_cli.lab.studies import accuracy
from tso_cli.lab.studies.accuracy import conclude
from tso_cli.lab.studies.refining import ABLATION, NETWORK, POINTS
from tso_cli.optimisation.presets import BEST
from tso_cli.refinement import RefineConfig, refine
from tso_cli.scene.load import load_points_scene

from ..training import make_known
from .studying import MESHES


@pytest.mark.slow
def test_an_ablation_changes_one_ingredient_of_the_preset_at_a_time():
    car = examples_folder() / "car"
    scene = load_points_scene(car / "initial.ply", car / "mask.png")

    def moved(config):
        return refine(scene.points, scene.view, config=replace(config, steps=6)).points

    plain = moved(RefineConfig())
    np.testing.assert_array_equal(moved(RefineConfig(coarse_to_fine=BEST)), plain)
    changed = {
        name: variant
        for name, variant in ABLATION.items()
        if variant.config.coarse_to_fine is not BEST
    }
    assert len(changed) == 14
    for name, variant in changed.items():
        recipe = variant.config.coarse_to_fine
        differing = {key for key, value in vars(recipe).items() if value != getattr(BEST, key)}
        no_prior = {"least_prior_weight", "prior_weight"}
        assert len(differing) == 1 or differing == no_prior, name
        # A far start has the least prior weight in any case; a car has no thin parts and is seen whole; the
        # other rows show at once.
        if differing & {"stages", "uniform_adam"}:
            assert np.abs(moved(variant.config) - plain).max() > 1e-4, name


def fake(
    kind: str, category: str, number: int, ratios: dict[str, float], before: float = 1e-3
) -> dict:
    """A case with nothing but Chamfer in its figures."""

    rest = {"f_score": 0.5, "iou_before": 0.5, "iou": 0.6}
    return {
        "kind": kind,
        "category": category,
        "shape": f"{category}/{number // 2}",
        "view": number % 2,
        "before": {"chamfer": before, "f_score": 0.5, "floor": 0.2 * before},
        "variants": {name: {"chamfer": ratio * before, **rest} for name, ratio in ratios.items()},
    }


GOOD = dict(zip(POINTS, (0.95, 0.35, 0.55, 0.25, 0.2), strict=True))


def held(cases: list[dict]) -> dict[str, bool]:
    return {claim["claim"]: claim["holds"] for claim in conclude(cases)["claims"]}


def test_the_summary_is_of_the_cases_own_ratios():
    cases = [
        fake("other", "car", i, {"best": ratio}, before)
        for i, (ratio, before) in enumerate([(0.5, 1e-3), (1.1, 3e-3), (1.02, 1e-3)])
    ]
    group = conclude(cases)["summary"]["other"]["car"]
    row = group["variants"]["best"]
    assert (group["cases"], group["before"]["floor_ratio"]) == (3, pytest.approx(0.2))
    assert row["mean_ratio"] == pytest.approx((0.5 + 1.1 + 1.02) / 3, rel=1e-4)
    assert (row["worse"], row["worst_ratio"]) == (2, pytest.approx(1.1))


NEVER_WORSE = "points mode, all starts, with one, two and four masks"


def near(*ratios: float) -> list[dict]:
    return [
        fake("near", "car", 20 + i, GOOD | {"best": ratio}, 5e-4) for i, ratio in enumerate(ratios)
    ]


@pytest.mark.parametrize(
    ("change", "missed"),
    [
        (lambda cases: cases, set()),
        # One of 41 is more than 2 %, but within 5 % of its start.
        (lambda cases: [*cases, *near(1.04)], {NEVER_WORSE}),
        (lambda cases: [*cases * 3, *near(1.06)], {"car near the truth", NEVER_WORSE}),
        (
            lambda cases: [
                fake("other", "airplane", i, GOOD | {"best, two masks": 0.31}) for i in range(10)
            ],
            {"airplane: best, two masks"},
        ),
        # What starts right can only get worse, and is not counted.
        (
            lambda cases: [
                *cases,
                *(fake("right", "car", i, GOOD | {"best": 1.2}) for i in range(10)),
            ],
            set(),
        ),
    ],
)
def test_targets_are_met_only_where_the_figures_say_so(change, missed):
    cases = [
        fake(kind, category, i, GOOD, {"other": 2e-3, "near": 5e-4}[kind])
        for kind in ("other", "near")
        for category in ("airplane", "car")
        for i in range(10)
    ]
    assert len(held(cases)) == 6 + 1 + 2 + 1
    assert {
        text.rpartition(": ")[0] for text, holds in held(change(cases)).items() if not holds
    } == missed


def test_what_starts_far_off_says_nothing_of_what_is_near():
    assert "car near the truth: mean ratio at most 1.00, worst at most 1.05" in held(
        [fake("near", "car", 0, GOOD, 1.1e-3)]
    )
    assert not any("near" in text for text in held([fake("near", "car", 0, GOOD, 1.3e-3)]))
    assert held([fake("right", "car", 0, GOOD)]) == {}


def test_a_column_beside_the_papers_must_be_clearly_below_it():
    even = [
        fake("other", "sofa", i, GOOD | {"best, no symmetry": 0.65 if i % 4 < 2 else 1.22})
        for i in range(12)
    ]
    assert not next(holds for claim, holds in held(even).items() if "every column" in claim)


def test_network_variants_must_gain_twice_what_the_papers_settings_do_and_harm_few_cases():
    best = {name: 0.89 for name in NETWORK if name.endswith("best")}
    ratios = dict.fromkeys(NETWORK, 0.95) | best | {"latent, then points": 0.7}
    assert all(held([fake("network", "car", i, ratios) for i in range(4)]).values())
    failing = [
        fake("network", "car", i, ratios | {"encoder, best": 0.91, "latent, then points": 0.76})
        for i in range(4)
    ]
    assert [holds for text, holds in held(failing).items() if "made worse" not in text] == [
        False,
        False,
    ]
    good = dict.fromkeys(NETWORK, 0.9)
    cases = [
        fake("network", "car", i, good | {"latent, then points": 1.01 if i == 0 else 0.9})
        for i in range(20)
    ]
    harmed = {
        text.partition(":")[0]: holds for text, holds in held(cases).items() if "made worse" in text
    }
    assert harmed == {NEVER_WORSE: True, "network modes, and points mode after them": True}


def test_the_table_of_an_ablation_has_a_row_an_ingredient_and_a_column_a_kind():
    summary = conclude(
        [fake(kind, "car", i, GOOD) for kind in ("other", "near") for i in range(4)]
    )["summary"]
    table = accuracy.tables({"settings": {"ablation": True}, "summary": summary})[0]
    assert table.header == ["", "car, other", "car, near"]
    assert ["best", "0.35 (0, 0.35)", "0.35 (0, 0.35)"] in table.rows
    shown = accuracy.tables({"settings": {"ablation": False}, "summary": summary})
    assert shown[0].rows[1][:7] == ["other", "car", 4, "best", 1.0, 0.35, 0.35]


@pytest.mark.slow
def test_the_command_draws_extreme_cases_and_overwrites_no_picture(
    tso, split, tmp_path, monkeypatch
):
    make_known(monkeypatch)
    quick = {
        name: replace(variant, config=replace(variant.config, steps=3))
        for name, variant in POINTS.items()
    }
    monkeypatch.setattr(accuracy, "variants_of", lambda kind, ablation: quick)
    arguments = [
        "accuracy",
        "--meshes",
        MESHES,
        "--split",
        split,
        "--category",
        "car",
        "--kind",
        "near",
        "--views",
        1,
    ]
    arguments += ["--pictures", tmp_path / "cases.png"]
    (case,) = tso("lab", *arguments, "--json").document["cases"]
    assert set(case["variants"]) == set(POINTS)
    for row in case["variants"].values():
        assert row["chamfer"] != case["before"]["chamfer"]
        assert 0.0 < row["f_score"] <= 1.0
    with Image.open(tmp_path / "cases.png") as picture:
        assert min(picture.size) > 100
    run = tso("lab", *arguments)
    assert run.code == 2
    assert "exists" in run.err
