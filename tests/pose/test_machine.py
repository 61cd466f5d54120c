"""Placements, how far they are from the masks, and the descent that improves them."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import about, example, seen
from tso_cli import Camera
from tso_cli.geometry.camera import intrinsics
from tso_cli.geometry.rotations import angle_between, from_vectors
from tso_cli.pose.levenberg import Freedom, improve
from tso_cli.pose.misfit import Contour, ContourMisfit, NearestMisfit
from tso_cli.pose.placement import FOCAL, SHIFT, SIZE, TURN, UNKNOWNS, Placements
from tso_cli.pose.search import Comparison, search_from
from tso_cli.pose.target import Target

PLANE = example("airplane")
CANONICAL = Camera.canonical(64, 64)
FLAT = replace(CANONICAL, K=intrinsics(30.0, 64, 64), model="orthographic")
MODELS = pytest.mark.parametrize("camera", [CANONICAL, FLAT], ids=["perspective", "orthographic"])
SOME = replace(
    Placements.at(
        from_vectors(np.array([[0.1, -0.2, 0.3], [0.4, 0.1, -0.2]])),
        np.array([[0.02, -0.01, 0.1], [-0.05, 0.03, 0.0]]),
        np.array([1.1, 0.9]),
    ),
    focal=np.array([1.05, 0.98]),
    aspect=np.array([0.9, 1.02]),
    centre=np.array([[0.01, -0.02], [-0.03, 0.0]]),
    growth=np.array([0.5, -0.4]),
)


def _normalised(points):
    low, high = points.min(0), points.max(0)
    return (points - (low + high) / 2.0) / (high - low).max()


@MODELS
def test_the_jacobian_agrees_with_finite_differences_in_every_unknown(camera):
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (5, 3))
    target = Target.of(seen(_normalised(PLANE.target), camera), 64)
    before = target.project(points, SOME)
    rows, columns = np.indices((2, 5))
    J = before.jacobian(rows, columns)
    normals = np.random.default_rng(2).normal(size=(2, 5, 2))
    along = before.jacobian(rows, columns, normals)
    for column, step in enumerate(1e-6 * np.eye(UNKNOWNS)):
        after = target.project(points, SOME.stepped(np.tile(step, (2, 1))))
        difference = (after.px - before.px) / 1e-6
        np.testing.assert_allclose(J[..., column], difference, atol=1e-3)
        np.testing.assert_allclose(along[..., column], (normals * difference).sum(-1), atol=1e-3)


@MODELS
@pytest.mark.parametrize("kind", ["cells", "contour"])
def test_the_gradient_is_half_the_slope_of_the_misfit(camera, kind):
    points = _normalised(PLANE.target)[:200]
    target = Target.of(seen(points, camera), 64)
    misfit = NearestMisfit(points, [target])
    if kind == "contour":
        misfit = ContourMisfit(points, [Contour.of(target)], robust=3.0, reach=12.0)
    system = misfit(SOME)
    for column, step in enumerate(1e-7 * np.eye(UNKNOWNS)):
        after, before = (misfit(SOME.stepped(np.tile(s, (2, 1)))).value for s in (step, -step))
        slope = -(after - before) / 2e-7 / 2.0
        np.testing.assert_allclose(system.gradient[:, column], slope, rtol=0.02, atol=0.02)


def test_a_point_at_the_camera_is_projected_from_the_nearest_depth():
    target = Target.of(seen(_normalised(PLANE.target), CANONICAL), 64)
    near = CANONICAL.position[None] + [[0.1, 0.05, -0.001]]
    before = target.project(near, Placements.unmoved())
    J = before.jacobian(np.array([0]), np.array([0]))[0]
    step = 1e-6 * CANONICAL.R[2]
    after = target.project(near, replace(Placements.unmoved(), t=step[None]))
    np.testing.assert_array_equal(after.px, before.px)
    np.testing.assert_allclose(J[:, SHIFT] @ CANONICAL.R[2], 0.0, atol=1e-9)


def test_the_gradient_of_the_posterior_is_half_its_slope():
    points = _normalised(PLANE.target)[:200]
    target = Target.of(seen(points, CANONICAL), 64)
    deviation = np.array([0.2] * 3 + [0.1] * 3 + [0.1, 0.3] + [0.2] * (UNKNOWNS - 8))
    freedom = replace(Freedom.of(SOME[:1], TURN), deviation=deviation)
    posterior = freedom.posterior(NearestMisfit(points, [target]))
    step = [0.1, 0.05, -0.1, 0.05, 0.02, 0.1, 0.1, 0.2, *[0.0] * 5, 0.1, 0.02, -0.02, 0.3]
    at = SOME[:1].stepped(np.array([step]))
    gradient = posterior(at).gradient[0]
    for column, step in enumerate(1e-6 * np.eye(UNKNOWNS)):
        after, before = (posterior(at.stepped(s[None])).value[0] for s in (step, -step))
        # The prior of a turn is linear in its vector, and the derivative is by a small turn.
        assert gradient[column] == pytest.approx(-(after - before) / 4e-6, rel=0.03, abs=1.0)


def test_the_edge_of_what_is_known_is_no_contour():
    points = PLANE.target
    left, _, right, _ = PLANE.view.box()
    middle = int((left + right) / 2.0)
    known = np.ones(PLANE.mask.shape, bool)
    known[:, middle - 8 : middle + 8] = False
    whole, ignoring = (
        Comparison.of(points, [view]) for view in (PLANE.view, replace(PLANE.view, known=known))
    )
    at = Placements.unmoved()
    assert ignoring.missed(at)[0] < whole.missed(at)[0] + 0.08


def test_a_placement_counted_from_another_is_the_step_between_them():
    step = np.random.default_rng(0).uniform(-0.3, 0.3, (1, UNKNOWNS))
    given = SOME[:1]
    np.testing.assert_allclose(given.stepped(step).since(given), step, atol=1e-12)


def test_a_cloud_of_the_right_shape_is_brought_back_exactly_and_none_gets_worse():
    comparison = Comparison.of(PLANE.target, [PLANE.view])
    starts = SOME.stepped(np.zeros((2, UNKNOWNS)))
    starts = Placements.at(starts.R, starts.t, np.ones(2))
    freedom = Freedom.of(starts[:1], TURN, SHIFT)
    before = freedom.posterior(comparison.cells)(starts).value
    _, after = improve(starts, comparison.cells, freedom, 12)
    assert (after <= before).all()
    turned = from_vectors(np.radians([[5.0, -4.0, 3.0]]))
    start = Placements.at(turned, starts.t[:1], np.ones(1))
    found = search_from(comparison, Freedom.of(start, TURN, SHIFT))
    assert found.missed_before > 0.5
    assert found.explains
    assert angle_between(found.placement.R[0], np.eye(3)) < 1.5


def test_unknowns_that_are_not_free_stay():
    points = _normalised(PLANE.target)
    comparison = Comparison.of(points, [seen(points, CANONICAL)])
    moved, _ = improve(SOME, comparison.cells, Freedom.of(SOME[:1], TURN), 5)
    for name in ("t", "size", "focal"):
        np.testing.assert_array_equal(getattr(moved, name), getattr(SOME, name))
    sized, _ = improve(SOME, comparison.cells, Freedom.of(SOME[:1], SIZE, FOCAL), 5)
    np.testing.assert_array_equal(sized.R, SOME.R)


def test_a_wrong_shape_stays_nearer_to_where_it_was_given_than_without_a_prior():
    wrong, view = _normalised(example("chair").points), PLANE.view
    camera = replace(view.camera, R=about("y", 20.0) @ view.camera.R)
    comparison = Comparison.of(wrong, [replace(view, camera=camera)])
    free = Freedom.of(Placements.unmoved(), TURN, SHIFT)
    held = replace(free, deviation=np.array([0.1] * 3 + [0.05] * 3 + [np.inf] * (UNKNOWNS - 6)))
    lengths = []
    for freedom in (free, held):
        moved, _ = improve(Placements.unmoved(), comparison.cells, freedom, 15)
        lengths.append(np.linalg.norm(moved.since(freedom.given)))
    assert lengths[1] < 0.8 * lengths[0]


def test_half_of_the_points_miss_more_and_what_infinitely_many_would_miss_is_near_nothing():
    comparison, at = Comparison.of(PLANE.target, [PLANE.view]), Placements.unmoved()
    whole, half = (
        replace(comparison, points=comparison.points[:count]).contour(0.6)(at).value[0]
        for count in (len(PLANE.target), len(PLANE.target) // 2)
    )
    assert half > whole > comparison.missed(at)[0]
    assert comparison.missed(at)[0] < 0.15
