"""The study of accuracy: its cases are what the protocol says, a stopped one goes on, and claims hold where figures say so."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tso_cli.errors import InputError
from tso_cli.evaluation.metrics import chamfer
from tso_cli.io.checkpoints import load_network
from tso_cli.io.meshes import read_mesh
from tso_cli.lab.studies import accuracy
from tso_cli.lab.studies.accuracy_cases import LEVELS, MASKS, CaseBuilder
from tso_cli.lab.studies.accuracy_claims import claims, summarise
from tso_cli.lab.studies.accuracy_variants import ABLATION, NETWORK, POINTS
from tso_cli.lab.studies.parts import shapes_of_part
from tso_cli.lab.study import Progress
from tso_cli.refinement import RefineConfig, refine
from tso_cli.refinement.presets import BEST
from tso_cli.render import RenderSettings, fitting_distance, ground_truth, normalise

from ..training import make_known
from .studying import MESHES, check_command, thin_checkpoint, tso, write_split

TRAIN = ["car/qreal_SUV", "car/qbasic_BasicCar", "car/qreal_NormalCar1", "chair/q19_Chair", "chair/q17_Chair"]
TEST = ["car/qreal_Cop", "chair/kfurn_chair"]
SUBSET = {
    name: replace(variant, config=replace(variant.config, steps=3))
    for name, variant in POINTS.items()
    if name in ("paper", "best", "best, two masks", "best, four masks", "best, no symmetry")
}


@pytest.fixture(scope="module")
def split(tmp_path_factory):
    return write_split(tmp_path_factory.mktemp("split"), train=TRAIN, test=TEST)


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
def study(split, monkeypatch):
    """The study of one view of car and chair with variants of three steps."""
    monkeypatch.setattr(accuracy, "variants_of", lambda kind, ablation: SUBSET)
    settings = {"part": "test", "limit": None, "views": 1, "size": 64, "points": 1024, "ablation": False, "seed": 0}
    settings |= {"device": "cpu", "kinds": ("other",), "categories": ("car", "chair"), "split": split, "pictures": None}

    def run(progress=None, **changes):
        return accuracy.run(progress or Progress(), meshes=MESHES, checkpoint=None, **{**settings, **changes})

    return run


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


def distances_of(names, target) -> dict[str, float]:
    """Chamfer distance of samplings of training shapes to a target."""
    meshes = {name: normalise(read_mesh(MESHES / f"{name}.ply")) for name in names}
    clouds = {name: ground_truth(mesh, RenderSettings(), np.random.default_rng(0))[1] for name, mesh in meshes.items()}
    return {name: chamfer(cloud, target).chamfer for name, cloud in clouds.items()}


@pytest.mark.slow
def test_the_start_is_the_training_shape_nearest_to_the_categorys_level_or_the_most_similar(builder, shapes, cars):
    for kind in ("other", "near"):
        case = cars[kind][0]
        away = {name: abs(d - LEVELS[kind]["car"]) for name, d in distances_of(TRAIN[:3], case.target).items()}
        # Another sampling of a shape is a little nearer or further.
        assert away[case.start] <= min(away.values()) + 1e-4
    case = builder.cases(shapes["chair"], "other")[0]
    distances = distances_of(TRAIN[3:], case.target)
    assert case.start == min(distances, key=distances.get)


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_start_that_is_right_is_another_sampling_of_the_truth_and_the_floor_its_distance(builder, shapes, cars):
    case = builder.cases(shapes["car"], "right")[0]
    assert case.start == "the truth"
    assert chamfer(case.initial, case.target).chamfer == pytest.approx(case.floor)
    assert not np.array_equal(case.initial, case.target)
    far = cars["other"][0]
    assert 2e-4 < far.floor < 0.6 * chamfer(far.initial, far.target).chamfer


@pytest.mark.slow
def test_a_case_depends_on_the_seed_alone(cars, split, shapes):
    first, same = cars["cut"]
    assert len(first.views) == len(same.views) == MASKS
    assert first.views[1] is same.views[0]
    again, other = (CaseBuilder(MESHES, split, 2, 64, 1024, seed).cases(shapes["car"], "cut")[1] for seed in (0, 1))
    np.testing.assert_array_equal(again.initial, same.initial)
    np.testing.assert_array_equal(again.views[0].mask, same.views[0].mask)
    assert not np.array_equal(other.views[0].mask, same.views[0].mask)


@pytest.mark.slow
def test_a_networks_case_is_in_the_axes_of_a_camera_that_stands_where_it_stood(split, shapes, tmp_path, monkeypatch):
    network, about = load_network(thin_checkpoint(tmp_path, monkeypatch, 1024))
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


@pytest.mark.slow
def test_a_stopped_study_goes_on_with_the_next_group_and_ends_alike(study, monkeypatch):
    def timeless(record):
        return [
            (case["shape"], case["before"], {name: row["chamfer"] for name, row in case["variants"].items()})
            for case in record["cases"]
        ]

    whole = study()
    assert whole["complete"]
    assert [(case["category"], case["shape"]) for case in whole["cases"]] == [("car", TEST[0]), ("chair", TEST[1])]
    for case in whole["cases"]:
        assert set(case["variants"]) == set(SUBSET)
        for row in case["variants"].values():
            assert row["chamfer"] != case["before"]["chamfer"]
            assert 0.0 < row["f_score"] <= 1.0
            assert row["seconds"] > 0.0
    json.dumps(whole, allow_nan=False)
    kept = []

    def keep_one(record):
        kept.append(json.loads(json.dumps(record)))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study(Progress(keep=keep_one))
    assert (kept[0]["complete"], kept[0]["claims"]) == (False, [])
    judged = []
    true_judge = accuracy.judge_group
    monkeypatch.setattr(accuracy, "judge_group", lambda cases, *rest: judged.append(cases[0].shape) or true_judge(cases, *rest))
    resumed = study(Progress(earlier=kept[0]))
    assert judged == [TEST[1]]
    assert timeless(resumed) == timeless(whole)


def test_settings_that_cannot_be_are_refused(study):
    with pytest.raises(InputError, match="points is 100, expected 1024 to 16384"):
        study(points=100)
    with pytest.raises(InputError, match="kinds are near, expected some that chair have"):
        study(kinds=("near",), categories=("chair",))


@pytest.mark.slow
def test_an_ablation_changes_one_ingredient_of_the_preset_at_a_time(cars):
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

    rest = {"f_score": 0.5, "iou_before": 0.5, "iou": 0.6, "seconds": 0.1}
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
    return {claim["claim"]: claim["holds"] for claim in claims(cases, summarise(cases))}


def test_the_summary_is_of_the_cases_own_ratios():
    cases = [
        fake("other", "car", i, {"best": ratio}, before)
        for i, (ratio, before) in enumerate([(0.5, 1e-3), (1.1, 3e-3), (1.02, 1e-3)])
    ]
    group = summarise(cases)["other"]["car"]
    row = group["variants"]["best"]
    assert (group["shapes"], group["cases"], group["before"]["floor_ratio"]) == (2, 3, pytest.approx(0.2))
    assert row["mean_ratio"] == pytest.approx((0.5 + 1.1 + 1.02) / 3, rel=1e-4)
    assert (row["worse"], row["worst_ratio"]) == (2, pytest.approx(1.1))


NEVER_WORSE = "points mode, all starts, with one, two and four masks"


def near(*ratios: float) -> list[dict]:
    return [fake("near", "car", 20 + i, GOOD | {"best": ratio}, 5e-4) for i, ratio in enumerate(ratios)]


@pytest.mark.parametrize(
    ("change", "missed"),
    [
        (lambda cases: cases, set()),
        # One of 41 is more than 2 %, but within 5 % of its start.
        (lambda cases: [*cases, *near(1.04)], {NEVER_WORSE}),
        (lambda cases: [*cases * 3, *near(1.06)], {"car near the truth", NEVER_WORSE}),
        (
            lambda cases: [fake("other", "airplane", i, GOOD | {"best, two masks": 0.31}) for i in range(10)],
            {"airplane: best, two masks"},
        ),
        # What starts right can only get worse, and is not counted.
        (lambda cases: [*cases, *(fake("right", "car", i, GOOD | {"best": 1.2}) for i in range(10))], set()),
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
    assert {text.rpartition(": ")[0] for text, holds in held(change(cases)).items() if not holds} == missed


def test_what_starts_far_off_says_nothing_of_what_is_near():
    assert "car near the truth: mean ratio at most 1.00, worst at most 1.05" in held([fake("near", "car", 0, GOOD, 1.1e-3)])
    assert not any("near" in text for text in held([fake("near", "car", 0, GOOD, 1.3e-3)]))
    assert held([fake("right", "car", 0, GOOD)]) == {}


def test_a_column_beside_the_papers_must_be_clearly_below_it():
    even = [fake("other", "sofa", i, GOOD | {"best, no symmetry": 0.65 if i % 4 < 2 else 1.22}) for i in range(12)]
    assert not next(holds for claim, holds in held(even).items() if "every column" in claim)


def test_network_variants_must_gain_twice_what_the_papers_settings_do_and_harm_few_cases():
    best = {name: 0.89 for name in NETWORK if name.endswith("best")}
    ratios = dict.fromkeys(NETWORK, 0.95) | best | {"latent, then points": 0.7}
    assert all(held([fake("network", "car", i, ratios) for i in range(4)]).values())
    failing = [fake("network", "car", i, ratios | {"encoder, best": 0.91, "latent, then points": 0.76}) for i in range(4)]
    assert [holds for text, holds in held(failing).items() if "made worse" not in text] == [False, False]
    good = dict.fromkeys(NETWORK, 0.9)
    cases = [fake("network", "car", i, good | {"latent, then points": 1.01 if i == 0 else 0.9}) for i in range(20)]
    harmed = {text.partition(":")[0]: holds for text, holds in held(cases).items() if "made worse" in text}
    assert harmed == {NEVER_WORSE: True, "network modes, and points mode after them": True}


def test_the_table_of_an_ablation_has_a_row_an_ingredient_and_a_column_a_kind():
    summary = summarise([fake(kind, "car", i, GOOD) for kind in ("other", "near") for i in range(4)])
    table = accuracy.tables({"settings": {"ablation": True}, "summary": summary})[0]
    assert table.header == ["", "car, other", "car, near"]
    assert ["best", "0.35 (0, 0.35)", "0.35 (0, 0.35)"] in table.rows
    shown = accuracy.tables({"settings": {"ablation": False}, "summary": summary})
    assert shown[0].rows[1][:7] == ["other", "car", 4, "best", 1.0, 0.35, 0.35]


@pytest.mark.slow
def test_the_command_writes_pictures_of_extreme_cases_and_goes_on_from_the_record(study, split, tmp_path, capsys, monkeypatch):
    make_known(monkeypatch)
    output, pictures = tmp_path / "accuracy.json", tmp_path / "cases.png"
    arguments = ["accuracy", "--meshes", MESHES, "--split", split, "--category", "car", "--kind", "near", "--views", 1]
    record = check_command(output, capsys, *arguments, "--pictures", pictures, words=("made worse", "floor"))
    assert record["complete"]
    assert len(output.read_text().splitlines()[-2]) > 500  # a case a line
    with Image.open(pictures) as picture:
        assert min(picture.size) > 100
    assert tso("lab", *arguments, "--pictures", pictures) == 2
    assert "exists" in capsys.readouterr().err
    assert tso("lab", *arguments, "-o", output, "--resume", "--json") == 0
    assert json.loads(capsys.readouterr().out)["cases"] == record["cases"]
