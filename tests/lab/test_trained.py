"""The studies that train networks: what they measure, how they go on, what they conclude."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tso_cli.cli import main
from tso_cli.errors import InputError
from tso_cli.lab.packing import pack, unpack
from tso_cli.lab.studies import affinity, departures, failures, material, supervision, trained, views, weight
from tso_cli.lab.studies.judging import Predicted, camera_axes, judge, object_axes, predict
from tso_cli.lab.studies.material import ALL, Material, Source
from tso_cli.lab.studies.mean_shape import MEAN_SHAPE, constant_answer, pair_chamfer
from tso_cli.lab.studies.trained import Budget, Keeping, study_networks
from tso_cli.render import look_at
from tso_cli.train.batches import Draw, assemble
from tso_cli.train.data import TrainingData

from ..training import box_surface, make_objects, make_thin

MESHES = Path(__file__).parents[2] / "examples" / "meshes"
SPLIT = {
    "train": [
        "airplane/qplane_SmallPlane",
        "airplane/qplane_Private_plane",
        "car/qreal_Cop",
        "car/qreal_SUV",
        "chair/q17_Chair",
        "chair/kfurn_chair",
    ],
    "test": ["airplane/qplane_Military_Airplane", "car/qreal_NormalCar1", "chair/q19_Chair"],
}
BUDGET = Budget(steps=2, batch_size=2)


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thin networks, few and small pictures."""
    make_thin(monkeypatch)
    monkeypatch.setattr(material, "TRAINING_VIEWS", 8)
    monkeypatch.setattr(material, "TEST_VIEWS", 5)
    monkeypatch.setattr(material, "SIZE", 32)


@pytest.fixture(scope="module")
def split_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("split") / "split.json"
    path.write_text(json.dumps(SPLIT))
    return path


@pytest.fixture
def source(split_file: Path) -> Source:
    return Source(MESHES, split_file, categories=("car",))


def study(source: Source, keeping: Keeping | None = None, report: Any = None, budget: Budget = BUDGET) -> dict[str, Any]:
    settings = [setting for setting in views.settings(source.categories) if not (setting.constant or setting.repeat)][:3]
    return study_networks("views", source, budget, settings, lambda runs: {"claims": []}, None, keeping, report)


def without_times(record: dict[str, Any]) -> dict[str, Any]:
    return {**record, "runs": [{**run, "seconds": 0.0} for run in record["runs"]]}


def test_every_setting_gets_the_same_budget_and_a_network_of_its_own(source):
    record = study(source)
    assert [run["setting"] for run in record["runs"]] == ["V = 1", "V = 2", "V = 3"]
    assert {(run["steps"], run["batch_size"], run["seed"]) for run in record["runs"]} == {(2, 2, 0)}
    assert len({run["judged"]["car"]["plain"]["chamfer"] for run in record["runs"]}) == 3
    assert record["complete"] and record["settings"]["shapes"] == {"car": {"training": 2, "judged": 1}}


