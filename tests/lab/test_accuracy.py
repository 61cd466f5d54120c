"""The study of accuracy: its cases are what the protocol says, a stopped one goes on, and claims hold where figures say so."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.readme_accuracy import accuracy_tables, sizes_table
from tso_cli.cli import main
from tso_cli.errors import InputError
from tso_cli.evaluation.metrics import chamfer
from tso_cli.io.checkpoints import load_network, save_network
from tso_cli.io.meshes import read_mesh
from tso_cli.lab.studies import accuracy, accuracy_examples
from tso_cli.lab.studies.accuracy import AccuracyConfig, in_plane, study_accuracy
from tso_cli.lab.studies.accuracy_cases import KINDS, LEVELS, MASKS, CaseBuilder
from tso_cli.lab.studies.accuracy_summary import claims, summarise
from tso_cli.lab.studies.accuracy_variants import ABLATION, NETWORK, POINTS
from tso_cli.lab.studies.parts import shapes_of_part
from tso_cli.network import model as networks
from tso_cli.network.model import NetworkConfig, build_network
from tso_cli.refinement import RefineConfig, refine
from tso_cli.refinement.presets import BEST
from tso_cli.render import RenderSettings, fitting_distance, ground_truth, normalise

from ..training import make_known, make_thin

MESHES = Path(__file__).parents[2] / "examples" / "meshes"
TRAIN = ["car/qreal_SUV", "car/qbasic_BasicCar", "car/qreal_NormalCar1", "chair/q19_Chair", "chair/q17_Chair"]
TEST = ["car/qreal_Cop", "chair/kfurn_chair"]
FEW = {name: replace(variant, config=replace(variant.config, steps=3)) for name, variant in POINTS.items()}


@pytest.fixture(scope="module")
def split(tmp_path_factory):
    path = tmp_path_factory.mktemp("split") / "split.json"
    path.write_text(json.dumps({"train": TRAIN, "test": TEST}))
    return path


@pytest.fixture(scope="module")
def builder(split):
    return CaseBuilder(MESHES, split, views=2, size=64, points=1024)


@pytest.fixture(scope="module")
def shapes(split):
    return {shape.category: shape for shape in shapes_of_part(MESHES, split)}


@pytest.fixture(scope="module")
def cars(builder, shapes):
    """The cases of the car, by kind."""
    return {kind: builder.cases(shapes["car"], kind) for kind in ("other", "near", "cut")}


@pytest.fixture
def checkpoint(tmp_path, monkeypatch):
    """A network of the paper's layers with few channels, untrained."""
    make_thin(monkeypatch)
    monkeypatch.setattr(networks, "LATENT", 8)
    path = tmp_path / "thin.safetensors"
    save_network(path, build_network(1024, seed=0), NetworkConfig(points=1024))
    return path


@pytest.fixture
def quick(monkeypatch):
    """All variants, of a few steps."""
    monkeypatch.setattr(accuracy, "variants_of", lambda kind, ablation: FEW)
    monkeypatch.setattr(accuracy_examples, "variants_of", lambda kind, ablation: FEW)


QUICK = AccuracyConfig(categories=("car", "chair"), kinds=("other",), views=1)


def on_mask(case) -> float:
    """Share of the truth that falls on its mask, give or take a pixel."""
    view = case.views[0]
    pixels = np.rint(view.camera.project(case.target)[0]).astype(int)
    inside = ((pixels >= 0) & (pixels < [view.camera.width, view.camera.height])).all(1)
    near = view.mask.copy()
    for axis in (0, 1):
        near = np.maximum(near, np.maximum(np.roll(near, 1, axis), np.roll(near, -1, axis)))
    return float((near[pixels[inside, 1], pixels[inside, 0]] > 0.5).mean())


def border(mask) -> bool:
    return bool((mask[[0, -1]] > 0.5).any() or (mask[:, [0, -1]] > 0.5).any())


