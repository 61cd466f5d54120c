"""Weights of views: one that the others contradict counts for little."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import example, problem_of, turned
from tso_cli import Camera, RefineConfig, View
from tso_cli.evaluation.metrics import chamfer
from tso_cli.losses.silhouette import silhouette_of
from tso_cli.optimisation.optimise import optimise, weigh
from tso_cli.optimisation.view_weights import inlier_weights, weights_of

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


def _weights(points: np.ndarray, views: list[View]) -> list[float]:
    problem = problem_of(points, *views)
    return weights_of([windowed.resampled for windowed in problem.given], problem.cloud.start)


def test_a_large_loss_is_discounted_unless_its_gradient_agrees_with_the_others():
    expected = [1.0, 1.0, 1.0, (1.5 / (6.0 / 1.05)) ** 4]
    np.testing.assert_allclose(inlier_weights(LOSSES, ORTHOGONAL), expected)
    agreeing = ORTHOGONAL.copy()
    agreeing[3, :3] = 1.0
    np.testing.assert_allclose(inlier_weights(LOSSES, agreeing), 1.0)


def test_right_views_are_inliers():
    points, _, views = _seen_around("chair")
    assert _weights(points, views) == pytest.approx([1.0] * 4, abs=0.02)


def _with_a_wrong_one(views: list[View], target: np.ndarray, what: str) -> list[View]:
    if what == "a camera turned by 40 degrees":
        wrong = View(views[1].mask, turned(views[1].camera, 40.0))
    else:
        wrong = _seen(target[:, [1, 2, 0]] * [1.3, 0.5, 1.0], views[1].camera)
    return [views[0], wrong, *views[2:]]


@pytest.mark.parametrize("what", ["a camera turned by 40 degrees", "a mask of something else"])
def test_a_wrong_view_among_four_is_the_only_outlier(what):
    points, target, views = _seen_around("car")
    weights = _weights(points, _with_a_wrong_one(views, target, what))
    assert weights[1] < 0.3
    assert min(np.delete(weights, 1)) > 0.9


def test_a_wrong_view_spoils_less_than_if_it_were_trusted():
    points, target, views = _seen_around("car")
    problem = problem_of(points, *_with_a_wrong_one(views, target, "a mask of something else"))
    settings = RefineConfig().settings()
    weighed = weigh(problem, settings)
    trusting = replace(weighed, weights=[1.0] * 4)
    assert weighed.weights[1] < trusting.weights[1]
    weighed, trusting = (
        problem.cloud.denormalise(optimise(one, settings, settings.steps).best)
        for one in (weighed, trusting)
    )
    assert chamfer(weighed, target).chamfer < chamfer(trusting, target).chamfer


def test_of_two_views_neither_is_an_outlier():
    points, target, views = _seen_around("chair")
    views = _with_a_wrong_one(views, target, "a camera turned by 40 degrees")
    assert _weights(points, views[:2]) == [1.0, 1.0]