def test_an_interrupted_study_goes_on_with_the_network_it_had_not_trained(source):
    whole = study(source)
    kept: list[dict[str, Any]] = []

    def stop(what: str, done: int, total: int) -> None:
        if what.startswith("3 of 3"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study(source, Keeping(keep=kept.append), stop)
    assert [(len(record["runs"]), record["complete"]) for record in kept] == [(0, False), (1, False), (2, False)]
    trained_again: list[str] = []
    earlier = json.loads(json.dumps(kept[-1]))
    resumed = study(source, Keeping(earlier), lambda what, done, total: trained_again.append(what))
    assert not any(what.startswith(("1 of", "2 of")) for what in trained_again)
    assert without_times(resumed) == without_times(whole)


def test_an_interrupted_network_goes_on_where_it_was_and_its_state_goes_away(source, tmp_path, monkeypatch):
    budget = Budget(steps=4, batch_size=2)
    whole = study(source, budget=budget)
    monkeypatch.setattr(trained, "SAVE_EVERY", 1)
    unfinished = tmp_path / "views.unfinished.safetensors"
    steps: list[int] = []

    def stop(what: str, done: int, total: int) -> None:
        if what.startswith("1 of 3") and done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study(source, Keeping(unfinished=unfinished), stop, budget)
    assert unfinished.exists()
    resumed = study(
        source, Keeping(keep=lambda record: None, unfinished=unfinished),
        lambda what, done, total: steps.append(done) if what.startswith("1 of 3") else None, budget,
    )  # fmt: skip
    assert steps == [3, 4]
    assert without_times(resumed) == without_times(whole)
    assert not list(tmp_path.iterdir())


def test_a_record_of_other_settings_is_not_gone_on_from(source):
    record = study(source)
    with pytest.raises(InputError, match="steps 2, now it is 3"):
        study(source, Keeping(record), budget=Budget(steps=3, batch_size=2))
    with pytest.raises(InputError, match="expected 'views'"):
        study(source, Keeping({**record, "study": "lambda"}))
    with pytest.raises(InputError, match="seed"):
        study(source, Keeping({**record, "settings": {**record["settings"], "seed": 1}}))


def test_training_and_judged_shapes_are_those_of_their_lists(split_file):
    shapes = Material(Source(MESHES, split_file, categories=("car", "chair"), limit=1))
    assert [item.name for item in shapes.data("car", True).objects] == ["car/qreal_Cop"]
    assert [item.name for item in shapes.data(ALL, False).objects] == ["car/qreal_NormalCar1", "chair/q19_Chair"]
    dense = shapes.data("car", True, dense=True)
    assert dense.target(0).shape == (material.DENSE, 3)
    np.testing.assert_allclose(np.ptp(dense.target(0), axis=0), np.ptp(shapes.data("car", True).target(0), axis=0), atol=0.02)


def test_the_papers_protocol_hides_scale_and_place_and_the_plain_one_does_not():
    cloud = box_surface(np.array([1.0, 0.5, 0.7]), 500, np.random.default_rng(0))
    shape = Predicted(0, "a", "box", np.stack([cloud * 0.5 + 0.1]), np.stack([cloud]), "canonical")
    judged = judge([shape])["box"]
    assert judged["capnet"]["chamfer"] == pytest.approx(0.0, abs=1e-12)
    assert judged["plain"]["chamfer"] > 0.01
    assert judged["plain"]["chamfer"] == judged["plain"]["forward"] + judged["plain"]["backward"]


def test_forward_is_what_the_prediction_fails_to_cover():
    cloud = box_surface(np.array([1.0, 0.5, 0.7]), 500, np.random.default_rng(0))
    half = cloud[cloud[:, 0] < 0.0]
    judged = judge([Predicted(0, "a", "box", half[None], cloud[None], "canonical")])["box"]["plain"]
    assert judged["backward"] == 0.0 < judged["forward"]


@pytest.mark.parametrize("frame", ["view", "canonical"])
def test_predictions_turn_back_into_the_axes_of_object_and_camera(frame):
    data = TrainingData(make_objects(1, 2), "a box")
    camera = data.objects[0].views[1].camera
    predicted = assemble(data, [Draw(0, 1)], frame).targets[0].astype(np.float64)
    np.testing.assert_allclose(object_axes(predicted, camera, frame), data.target(0), atol=1e-6)
    np.testing.assert_allclose(camera_axes(predicted, camera, frame), data.target(0) @ camera.R.T, atol=1e-6)


def test_a_point_two_pixels_off_the_mask_is_an_outlier_and_one_at_its_edge_is_not():
    mask = np.zeros((20, 20), np.float32)
    mask[5:10, 5:10] = 1.0
    pixels = np.array([[7.0, 7.0], [10.4, 7.0], [11.2, 7.0], [-30.0, 7.0], [np.nan, np.nan]])
    assert affinity.outliers(pixels, mask).tolist() == [False, False, True, True, True]


def test_the_truth_has_no_outliers_and_a_blown_up_one_has_many(split_file):
    data = Material(Source(MESHES, split_file, categories=("car",))).data("car", False)
    truth = np.stack([data.target(0).astype(np.float64)] * 4)
    shares = [
        affinity.measure([Predicted(0, "car/a", "car", truth * scale, truth, "canonical")], data)["outliers"]["car"]
        for scale in (1.0, 1.5)
    ]
    assert shares[0] < 0.01
    assert shares[1] > 0.2


def plane(nose_at: float, along: int) -> np.ndarray:
    """A fuselage 1 long and 0.1 wide, wings of 0.8 in its middle, a tail of 0.3; the nose at -0.5 or 0.5."""
    rng = np.random.default_rng(0)
    around = rng.uniform(0, 2 * np.pi, 3000)
    body = np.stack([rng.uniform(-0.5, 0.5, 3000), 0.05 * np.sin(around), 0.05 * np.cos(around)], axis=1)
    wings = np.stack([rng.uniform(-0.1, 0.1, 1500), np.zeros(1500), rng.uniform(-0.4, 0.4, 1500)], axis=1)
    tail = np.stack([rng.uniform(0.4, 0.5, 300), np.zeros(300), rng.uniform(-0.15, 0.15, 300)], axis=1)
    cloud = np.concatenate([body, wings, tail])
    cloud[:, 0] *= -2.0 * nose_at
    return cloud if along == 0 else cloud[:, ::-1]


@pytest.mark.parametrize("nose_at", [-0.5, 0.5])
@pytest.mark.parametrize("along", [0, 2])
def test_the_sizes_of_an_aeroplane_are_found_whichever_way_it_points(nose_at, along):
    true = plane(nose_at, along)
    assert failures.aeroplane_sizes(true, true) == pytest.approx({"body_width": 1, "body_height": 1, "span": 1, "length": 1})
    squeezed = true * np.where(np.arange(3) == 2 - along, 0.5, 1.0)
    found = failures.aeroplane_sizes(squeezed, true)
    assert found == pytest.approx({"body_width": 0.5, "body_height": 1, "span": 0.5, "length": 1}, abs=1e-6)


def test_only_the_body_is_narrow_when_only_the_body_is_squeezed():
    true = plane(-0.5, 0)
    thin = true.copy()
    thin[np.abs(thin[:, 2]) <= 0.05, 2] *= 0.6
    found = failures.aeroplane_sizes(thin, true)
    assert found["body_width"] == pytest.approx(0.6, abs=0.01)
    assert found["span"] > 0.95
    assert np.isnan(failures.aeroplane_sizes(true[true[:, 0] > 0.0], true)["body_width"])


def test_a_cloud_stretched_along_the_line_of_sight_errs_in_depth():
    true = box_surface(np.array([0.8, 0.4, 1.0]), 2000, np.random.default_rng(0))
    camera = look_at(0.0, 0.0, 2.0, (64, 64))
    deep = camera_axes(true * [1.0, 1.0, 1.4], camera, "canonical")
    found = failures.depth_errors(deep, true @ camera.R.T)
    assert found["extent"] == pytest.approx(1.4, abs=0.01)
    assert found["depth"] > 3.0 * found["across"]
    wide = failures.depth_errors(camera_axes(true * [1.4, 1.0, 1.0], camera, "canonical"), true @ camera.R.T)
    assert wide["across"] > wide["depth"]


def test_packed_arrays_come_back_to_half_a_step():
    values = np.random.default_rng(0).uniform(-3.0, 70.0, (5, 2))
    np.testing.assert_allclose(unpack(pack(values, 1 / 32)), values, atol=1 / 64)
    mask = np.linspace(0.0, 1.0, 12).reshape(3, 4)
    packed = json.loads(json.dumps(pack(mask, 1 / 255)))
    assert packed["type"] == "uint8"
    np.testing.assert_allclose(unpack(packed), mask, atol=1 / 510)
    assert unpack(pack(np.array([-1.0, 2.0]), 1.0)).tolist() == [-1.0, 2.0]
    assert unpack(pack(np.array([np.nan, 1e9]), 0.5)).tolist() == [16383.5, 16383.5]


def fabricated(setting: str, category: str, chamfer: float, **more: Any) -> dict[str, Any]:
    measured = {"forward": chamfer / 2000, "backward": chamfer / 2000, "chamfer": chamfer / 1000}
    return {"setting": setting, "category": category, "judged": {category: {"capnet": measured, "plain": measured}}, **more}


def held(record: dict[str, Any]) -> list[bool]:
    return [claim["holds"] for claim in record["claims"]]


def test_conclusions_follow_from_the_figures():
    names = (supervision.POINTS, supervision.MASKS, supervision.DISCRETISED, supervision.LIN, MEAN_SHAPE)
    runs = [fabricated(name, "car", value) for name, value in zip(names, (2.0, 2.8, 4.0, 3.0, 3.05), strict=True)]
    assert held(supervision.conclude(runs)) == [True, True, True, True]
    # One category that fails is enough, whatever the mean of all says.
    chairs = [fabricated(name, "chair", 9.0 * value) for name, value in zip(names, (2.0, 2.8, 4.0, 3.0, 3.05), strict=True)]
    runs[1] = fabricated(supervision.MASKS, "car", 3.1)
    record = supervision.conclude([*chairs, *runs])
    assert held(record) == [True, False, False, False]
    assert record["claims"][1]["found"] == "chair 25.20 against 27.45; car 3.10 against 3.05, not there"

    by_count = dict(zip(views.COUNTS, (4.0, 2.0, 2.1, 2.0, 2.0, 2.0, 2.1), strict=True))
    runs = [fabricated(f"V = {n}", "car", value) for n, value in by_count.items()] + [fabricated(MEAN_SHAPE, "car", 5.0)]
    assert held(views.conclude(runs)) == [True, True, True]
    # One seed of two masks that is no better than one of one mask is enough to doubt it.
    record = views.conclude([*runs, fabricated("V = 2, seed + 1", "car", 4.1), fabricated("V = 1, seed + 1", "car", 5.0)])
    assert held(record) == [False, False, True]
    assert record["summary"]["car"]["2"] == pytest.approx(3.05) and record["seeds"]["car"]["2"] == pytest.approx([2.0, 4.1])
    runs[-1] = fabricated(MEAN_SHAPE, "car", 3.9)
    assert held(views.conclude(runs)) == [True, True, False]

    runs = [fabricated(setting.name, "chair", 5.0 + i) for i, setting in enumerate(weight.settings(["chair"]))]
    assert held(weight.conclude(runs)) == [False, False]
    runs = [fabricated(run["setting"], "chair", 1.0 if run["setting"].endswith(", 0.0001") else 5.0) for run in runs]
    assert held(weight.conclude(runs)) == [True, True]

    runs = [fabricated(s.name, "car", 2.0 + 0.1 * s.repeat) for s in departures.settings(["car"])]
    record = departures.conclude(runs)
    assert record["seeds"]["car"] == pytest.approx([2.0, 2.1, 2.2, 2.0])
    assert record["summary"][departures.AS_IS]["car"] == pytest.approx(2.075)
    assert set(record["summary"]) == {MEAN_SHAPE, departures.AS_IS, *departures.WHY}


def test_the_failures_show_where_the_figures_say_so():
    def sizes(width: float) -> dict[str, Any]:
        return {"aeroplanes": {"body_width": width, "body_height": 1.0, "span": 1.0, "length": 1.0}}

    def errors(depth: float) -> dict[str, Any]:
        return {"cars": {"depth": depth, "across": 1e-3, "extent": 1.0}}

    planes = [
        fabricated(failures.ALONE_WIDE, "airplane", 2.0, **sizes(0.8)),
        fabricated(failures.ALONE, "airplane", 2.0, **sizes(0.95)),
    ]
    cars = [fabricated(failures.ONE, "car", 3.0, **errors(4e-3)), fabricated(failures.FOUR, "car", 2.0, **errors(1e-3))]
    assert held(failures.conclude(planes + cars)) == [True, True, True]
    planes[1] = fabricated(failures.ALONE, "airplane", 2.0, **sizes(0.7))
    planes[0] = fabricated(failures.ALONE_WIDE, "airplane", 2.0, **sizes(1.2))
    cars[0] = fabricated(failures.ONE, "car", 3.0, **errors(0.9e-3))
    assert held(failures.conclude(planes + cars)) == [False, False, False]


def test_the_failures_are_asked_of_aeroplanes_or_cars_alone(split_file, tmp_path, capsys):
    output = tmp_path / "failures.json"
    with pytest.raises(SystemExit) as stopped:
        main(["lab", "failures", "--meshes", str(MESHES), "--split", str(split_file), "--category", "chair", "-o", str(output)])
    assert stopped.value.code == 2
    assert "the failures are of airplane and car, found chair, expected one of the two" in capsys.readouterr().err
    assert not output.exists()


def test_the_answer_without_a_network_is_one_cloud_for_all_and_better_than_any_shape_alone(source):
    data = Material(source)
    training, judged = data.data("car", True), data.data("car", False)
    answers = constant_answer(training, judged, "canonical")
    assert len({shape.points.tobytes() for shape in answers}) == 1 and answers[0].points.shape == (4, 1024, 3)
    own = [training.target(i) for i in range(len(training.objects))]
    mean = answers[0].points[0].astype(np.float32)
    alone = [np.mean([pair_chamfer(one, other) for other in own]) for one in own]
    assert np.mean([pair_chamfer(mean, other) for other in own]) < min(alone)
    turned = constant_answer(training, judged, "view")
    assert not np.allclose(turned[0].points, answers[0].points)
    np.testing.assert_array_equal(turned[0].points[0], turned[0].points[1])


@pytest.mark.parametrize("name", ["supervision", "views", "lambda", "affinity", "failures", "departures"])
def test_each_command_writes_its_record_and_chart_and_says_what_holds(name, split_file, tmp_path, capsys):
    output = tmp_path / f"{name}.json"
    arguments = ["lab", name, "--meshes", str(MESHES), "--split", str(split_file), "--steps", "2", "--batch-size", "3"]
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "-o", str(output)])
    printed = capsys.readouterr().out
    assert stopped.value.code == 0, printed
    assert ("holds: " in printed or "does not hold: " in printed) == (name != "departures")
    assert "2 steps of 3" in printed and "seed 0" in printed and "canonical frame" in printed
    record = json.loads(output.read_text())
    assert record["complete"] and len(record["runs"]) == len(record["settings"]["networks"])
    with Image.open(output.with_suffix(".png")) as chart:
        assert chart.size[0] > 600
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{name}.json", f"{name}.png"]
    # complete already: nothing is trained, the table is printed again
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "-o", str(output), "--resume"])
    assert stopped.value.code == 0
    assert capsys.readouterr().out == printed