@pytest.mark.parametrize("kind", ["other", "near"])
def test_the_start_is_the_training_shape_nearest_to_the_categorys_level(kind, cars):
    case = cars[kind][0]
    away = {}
    for name in TRAIN[:3]:
        mesh = normalise(read_mesh(MESHES / f"{name}.ply"))
        cloud = ground_truth(mesh, RenderSettings(), np.random.default_rng(0))[1]
        away[name] = abs(chamfer(cloud, case.target).chamfer - LEVELS[kind]["car"])
    # Another sampling of a shape is a little nearer or further.
    assert away[case.start] <= min(away.values()) + 1e-4


def test_a_chair_starts_from_the_most_similar_one(builder, shapes):
    case = builder.cases(shapes["chair"], "other")[0]
    levels = {}
    for name in TRAIN[3:]:
        mesh = normalise(read_mesh(MESHES / f"{name}.ply"))
        levels[name] = chamfer(ground_truth(mesh, RenderSettings(), np.random.default_rng(0))[1], case.target).chamfer
    assert case.start == min(levels, key=levels.get)


def test_a_training_shape_starts_from_one_of_another_type(builder, split, tmp_path):
    own = next(shape for shape in shapes_of_part(MESHES, split, "train", ["chair"]) if shape.name == TRAIN[4])
    assert builder.cases(own, "other")[0].start == TRAIN[3]
    # Two files of one type: `fg_ka50_black` and `fg_ka50_red`.
    for name, source in (("fg_ka50_black", TRAIN[4]), ("fg_ka50_red", TRAIN[4]), ("kfurn_chair", TRAIN[3])):
        (tmp_path / "chair").mkdir(exist_ok=True)
        shutil.copy(MESHES / f"{source}.ply", tmp_path / "chair" / f"{name}.ply")
    names = ["chair/fg_ka50_black", "chair/fg_ka50_red", "chair/kfurn_chair"]
    lists = tmp_path / "split.json"
    lists.write_text(json.dumps({"train": names}))
    black = shapes_of_part(tmp_path, lists, "train")[0]
    assert CaseBuilder(tmp_path, lists, 1, 64, 1024).cases(black, "other")[0].start == names[2]
    lists.write_text(json.dumps({"train": names[:2]}))
    with pytest.raises(InputError, match="fg_ka50_black: no chair of another type is in the list train"):
        CaseBuilder(tmp_path, lists, 1, 64, 1024).cases(black, "other")


def test_the_whole_object_is_seen_unless_it_is_to_be_cut(cars, shapes):
    vertices = normalise(read_mesh(shapes["car"].path)).vertices
    for case in cars["other"]:
        assert not any(border(view.mask) for view in case.views)
        assert on_mask(case) > 0.99
    for case in cars["cut"]:
        for view in case.views:
            assert border(view.mask)
            assert view.camera.t[2] == pytest.approx(0.75 * fitting_distance(vertices, view.camera))
        assert on_mask(case) > 0.99


def test_a_start_that_is_right_is_another_sampling_of_the_truth(builder, shapes):
    case = builder.cases(shapes["car"], "right")[0]
    assert case.start == "the truth"
    assert chamfer(case.initial, case.target).chamfer == pytest.approx(case.floor)
    assert not np.array_equal(case.initial, case.target)


def test_each_case_has_four_masks_and_no_two_cases_the_same_first(cars):
    first, second = cars["other"]
    assert len(first.views) == len(second.views) == MASKS
    assert first.views[1] is second.views[0]
    assert not np.array_equal(first.views[0].camera.R, second.views[0].camera.R)


def test_a_case_hangs_on_the_seed_alone_and_not_on_what_else_is_studied(cars, split, shapes):
    again, other = (CaseBuilder(MESHES, split, 2, 64, 1024, seed).cases(shapes["car"], "cut")[1] for seed in (0, 1))
    same = cars["cut"][1]
    np.testing.assert_array_equal(again.initial, same.initial)
    np.testing.assert_array_equal(again.views[0].mask, same.views[0].mask)
    assert not np.array_equal(other.views[0].mask, same.views[0].mask)


