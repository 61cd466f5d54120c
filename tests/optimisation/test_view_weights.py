"""Inlier weights of views, and loss weights that redundant views share."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import block, example, problem_of, turned
from tso_cli import Camera, RefineConfig, View
from tso_cli.evaluation.metrics import chamfer
from tso_cli.losses.silhouette import silhouette_of
from tso_cli.optimisation.optimise import optimise, weigh
from tso_cli.optimisation.view_weights import ViewWeights, inlier_weights, shared_weights

ORTHOGONAL = np.eye(5)[:4]  # gradients of four views
LOSSES = np.array([1.0, 1.1, 0.9, 6.0])


def _seen_around(name: str):
    """The initial cloud of an example, its target, and four views of the target around it."""
    points, _, camera, target = example(name)
    camera = camera.resized(64, 64)
    return (
        points,
        target,
        [_seen(target, turned(camera, degrees)) for degrees in (0.0, 70.0, 150.0, 240.0)],
    )


def _seen(cloud: np.ndarray, camera: Camera) -> View:
    return View(silhouette_of(cloud, camera), camera)


def _weights(points: np.ndarray, views: list[View]) -> ViewWeights:
    without_images = [replace(view, image=None) for view in views]
    problem = problem_of(points, *without_images)
    given = [
        replace(windowed.resampled, image=view.image)
        for windowed, view in zip(problem.given, views, strict=True)
    ]
    return ViewWeights.of(given, problem.cloud.start)


BALL = np.random.default_rng(0).normal(size=(300, 3))
BALL *= 0.4 / np.linalg.norm(BALL, axis=1, keepdims=True)
LEVEL = Camera.canonical(64, 64)


def _loss_weights(*degrees: float, **parts: object) -> list[float]:
    """Weights of cameras turned about a ball by these ``degrees``."""
    views = [replace(_seen(BALL, turned(LEVEL, turn)), **parts) for turn in degrees]
    return _weights(BALL, views).loss


def test_equal_cameras_share_the_weight_of_one_view():
    assert _loss_weights(30.0) == [1.0]
    assert _loss_weights(30.0, 30.0, 30.0, 120.0) == pytest.approx([1 / 3, 1 / 3, 1 / 3, 1.0])


def test_opposite_silhouettes_are_redundant_and_opposite_depth_maps_and_images_are_not():
    assert _loss_weights(0.0, 180.0) == pytest.approx([0.5, 0.5], abs=1e-3)
    assert _loss_weights(0.0, 180.0, depth=np.full((64, 64), 1.6)) == pytest.approx([1.0, 1.0])
    assert _loss_weights(0.0, 180.0, image=np.full((64, 64, 3), 0.5, np.float32)) == pytest.approx(
        [1.0, 1.0]
    )
    assert _loss_weights(0.0, 0.0, depth=np.full((64, 64), 1.6)) == pytest.approx([0.5, 0.5])


def test_weights_grow_with_the_angle_between_cameras():
    sums = [sum(_loss_weights(0.0, turn)) for turn in (0.0, 10.0, 20.0, 45.0, 90.0)]
    assert sums == sorted(sums)
    assert sums[0] == pytest.approx(1.0)
    assert sums[4] == pytest.approx(2.0)
    assert sums[1] < 1.1
    assert sums[3] > 1.85


def test_views_of_different_parts_are_not_redundant():
    view, left = _seen(BALL, LEVEL), block(np.s_[:, :32]) > 0.0
    halves = [replace(view, known=left), replace(view, known=~left)]
    assert _weights(BALL, halves).loss == [1.0, 1.0]
    # Each half repeats a half of the whole.
    assert _weights(BALL, [view, *halves]).loss[0] == pytest.approx(0.5, abs=0.01)


def test_redundant_views_together_count_as_the_most_trusted_one_and_others_are_unchanged():
    for inlier in ([1.0, 1.0, 1.0], [1.0, 0.5, 0.5], [0.3, 1e-9, 0.2], [1.0, 0.5, 1e-12]):
        assert shared_weights(np.array(inlier), np.ones((3, 3))).sum() == pytest.approx(max(inlier))
        np.testing.assert_allclose(shared_weights(np.array(inlier), np.eye(3)), inlier)


def test_a_large_loss_is_discounted_unless_its_gradient_agrees_with_the_others():
    expected = [1.0, 1.0, 1.0, (1.5 / (6.0 / 1.05)) ** 4]
    np.testing.assert_allclose(inlier_weights(LOSSES, ORTHOGONAL), expected)
    agreeing = ORTHOGONAL.copy()
    agreeing[3, :3] = 1.0
    np.testing.assert_allclose(inlier_weights(LOSSES, agreeing), 1.0)


def test_right_views_are_inliers():
    points, _, views = _seen_around("chair")
    assert _weights(points, views).inlier == pytest.approx([1.0] * 4, abs=0.02)


def _with_a_wrong_one(views: list[View], target: np.ndarray, what: str) -> list[View]:
    if what == "a camera turned by 40 degrees":
        wrong = View(views[1].mask, turned(views[1].camera, 40.0))
    else:
        wrong = _seen(target[:, [1, 2, 0]] * [1.3, 0.5, 1.0], views[1].camera)
    return [views[0], wrong, *views[2:]]


@pytest.mark.parametrize("what", ["a camera turned by 40 degrees", "a mask of something else"])
def test_a_wrong_view_among_four_is_the_only_outlier(what):
    points, target, views = _seen_around("car")
    weights = _weights(points, _with_a_wrong_one(views, target, what)).inlier
    assert weights[1] < 0.3
    assert min(np.delete(weights, 1)) > 0.9


def test_a_wrong_view_spoils_less_than_if_it_were_trusted():
    points, target, views = _seen_around("car")
    problem = problem_of(points, *_with_a_wrong_one(views, target, "a mask of something else"))
    settings = RefineConfig().settings(4)
    weighed = weigh(problem, settings)
    trusting = replace(weighed, weights=ViewWeights.even(4))
    assert weighed.weights.loss[1] < trusting.weights.loss[1]
    weighed, trusting = (
        problem.cloud.denormalise(optimise(one, settings, settings.steps).best)
        for one in (weighed, trusting)
    )
    assert chamfer(weighed, target).chamfer < chamfer(trusting, target).chamfer


def test_of_two_views_neither_is_an_outlier():
    points, target, views = _seen_around("chair")
    views = _with_a_wrong_one(views, target, "a camera turned by 40 degrees")
    assert _weights(points, views[:2]).inlier == [1.0, 1.0]