def test_unusable_input_is_one_line(split_file, tmp_path, capsys):
    def fails(*arguments: str) -> str:
        with pytest.raises(SystemExit) as stopped:
            main(["lab", "views", *arguments])
        assert stopped.value.code == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        return error

    meshes = ["--meshes", str(MESHES), "--split", str(split_file)]
    assert "boat" in fails(*meshes, "--category", "boat")
    assert "expected its name after -o" in fails(*meshes, "--resume")
    (tmp_path / "other.json").write_text(json.dumps({"study": "points"}))
    assert "expected 'views'" in fails(*meshes, "--resume", "-o", str(tmp_path / "other.json"))
    absent = tmp_path / "absent.json"
    absent.write_text(json.dumps({"train": ["car/nothing"], "test": ["car/qreal_SUV"]}))
    assert "car/nothing" in fails("--meshes", str(MESHES), "--split", str(absent))


def test_a_network_predicts_from_the_first_views_in_its_frame(split_file):
    from tso_cli.network.model import build_network

    data = Material(Source(MESHES, split_file, categories=("car",))).data("car", False)
    (found,) = predict(build_network(64).eval(), data, "view")
    assert found.points.shape == (4, 64, 3)
    assert found.target.shape == (4, 1024, 3)
    assert not np.allclose(found.target[0], found.target[1])