def test_the_floor_is_that_of_another_sampling_far_below_the_start(cars):
    case = cars["other"][0]
    before = chamfer(case.initial, case.target).chamfer
    assert 2e-4 < case.floor < 0.6 * before
    assert case.floor_dense < case.floor


def test_clouds_and_masks_are_as_large_as_asked_for_and_the_start_is_the_same_shape(split, shapes, cars):
    case = CaseBuilder(MESHES, split, 1, 96, 16384).cases(shapes["car"], "other")[0]
    assert case.initial.shape == case.target.shape == (16384, 3)
    assert case.views[0].mask.shape == (96, 96)
    assert case.start == cars["other"][0].start


def test_a_networks_case_is_in_the_axes_of_a_camera_that_stands_where_it_stood(split, shapes, checkpoint):
    network, about = load_network(checkpoint)
    builder = CaseBuilder(MESHES, split, 2, 64, 1024, 0, network, about)
    for case in builder.cases(shapes["car"], "network"):
        assert len(case.views) == MASKS
        assert case.views[0].mask.shape == (64, 64)
        # The truth, turned, falls on the mask of the crop, and on those of the other cameras: axes, K and t are right.
        for view in case.views:
            assert on_mask(replace(case, views=(view,))) > 0.99
        assert chamfer(case.target, case.dense).backward == 0.0
        left, top, right, bottom = case.views[0].box()
        pixels = case.views[0].camera.project(case.target)[0]
        assert np.abs([*(pixels.min(0) - [left, top]), *(pixels.max(0) - [right, bottom])]).max() < 2.0


def test_with_all_but_depth_right_only_depth_remains(cars):
    case = cars["other"][0]
    rotation = case.views[0].camera.R
    rng = np.random.default_rng(0)
    sideways = replace(case, initial=case.target + rng.normal(0.0, 2e-3, (1024, 1)) * rotation[0])
    assert in_plane(sideways) == pytest.approx(0.0, abs=1e-12)
    deeper = replace(case, initial=case.target + 1e-3 * rotation[2])
    assert in_plane(deeper) == pytest.approx(chamfer(deeper.initial, case.target).chamfer, rel=1e-6)


def test_a_study_refines_and_judges_every_case(split, quick):
    record = study_accuracy(MESHES, QUICK, split)
    assert record["complete"]
    assert [(case["category"], case["shape"]) for case in record["cases"]] == [("car", TEST[0]), ("chair", TEST[1])]
    for case in record["cases"]:
        assert set(case["variants"]) == set(FEW)
        for found in case["variants"].values():
            assert found["chamfer"] != case["before"]["chamfer"]
            assert 0.0 < found["f_score"] <= 1.0
            assert found["seconds"] > 0.0
            assert found["batch_seconds"] > 0.0
    json.dumps(record, allow_nan=False)


def test_a_stopped_study_goes_on_with_the_next_group_and_ends_alike(split, quick, monkeypatch):
    def timeless(record):
        return [
            (case["shape"], case["before"], {name: own["chamfer"] for name, own in case["variants"].items()})
            for case in record["cases"]
        ]

    whole = study_accuracy(MESHES, QUICK, split)
    kept = []

    def keep_one(record):
        kept.append(json.loads(json.dumps(record)))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study_accuracy(MESHES, QUICK, split, keep=keep_one)
    assert not kept[0]["complete"]
    assert kept[0]["claims"] == []
    judged = []
    true_judge = accuracy.judge_group
    monkeypatch.setattr(accuracy, "judge_group", lambda cases, *rest: judged.append(cases[0].shape) or true_judge(cases, *rest))
    resumed = study_accuracy(MESHES, QUICK, split, earlier=kept[0])
    assert judged == [TEST[1]]
    assert timeless(resumed) == timeless(whole)
    with pytest.raises(InputError, match="views 1, now it is 2"):
        study_accuracy(MESHES, replace(QUICK, views=2), split, earlier=kept[0])
    older = {**kept[0], "settings": {**kept[0]["settings"], "variants": {"other": ["paper", "best"]}}}
    with pytest.raises(InputError, match="the record to go on from has variants"):
        study_accuracy(MESHES, QUICK, split, earlier=older)
    with pytest.raises(InputError, match="'tso'"):
        study_accuracy(MESHES, QUICK, split, earlier={"study": "tso"})


