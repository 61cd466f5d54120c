"""The studies that train networks: their mechanics, what they measure, and what they conclude."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tso_cli.evaluation.metrics import chamfer
from tso_cli.lab.studies import affinity, failures, judging, supervision
from tso_cli.lab.studies.judging import ALL, MEAN_SHAPE, Material, Predicted, constant_answer, judge
from tso_cli.lab.studies.trained import Comparison, Setting, masks
from tso_cli.lab.study import Progress
from tso_cli.render import look_at

from ..training import box_surface
from .studying import MESHES, holding, timeless

pytestmark = pytest.mark.usefixtures("small")


@pytest.fixture
def cars(split: Path) -> Material:
    return Material(MESHES, split, "test", ("car",))


def compare(split: Path, progress: Progress | None = None, **changes: Any) -> dict[str, Any]:
    """Three networks."""
    settings = [Setting(f"V = {count}", "car", masks("car", views=count)) for count in (1, 2, 3)]
    plan = Comparison(2, ("car",), lambda categories: settings).plan
    compared = replace(
        supervision.VIEWS, plan=plan, conclude=lambda cases: {}, tables=lambda record: []
    )
    options = {"meshes": MESHES, "part": "test", "categories": (), "limit": 32, "steps": None}
    options |= {"batch_size": 2, "seed": 0, "device": "cpu"}
    return compared.run(progress or Progress(), **{**options, "split": split, **changes})


@pytest.mark.slow
def test_every_setting_trains_its_own_network_and_an_interrupted_study_resumes_at_the_next(split):
    expected = compare(split, steps=4)
    assert (expected["settings"]["steps"], expected["settings"]["shapes"]) == (
        4,
        {"car": {"training": 3, "judged": 1}},
    )
    assert [case["setting"] for case in expected["cases"]] == ["V = 1", "V = 2", "V = 3"]
    assert len({case["judged"]["car"] for case in expected["cases"]}) == 3
    kept: list[dict[str, Any]] = []

    def stop(what: str, done: int, total: int) -> None:
        if what.startswith("2 of 3") and done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compare(split, Progress(stop, None, kept.append), steps=4)
    assert [(len(record["cases"]), record["complete"]) for record in kept] == [
        (0, False),
        (1, False),
    ]
    trained_again: list[str] = []
    progress = Progress(
        lambda what, done, total: trained_again.append(what[:6]), json.loads(json.dumps(kept[-1]))
    )
    assert timeless(compare(split, progress, steps=4)) == timeless(expected)
    assert {"2 of 3", "3 of 3"} == {what for what in trained_again if what.endswith(" of 3")}


def test_training_and_judged_shapes_are_those_of_their_lists(split):
    shapes = Material(MESHES, split, "test", ("car", "chair"), limit=1)
    assert [item.name for item in shapes.data("car", True).objects] == ["car/qreal_SUV"]
    assert [item.name for item in shapes.data(ALL, False).objects] == [
        "car/qbasic_RaceCar",
        "chair/kfurn_chairRounded",
    ]
    dense = shapes.data("car", True, dense=True)
    assert dense.target(0).shape == (judging.DENSE, 3)
    np.testing.assert_allclose(
        np.ptp(dense.target(0), axis=0),
        np.ptp(shapes.data("car", True).target(0), axis=0),
        atol=0.02,
    )


def test_networks_are_judged_under_the_papers_protocol_which_ignores_scale_and_place():
    cloud = box_surface(np.array([1.0, 0.5, 0.7]), 500, np.random.default_rng(0))
    half = cloud[cloud[:, 0] < 0.0]

    def judged(points: np.ndarray) -> dict[str, float]:
        return judge([Predicted(0, "box", points[None], cloud[None])])

    assert judged(cloud * 0.5 + 0.1) == {"box": pytest.approx(0.0, abs=1e-9)}
    assert judged(half * 0.5) == pytest.approx(judged(half))
    assert judged(half)["box"] > 1.0


def test_the_constant_answer_is_one_cloud_for_all_views_and_nearer_than_any_training_shape(cars):
    training, unseen = cars.data("car", True), cars.data("car", False)
    (answer,) = constant_answer(training, unseen)
    assert answer.points.shape == (4, 1024, 3)
    assert len({cloud.tobytes() for cloud in answer.points}) == 1
    targets = [training.target(i) for i in range(len(training.objects))]
    distances = [
        sum(chamfer(cloud, target).chamfer for target in targets)
        for cloud in (answer.points[0], *targets)
    ]
    assert np.argmin(distances) == 0


def test_a_point_two_pixels_off_the_mask_is_an_outlier_and_one_at_its_edge_is_not():
    mask = np.zeros((20, 20), np.float32)
    mask[5:10, 5:10] = 1.0
    pixels = np.array([[7.0, 7.0], [10.4, 7.0], [11.2, 7.0], [-30.0, 7.0], [np.nan, np.nan]])
    assert affinity.outliers(pixels, mask).tolist() == [False, False, True, True, True]


def plane(nose: float, along: int) -> np.ndarray:
    """A fuselage 1 long and 0.1 wide, wings of 0.8 in its middle, a tail of 0.3; its nose at -0.5 or 0.5."""
    rng = np.random.default_rng(0)
    around = rng.uniform(0, 2 * np.pi, 3000)
    body = np.stack(
        [rng.uniform(-0.5, 0.5, 3000), 0.05 * np.sin(around), 0.05 * np.cos(around)], axis=1
    )
    wings = np.stack(
        [rng.uniform(-0.1, 0.1, 1500), np.zeros(1500), rng.uniform(-0.4, 0.4, 1500)], axis=1
    )
    tail = np.stack(
        [rng.uniform(0.4, 0.5, 300), np.zeros(300), rng.uniform(-0.15, 0.15, 300)], axis=1
    )
    cloud = np.concatenate([body, wings, tail]) * [-2.0 * nose, 1.0, 1.0]
    return cloud if along == 0 else cloud[:, ::-1]


@pytest.mark.parametrize("nose", [-0.5, 0.5])
@pytest.mark.parametrize("along", [0, 2])
def test_the_sizes_of_an_aeroplane_are_found_whichever_way_it_points(nose, along):
    true = plane(nose, along)
    across = np.arange(3) == 2 - along
    squeezed = failures.aeroplane_sizes(true * np.where(across, 0.5, 1.0), true)
    assert squeezed == pytest.approx(
        {"body_width": 0.5, "body_height": 1, "span": 0.5, "length": 1}, abs=1e-6
    )
    narrow = true * np.where(across & (np.abs(true[:, across]) <= 0.05), 0.6, 1.0)
    sizes = failures.aeroplane_sizes(narrow, true)
    assert sizes["body_width"] == pytest.approx(0.6, abs=0.01)
    assert sizes["span"] > 0.95


def test_a_cloud_stretched_along_the_line_of_sight_errs_in_depth():
    true = box_surface(np.array([0.8, 0.4, 1.0]), 2000, np.random.default_rng(0))
    camera = look_at(0.0, 0.0, 2.0, (64, 64))
    deep, wide = (
        failures.depth_errors(true * stretch @ camera.R.T, true @ camera.R.T)
        for stretch in ([1.0, 1.0, 1.4], [1.4, 1.0, 1.0])
    )
    assert deep["extent"] == pytest.approx(1.4, abs=0.01)
    assert deep["depth"] > 3.0 * deep["across"]
    assert wide["across"] > wide["depth"]


def cases_of(category: str, values: dict[str, float], **more: Any) -> list[dict[str, Any]]:
    """Cases of the settings in ``values`` with these Chamfer distances."""
    return [
        {"setting": name, "category": category, "judged": {category: value}, **more}
        for name, value in values.items()
    ]


def held(record: dict[str, Any]) -> list[bool]:
    return holding(record["claims"])


def test_a_claim_about_supervision_holds_where_it_holds_in_every_category():
    names = (
        supervision.POINTS,
        supervision.MASKS,
        supervision.DISCRETISED,
        supervision.LIN,
        MEAN_SHAPE,
    )
    cars = dict(zip(names, (2.0, 2.8, 4.0, 3.0, 3.05), strict=True))
    assert held(supervision.conclude(cases_of("car", cars))) == [True, True, True, True]
    chairs = cases_of("chair", {name: 9.0 * value for name, value in cars.items()})
    record = supervision.conclude([*chairs, *cases_of("car", cars | {supervision.MASKS: 3.1})])
    assert held(record) == [True, False, False, False]
    assert (
        record["claims"][1]["found"]
        == "chair 25.20 against 27.45; car 3.10 against 3.05, not there"
    )


def test_two_masks_are_better_than_one_only_where_every_seed_says_so():
    values = {setting.name: 2.0 for setting in supervision.views_settings(["car"])}
    values |= {
        "V = 1": 4.0,
        "V = 1, seed + 1": 5.0,
        "V = 1, seed + 2": 4.0,
        "V = 3": 2.1,
        MEAN_SHAPE: 5.0,
    }
    assert held(supervision.conclude_views(cases_of("car", values))) == [True, True, True]
    record = supervision.conclude_views(cases_of("car", values | {"V = 2, seed + 1": 4.1}))
    assert held(record) == [False, False, True]
    assert record["summary"]["car"]["2"] == pytest.approx(2.7)


def test_the_papers_lambda_is_the_best_of_its_three():
    values = {
        setting.name: 5.0 + i for i, setting in enumerate(affinity.weight_settings(["chair"]))
    }
    assert held(affinity.conclude_weights(cases_of("chair", values))) == [False, False]
    values |= {name: 1.0 for name in values if name.endswith(", 0.0001")}
    assert held(affinity.conclude_weights(cases_of("chair", values))) == [True, True]


@pytest.mark.parametrize(
    ("widths", "depth", "holds"), [((0.8, 0.95), 4e-3, True), ((1.2, 0.7), 0.9e-3, False)]
)
def test_the_failures_show_where_bodies_are_narrow_and_depth_errs_most(widths, depth, holds):
    runs = []
    for name, width in zip((failures.ALONE_WIDE, failures.ALONE), widths, strict=True):
        runs += cases_of("airplane", {name: 2.0}, aeroplanes={"body_width": width, "span": 1.0})
    for name, error in ((failures.ONE, depth), (failures.FOUR, 1e-3)):
        runs += cases_of("car", {name: 2.0}, cars={"depth": error, "across": 1e-3, "extent": 1.0})
    assert held(failures.conclude(runs)) == [holds] * 3
