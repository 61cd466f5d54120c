"""The studies that train networks: their frame, what they measure, and what they conclude."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from tso_cli.evaluation.metrics import chamfer
from tso_cli.render.viewpoints import look_at
from tso_lab.studies import paper, paper_measures
from tso_lab.studies.material import (
    ALL,
    DENSE,
    MEAN_SHAPE,
    Predicted,
    constant_answer,
    distances,
)
from tso_lab.studies.paper import MASKED, Network
from tso_lab.study import Progress

from ..training import box_surface
from .studying import MESHES, SMALL, holding, rng, timeless


def compare(split: Any, progress: Progress | None = None) -> dict[str, Any]:
    """Three networks."""
    networks = [Network(f"V = {count}", {**MASKED, "views": count}) for count in (1, 2, 3)]
    plan = partial(paper.VIEWS.plan, networks=networks, material=SMALL)
    shown = {"conclude": lambda cases: {}, "tables": lambda record: []}
    compared = replace(paper.VIEWS, plan=plan, **shown)
    options = {"meshes": MESHES, "split": split, "part": "test", "categories": (), "limit": 32}
    options |= {"steps": 4, "batch_size": 2, "seed": 0, "device": "cpu"}
    return compared.run(progress or Progress(), **options)


@pytest.mark.slow
def test_every_setting_trains_its_own_network_and_an_interrupted_study_resumes_at_the_next(
    split, thin
):
    expected = compare(split)
    assert expected["settings"]["shapes"] == {"car": {"training": 3, "judged": 1}}
    assert [case["setting"] for case in expected["cases"]] == ["V = 1", "V = 2", "V = 3"]
    assert len({case["judged"]["car"] for case in expected["cases"]}) == 3
    kept: list[dict[str, Any]] = []

    def stop(what: str, done: int, total: int) -> None:
        if what.startswith("2 of 3") and done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compare(split, Progress(stop, None, kept.append))
    assert [len(record["cases"]) for record in kept] == [0, 1]
    again: list[str] = []
    report = lambda what, done, total: again.append(what[:6])  # noqa: E731
    resumed = compare(split, Progress(report, json.loads(json.dumps(kept[-1]))))
    assert timeless(resumed) == timeless(expected)
    assert {what for what in again if what.endswith(" of 3")} == {"2 of 3", "3 of 3"}


def test_training_and_unseen_shapes_are_those_of_their_lists(split):
    shapes = SMALL(MESHES, split, "test", ("car", "chair"), limit=1)
    assert [item.name for item in shapes.data("car", True).objects] == ["car/qreal_SUV"]
    unseen = [item.name for item in shapes.data(ALL, False).objects]
    assert unseen == ["car/qbasic_RaceCar", "chair/kfurn_chairRounded"]
    dense = shapes.data("car", True, dense=True).target(0)
    assert dense.shape == (DENSE, 3)
    sides = np.ptp(shapes.data("car", True).target(0), axis=0)
    np.testing.assert_allclose(np.ptp(dense, axis=0), sides, atol=0.02)


def test_the_papers_protocol_ignores_scale_and_place():
    cloud = box_surface(np.array([1.0, 0.5, 0.7]), 500, rng())
    half = cloud[cloud[:, 0] < 0.0]

    def of(points: np.ndarray) -> float:
        return distances([Predicted(0, "box", points[None], cloud[None])])["box"]

    assert of(cloud * 0.5 + 0.1) == pytest.approx(0.0, abs=1e-9)
    assert of(half * 0.5) == pytest.approx(of(half))
    assert of(half) > 1.0


def test_the_constant_answer_is_one_cloud_for_all_views_and_nearer_than_any_training_shape(split):
    cars = SMALL(MESHES, split, "test", ("car",))
    training = cars.data("car", True)
    (answer,) = constant_answer(training, cars.data("car", False), steps=30)
    assert answer.points.shape == (4, 1024, 3)
    assert len({cloud.tobytes() for cloud in answer.points}) == 1
    targets = [training.target(i) for i in range(len(training.objects))]
    clouds = (answer.points[0], *targets)
    totals = [sum(chamfer(cloud, target).chamfer for target in targets) for cloud in clouds]
    assert np.argmin(totals) == 0


def test_a_point_two_pixels_off_the_mask_is_an_outlier_and_one_at_its_edge_is_not():
    mask = np.zeros((20, 20), np.float32)
    mask[5:10, 5:10] = 1.0
    pixels = np.array([[7.0, 7.0], [10.4, 7.0], [11.2, 7.0], [-30.0, 7.0], [np.nan, np.nan]])
    assert paper_measures.outliers(pixels, mask).tolist() == [False, False, True, True, True]


def plane(nose: float, along: int) -> np.ndarray:
    """A fuselage 1 long and 0.1 wide, wings of 0.8 in its middle, a tail of 0.3."""
    random = rng()

    def plate(length: tuple[float, float], half: float, count: int) -> np.ndarray:
        x, z = random.uniform(*length, count), random.uniform(-half, half, count)
        return np.stack([x, np.zeros(count), z], axis=1)

    body = plate((-0.5, 0.5), 1.0, 3000)
    angle = np.pi * body[:, 2]
    body[:, 1], body[:, 2] = 0.05 * np.sin(angle), 0.05 * np.cos(angle)
    cloud = np.concatenate([body, plate((-0.1, 0.1), 0.4, 1500), plate((0.4, 0.5), 0.15, 300)])
    cloud = cloud * [-2.0 * nose, 1.0, 1.0]
    return cloud if along == 0 else cloud[:, ::-1]


@pytest.mark.parametrize("nose", [-0.5, 0.5])
@pytest.mark.parametrize("along", [0, 2])
def test_the_sizes_of_an_aeroplane_are_found_whichever_way_it_points(nose, along):
    true = plane(nose, along)
    across = np.arange(3) == 2 - along
    sizes = paper_measures.aeroplane_sizes(true * np.where(across, 0.5, 1.0), true)
    expected = {"body_width": 0.5, "body_height": 1, "span": 0.5, "length": 1}
    assert sizes == pytest.approx(expected, abs=1e-6)
    narrow = true * np.where(across & (np.abs(true[:, across]) <= 0.05), 0.6, 1.0)
    sizes = paper_measures.aeroplane_sizes(narrow, true)
    assert sizes["body_width"] == pytest.approx(0.6, abs=0.01)
    assert sizes["span"] > 0.95


def test_a_cloud_stretched_along_the_line_of_sight_errs_in_depth():
    true, turn = (
        box_surface(np.array([0.8, 0.4, 1.0]), 2000, rng()),
        look_at(0, 0, 2.0, (64, 64)).R.T,
    )
    deep = paper_measures.depth_errors(true * [1.0, 1.0, 1.4] @ turn, true @ turn)
    wide = paper_measures.depth_errors(true * [1.4, 1.0, 1.0] @ turn, true @ turn)
    assert deep["extent"] == pytest.approx(1.4, abs=0.01)
    assert deep["depth"] > 3.0 * deep["across"]
    assert wide["across"] > wide["depth"]


def cases_of(category: str, values: dict[str, float], **more: Any) -> list[dict[str, Any]]:
    """Cases of the settings in ``values`` with these Chamfer distances."""
    return [
        {"setting": name, "category": category, "judged": {category: value}, **more}
        for name, value in values.items()
    ]


def test_a_claim_about_supervision_holds_where_it_holds_in_every_category():
    kinds = (paper.POINTS, paper.MASKS, paper.DISCRETISED, paper.LIN)
    cars = dict(zip((*kinds, MEAN_SHAPE), (2.0, 2.8, 4.0, 3.0, 3.05), strict=True))
    assert holding(paper.conclude_supervision(cases_of("car", cars))) == [True, True, True, True]
    chairs = cases_of("chair", {name: 9.0 * value for name, value in cars.items()})
    record = paper.conclude_supervision([*chairs, *cases_of("car", cars | {paper.MASKS: 3.1})])
    assert holding(record) == [True, False, False, False]
    found = record["claims"][1]["found"]
    assert found == "chair 25.20 against 27.45; car 3.10 against 3.05, not there"


def test_two_masks_are_better_than_one_only_where_every_seed_says_so():
    values = {network.name: 2.0 for network in paper.OF_VIEWS}
    values |= {"V = 1": 4.0, "V = 1, seed + 1": 5.0, "V = 1, seed + 2": 4.0, "V = 3": 2.1}
    values |= {MEAN_SHAPE: 5.0}
    assert holding(paper.conclude_views(cases_of("car", values))) == [True, True, True]
    values |= {"V = 2, seed + 1": 4.1}
    record = paper.conclude_views(cases_of("car", values))
    assert holding(record) == [False, False, True]
    assert record["summary"]["car"]["2"] == pytest.approx(2.7)


def test_the_papers_lambda_is_the_best_of_its_three():
    names = [network.name for network in paper.OF_WEIGHTS]
    values = {name: 5.0 + i for i, name in enumerate(names)}
    assert holding(paper.conclude_lambda(cases_of("chair", values))) == [False, False]
    values |= {name: 1.0 for name in values if name.endswith(", 0.0001")}
    assert holding(paper.conclude_lambda(cases_of("chair", values))) == [True, True]


@pytest.mark.parametrize(
    ("widths", "depth", "holds"), [((0.8, 0.95), 4e-3, True), ((1.2, 0.7), 0.9e-3, False)]
)
def test_the_failures_show_where_bodies_are_narrow_and_depth_errs_most(widths, depth, holds):
    runs = []
    for name, width in zip((paper.ALONE_WIDE, paper.ALONE), widths, strict=True):
        runs += cases_of("airplane", {name: 2.0}, aeroplanes={"body_width": width, "span": 1.0})
    for name, error in ((paper.ONE, depth), (paper.FOUR, 1e-3)):
        runs += cases_of("car", {name: 2.0}, cars={"depth": error, "across": 1e-3, "extent": 1.0})
    assert holding(paper.conclude_failures(runs)) == [holds] * 3