def test_a_group_of_which_a_shape_is_missing_is_judged_anew_and_its_cases_stay_single(tmp_path, monkeypatch):
    path = tmp_path / "split.json"
    path.write_text(json.dumps({"train": TRAIN[3:] + TRAIN[:1], "test": ["car/qbasic_BasicCar", "car/qreal_Cop"]}))

    def named(cases, *_):
        return [{"kind": case.kind, "category": case.category, "shape": case.shape} for case in cases]

    monkeypatch.setattr(accuracy, "judge_group", named)
    monkeypatch.setattr(accuracy, "summarise", lambda cases: {})
    monkeypatch.setattr(accuracy, "claims", lambda cases, summary: [])
    config = replace(QUICK, categories=("car",))
    whole = study_accuracy(MESHES, config, path)
    assert len(whole["cases"]) == 2
    assert study_accuracy(MESHES, config, path, earlier={**whole, "cases": whole["cases"][:1]})["cases"] == whole["cases"]


def test_settings_that_cannot_be_are_refused(split):
    with pytest.raises(InputError, match="points is 100, expected 1024 to 16384"):
        study_accuracy(MESHES, replace(QUICK, points=100), split)
    with pytest.raises(InputError, match="'right', expected one of other, near, cut, network with ablation"):
        AccuracyConfig(kinds=("right",), ablation=True)
    with pytest.raises(InputError, match="checkpoint"):
        study_accuracy(MESHES, replace(QUICK, kinds=("network",)), split)
    with pytest.raises(InputError, match="kinds are near, expected some that chair have"):
        study_accuracy(MESHES, replace(QUICK, kinds=("near",), categories=("chair",)), split)
    with pytest.raises(InputError, match="'network' of training shapes, expected shapes that the network was not trained on"):
        AccuracyConfig(part="train", kinds=("network",))


def test_without_kinds_all_are_meant_that_there_are():
    assert AccuracyConfig().kinds == KINDS
    assert AccuracyConfig(part="train").kinds == ("other", "near", "cut", "right")
    assert AccuracyConfig(ablation=True).kinds == ("other", "near", "cut", "network")
    assert AccuracyConfig(part="train", ablation=True).kinds == ("other", "near", "cut")


def test_a_study_changes_one_ingredient_of_the_preset_at_a_time(cars):
    case = cars["other"][0]

    def moved(config):
        return refine(case.initial, case.views[0], config=replace(config, steps=6)).points

    plain = moved(RefineConfig())
    np.testing.assert_array_equal(moved(RefineConfig(coarse_to_fine=BEST)), plain)
    changed = {name: variant for name, variant in ABLATION.items() if variant.config.coarse_to_fine is not BEST}
    assert len(changed) == 13
    for name, variant in changed.items():
        recipe = variant.config.coarse_to_fine
        differing = {key for key, value in vars(recipe).items() if value != getattr(BEST, key)}
        no_prior = {"least_prior_weight", "most_prior_weight", "prior_weight"}
        assert len(differing) == 1 or differing in (no_prior, {"truncated_prior", "unobserved_motion"}), name
        # A far start is held by the least anchor in any case; a car has no thin parts, is seen whole, and its points lie
        # evenly; the other rows show at once.
        if differing & {"stages", "per_cloud_adam"}:
            assert np.abs(moved(variant.config) - plain).max() > 1e-4, name


def fake(kind: str, category: str, number: int, ratios: dict[str, float], before: float = 1e-3) -> dict:
    """A case with nothing but Chamfer in its figures."""

    def judged(value: float) -> dict:
        return {"chamfer": value, "dense": value, "f_score": 0.5, "emd": None}

    rest = {"iou_before": 0.5, "iou": 0.6, "mirrored": False, "seconds": 0.1, "batch_seconds": 0.1}
    start = {**judged(before), "floor": 0.2 * before, "floor_dense": 0.1 * before, "in_plane": 0.4 * before}
    return {
        "kind": kind,
        "category": category,
        "shape": f"{category}/{number // 2}",
        "view": number % 2,
        "before": start,
        "variants": {name: {**judged(ratio * before), **rest} for name, ratio in ratios.items()},
    }


