"""The confidence in a result: its features, and the model that weighs them."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import about, example, in_photo, seen, turned
from tso_cli import RefineConfig, View, refine
from tso_cli.diagnosis.confidence import REASONS, _model, confidence_of
from tso_cli.diagnosis.examine import Diagnosis
from tso_cli.diagnosis.findings import Finding
from tso_cli.diagnosis.trust import FINDING
from tso_cli.optimisation.learned_start import beginning
from tso_cli.optimisation.optimise import optimise, weigh
from tso_cli.optimisation.problem import prepare
from tso_cli.pose.move import unmoved
from tso_cli.prior import named_prior
from tso_cli.refinement.judge import judge
from tso_cli.refinement.result import RefineResult
from tso_cli.refinement.scene import as_scene

from .common import changed

CHAIR, AIRPLANE = example("chair"), example("airplane")
FOUR = tuple(
    seen(AIRPLANE.target, turned(AIRPLANE.camera, angle)) for angle in (0.0, 90.0, 180.0, 270.0)
)
BOX = Diagnosis((), of_views=(Finding("box", (0,)),))
ACCEPTING = RefineConfig(accept_doubtful=True)


def _yawed(view: View, degrees: float) -> View:
    R = view.camera.R @ about("y", degrees)
    return replace(view, camera=replace(view.camera, R=R))


def _confidence(result: RefineResult) -> float:
    """Of the model, whatever a rule says."""
    return confidence_of(result.trust.features)[0]


@pytest.fixture(scope="module")
def right() -> RefineResult:
    """The aeroplane, refined from right input."""
    return refine(AIRPLANE.points, AIRPLANE.view)


@pytest.fixture(scope="module")
def wrong() -> RefineResult:
    """The chair, refined with a camera that is 45 degrees off."""
    return refine(CHAIR.points, _yawed(CHAIR.view, 45.0), config=ACCEPTING)


# The model


def test_the_model_knows_every_feature(right):
    _, terms = _model()
    assert set(terms) == set(right.trust.features)
    assert {name.split(":")[0] for name in terms} <= {*REASONS, "input"}
    assert all(deviation > 0.0 for _, deviation, _ in terms.values())


def test_the_confidence_of_a_result_is_that_of_its_features(right):
    assert right.trust.confidence == _confidence(right)


def test_without_an_answer_of_the_learned_prior_its_sureness_counts_as_average():
    _, terms = _model()
    alone = refine(AIRPLANE.points, AIRPLANE.view, config=RefineConfig(prior="none"))
    assert set(terms) - set(alone.trust.features) == {"prior: sureness"}
    average = {"prior: sureness": terms["prior: sureness"][0]}
    assert _confidence(alone) == confidence_of(alone.trust.features | average)[0]


def test_the_reason_is_the_group_without_which_the_confidence_would_be_highest(wrong):
    _, terms = _model()
    features = wrong.trust.features
    _, group = confidence_of(features)
    average = {name: mean for name, (mean, *_) in terms.items()}
    without = {
        one: confidence_of(
            {k: average.get(k, v) if k.startswith(one) else v for k, v in features.items()}
        )
        for one in REASONS
    }
    assert without[group][0] == max(confidence for confidence, _ in without.values())


# The features


def test_the_order_of_the_views_does_not_matter():
    views = [changed(view, "mask-inverted") if i == 1 else view for i, view in enumerate(FOUR)]
    config = replace(ACCEPTING, symmetry="none")
    first, *others = (
        _confidence(refine(AIRPLANE.points, [views[i] for i in order], config=config))
        for order in ([0, 1, 2, 3], [1, 2, 3, 0], [3, 2, 0, 1])
    )
    assert others == pytest.approx([first] * 2, abs=0.02)


@pytest.mark.parametrize("name", ["chair", "airplane"])
def test_a_camera_far_off_leaves_less_confidence_though_iou_rises(name):
    scene = example(name)
    views = scene.view, _yawed(scene.view, 45.0)
    right, wrong = (refine(scene.points, view, config=ACCEPTING) for view in views)
    assert wrong.fit.iou_after > wrong.fit.iou_before
    assert scene.error(wrong.points) > scene.error(scene.points)
    assert _confidence(wrong) < _confidence(right) - 0.05


def _judged(diagnosis: Diagnosis, inlier_weight: float = 1.0) -> RefineResult:
    """The aeroplane's result from right input, if its input had this ``diagnosis``."""
    settings = RefineConfig().settings()
    scene = as_scene(AIRPLANE.points, AIRPLANE.view)
    cloud = scene.cloud.controlled(settings.points, scene.views)
    weighed = weigh(prepare(cloud, scene.views, settings), settings)
    prior = named_prior(settings.prior)
    begin = beginning(weighed.problem, weighed.weights, prior)
    optimised = optimise(weighed, settings, settings.steps, begin=begin)
    still = unmoved(scene.views)
    weighed = replace(weighed, weights=[inlier_weight])
    return judge(weighed, optimised, scene.views, still, diagnosis, settings, seconds={})


@pytest.mark.parametrize(("inlier_weight", "taken"), [(0.3, True), (0.6, False)])
def test_views_are_outvoted_only_where_they_count_little(inlier_weight, taken):
    result = _judged(replace(BOX, outvoted=True), inlier_weight)
    assert (result.trust.verdict, result.trust.reason) == ("doubtful", FINDING)
    assert result.trust.moves is taken


def test_a_finding_costs_confidence_by_itself():
    with_finding, without = (_confidence(_judged(diagnosis)) for diagnosis in (BOX, Diagnosis(())))
    assert with_finding < without


def test_a_result_of_a_depth_map_or_of_the_papers_preset_has_the_same_features(right):
    middle = np.median(AIRPLANE.camera.project(AIRPLANE.target)[1])
    depth = np.where(AIRPLANE.mask > 0.5, middle, np.nan)
    with_map = refine(AIRPLANE.points, replace(AIRPLANE.view, depth=depth, depth_kind="z"))
    paper = refine(CHAIR.points, CHAIR.view, config=RefineConfig(preset="paper"))
    assert set(with_map.trust.features) == set(right.trust.features)
    assert set(right.trust.features) - set(paper.trust.features) == {"prior: sureness"}


def test_an_object_in_a_large_picture_has_the_confidence_of_one_in_a_small_picture():
    scene = example("airplane")
    view = _yawed(scene.view, 20.0)
    K = np.diag([4.0, 4.0, 1.0]) @ view.camera.K + 1.5 * np.outer([1.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    mask = np.kron(view.mask, np.ones((4, 4), np.float32))
    large = View(mask, replace(view.camera, K=K, width=1024, height=1024))
    small, large = (
        refine(scene.points, each, config=ACCEPTING)
        for each in (view, in_photo(large, 2, 300, 500))
    )
    # Its pixels are four times as fine, which tells a little more.
    assert abs(_confidence(large) - _confidence(small)) < 0.1
    name = "misfit: contours"
    assert abs(large.trust.features[name] - small.trust.features[name]) < 0.1


def test_points_of_a_floor_change_no_confidence(right):
    low, high = AIRPLANE.target.min(0), AIRPLANE.target.max(0)
    floor = np.random.default_rng(0).uniform(low - 0.5, high + 0.5, (1024, 3))
    floor[:, 1] = low[1]
    with_floor = refine(np.concatenate([AIRPLANE.points, floor]), AIRPLANE.view)
    assert "left-out" in [finding.name for finding in with_floor.findings]
    assert _confidence(with_floor) == pytest.approx(_confidence(right), abs=0.05)