GOOD = dict(zip(POINTS, (0.95, 0.35, 0.55, 0.25, 0.2), strict=True))


def held(cases: list[dict]) -> dict[str, bool]:
    return {claim["claim"]: claim["holds"] for claim in claims(cases, summarise(cases))}


def test_the_summary_tells_ratio_excess_and_share_made_worse():
    cases = [
        fake("other", "car", i, {"best": ratio}, before)
        for i, (ratio, before) in enumerate([(0.5, 1e-3), (1.1, 3e-3), (1.02, 1e-3)])
    ]
    group = summarise(cases)["other"]["car"]
    own = group["variants"]["best"]
    assert (group["shapes"], group["cases"]) == (2, 3)
    assert own["mean_ratio"] == pytest.approx((0.5 + 1.1 + 1.02) / 3, rel=1e-4)
    assert (own["worse"], own["worse_by_5"], own["worst_ratio"]) == (2, 1, pytest.approx(1.1))
    after, before = (0.5 + 3.3 + 1.02) / 3, 5.0 / 3
    assert own["chamfer_excess"] == pytest.approx((after - 0.2 * before) / (before - 0.2 * before), rel=1e-4)
    assert group["before"]["in_plane_ratio"] == pytest.approx(0.4)


def test_aims_and_gates_hold_only_where_the_figures_say_so():
    cases = [
        fake(kind, category, i, GOOD, {"other": 2e-3, "near": 5e-4}[kind])
        for kind in ("other", "near")
        for category in ("airplane", "car")
        for i in range(10)
    ]
    assert all(held(cases).values())
    assert len(held(cases)) == 6 + 1 + 2 + 1
    slightly = [*cases, fake("near", "car", 20, GOOD | {"best": 1.04}, 5e-4)]
    # One of 41 is more than 2 %, but within 5 % of its start.
    assert [claim for claim, holds in held(slightly).items() if not holds] == [
        "points mode, all starts, with one, two and four masks: under 2 % of cases are made worse, none by over 5 %"
    ]
    badly = [*cases * 3, fake("near", "car", 20, GOOD | {"best": 1.06}, 5e-4)]
    assert {claim.partition(":")[0] for claim, holds in held(badly).items() if not holds} == {
        "car near the truth",
        "points mode, all starts, with one, two and four masks",
    }
    missed = [fake("other", "airplane", i, GOOD | {"best, two masks": 0.31}) for i in range(10)]
    assert [claim for claim, holds in held(missed).items() if not holds] == [
        "airplane: best, two masks: mean ratio at most 0.30"
    ]


def test_what_starts_far_off_says_nothing_of_what_is_near():
    near = [fake("near", "car", 0, GOOD, 1.1e-3)]
    assert "car near the truth: mean ratio at most 1.00, worst at most 1.05" in held(near)
    assert not any("near" in claim for claim in held([fake("near", "car", 0, GOOD, 1.3e-3)]))


def test_what_starts_right_is_not_counted_with_what_must_not_get_worse():
    good = [fake("other", "car", i, GOOD) for i in range(10)]
    right = [fake("right", "car", i, GOOD | {"best": 1.2}) for i in range(10)]
    assert all(held([*good, *right]).values())
    assert held(right) == {}


def test_a_column_beside_the_papers_must_be_clearly_below_it():
    even = [fake("other", "sofa", i, GOOD | {"best, no symmetry": 0.65 if i % 4 < 2 else 1.22}) for i in range(12)]
    assert not next(holds for claim, holds in held(even).items() if "every column" in claim)


def test_the_network_variants_must_gain_twice_what_the_papers_settings_do():
    ratios = (
        dict.fromkeys(NETWORK, 0.95) | {name: 0.89 for name in NETWORK if name.endswith("best")} | {"latent, then points": 0.7}
    )
    cases = [fake("network", "car", i, ratios) for i in range(4)]
    assert all(held(cases).values())
    failing = [fake("network", "car", i, ratios | {"encoder, best": 0.91, "latent, then points": 0.76}) for i in range(4)]
    assert [holds for claim, holds in held(failing).items() if "made worse" not in claim] == [False, False]


def test_network_modes_are_held_to_making_few_cases_worse_by_a_claim_of_their_own():
    good = dict.fromkeys(NETWORK, 0.9)
    cases = [fake("network", "car", i, good | {"latent, then points": 1.01 if i == 0 else 0.9}) for i in range(20)]
    few = {claim.partition(":")[0]: holds for claim, holds in held(cases).items() if "made worse" in claim}
    assert few == {
        "points mode, all starts, with one, two and four masks": True,
        "network modes, and points mode after them": True,
    }
    badly = [*cases, fake("network", "car", 21, good | {"encoder, best": 1.06})]
    assert not next(holds for claim, holds in held(badly).items() if "network modes" in claim)


def test_the_tables_of_the_page_can_be_made_of_a_record():
    cases = [fake(kind, "car", i, GOOD) for kind in ("other", "near") for i in range(4)]
    settings = {"ablation": False, "shapes": ["car/a", "car/b"], "part": "test", "categories": ["car"], "views": 2, "size": 64}
    settings |= {"points": 1024, "seed": 0, "device": "cpu"}
    record = {"settings": settings, "summary": summarise(cases), "cases": cases}
    tables = accuracy_tables(record)
    assert set(tables) == {"other", "near", "ratios", "bounds", "settings"}
    assert "| car, 1.0 | 0.95, 0.10 s | 0.35, 0.10 s |" in tables["ratios"]
    assert "| 0 of 4, 0.35 |" in tables["ratios"]
    record["settings"]["ablation"] = True
    ablation = accuracy_tables(record)["ablation"]
    assert "| best | 0.35 (0 %, 0.35) | 0.35 (0 %, 0.35) |" in ablation
    assert "| the best of all | 0.20 | 0.20 |" in ablation


def test_sizes_are_compared_by_the_views_that_all_records_have():
    def record(points, size, cases):
        return {"settings": {"points": points, "size": size}, "summary": summarise(cases), "cases": cases}

    small = record(1024, 64, [fake("other", "car", i, GOOD | {"best": 0.3 + 0.2 * (i % 2)}) for i in range(4)])
    for best, gains in ((0.3, "yes"), (0.31, "**no**")):
        finer = record(1024, 256, [fake("other", "car", i, GOOD | {"best": 0.9 if i == 3 else 0.4}) for i in (0, 2, 3)])
        large = record(16384, 256, [fake("other", "car", i, GOOD | {"best": best}) for i in (0, 2)])
        row = f"| car, 2 | best | 0.300, worst 0.30 | 0.400, worst 0.40 | {best:.3f}, worst {best:.2f} | {gains} |"
        assert row in sizes_table(small, finer, large)


def tso(*arguments) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    return stopped.value.code


def test_the_command_writes_record_chart_and_pictures_and_goes_on_from_the_record(split, quick, tmp_path, capsys, monkeypatch):
    make_known(monkeypatch)
    output, pictures = tmp_path / "accuracy.json", tmp_path / "cases.png"
    arguments = ["lab", "accuracy", "--meshes", MESHES, "--split", split, "--category", "car", "--kind", "near", "--views", 1]
    assert tso(*arguments, "-o", output, "--pictures", pictures) == 0
    out = capsys.readouterr().out
    assert "made worse" in out
    record = json.loads(output.read_text())
    assert record["complete"]
    assert len(output.read_text().splitlines()[-2]) > 500  # a case a line
    for path in (output.with_suffix(".png"), pictures):
        with Image.open(path) as picture:
            assert min(picture.size) > 100
    assert tso(*arguments, "-o", output) == 2
    assert "exists" in capsys.readouterr().err
    assert tso(*arguments, "-o", output, "--resume", "--json") == 0
    assert json.loads(capsys.readouterr().out)["cases"] == record["cases"]
