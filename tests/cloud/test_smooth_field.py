"""Smooth displacement fields and averages."""

import numpy as np
import pytest

from tests.losses.common import FORMS, NUMPY, in_form
from tso_cli.cloud.smooth_field import NODES, SmoothField, falling_weights
from tso_cli.optimisation.adam import Adam
from tso_cli.optimisation.parameters import FieldParameters


def _cloud(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 3))


@FORMS
@pytest.mark.parametrize("weight", [1.0, 100.0])
@pytest.mark.parametrize("apart", [0.0, 5.0])
def test_smoothing_solves_the_system_of_the_neighbour_graph_of_one_part_or_several(
    form, weight, apart
):
    points = _cloud(300) + apart * (np.arange(300) % 3)[:, None]
    pairs = np.linalg.norm(points[:, None] - points, axis=2)
    joined = pairs <= np.sort(pairs, 1)[:, 8:9]  # itself and its 8 nearest
    joined = (joined | joined.T) & ~np.eye(300, dtype=bool)
    laplacian = (np.diag(joined.sum(1)) - joined) * 300 / 512
    values = np.random.default_rng(1).normal(size=(300, 3))
    expected = np.linalg.solve(np.eye(300) + weight * laplacian, values)
    smoothed = in_form(form, lambda: SmoothField(points).smoothed(values, weight))
    np.testing.assert_allclose(smoothed, expected, atol=1e-12)


@FORMS
def test_gather_is_the_transpose_of_spread_and_both_forms_agree(form):
    field = in_form(NUMPY, SmoothField, _cloud(NODES + 700))
    rng = np.random.default_rng(2)
    of_nodes, of_points = (
        rng.normal(size=(NODES, 3)),
        rng.normal(size=(NODES + 700, 3)),
    )
    spread, gathered = in_form(form, field.spread, of_nodes), in_form(form, field.gather, of_points)
    assert (spread * of_points).sum() == pytest.approx((of_nodes * gathered).sum())
    np.testing.assert_allclose(spread, in_form(NUMPY, field.spread, of_nodes), atol=1e-12)
    np.testing.assert_allclose(gathered, in_form(NUMPY, field.gather, of_points), atol=1e-12)


@FORMS
@pytest.mark.parametrize("count", [60, NODES + 100])
def test_the_optimiser_gets_the_gradient_by_the_values_at_the_nodes(form, count):
    """The displacement is linear in the values, so one product checks the whole gradient."""
    points = _cloud(count)

    class Spied(Adam):
        def step(self, gradient):
            self.gradient = gradient
            return np.random.default_rng(3).normal(size=gradient.shape)

    def run():
        field, adam, by_points = (
            SmoothField(points),
            Spied(0.1),
            np.random.default_rng(4).normal(size=points.shape),
        )
        parameters = FieldParameters(points, field, 3.0, adam)
        np.testing.assert_array_equal(parameters.points(), points)
        parameters.step(by_points)
        step = np.random.default_rng(3).normal(size=adam.gradient.shape)
        assert ((parameters.points() - points) * by_points).sum() == pytest.approx(
            (step * adam.gradient).sum(), rel=1e-9
        )

    in_form(form, run)


def test_points_of_a_large_cloud_follow_their_nodes():
    points = _cloud(5000)
    field = SmoothField(points)
    assert field.nodes.shape == (NODES,)
    assert field.patches.shape == (NODES, 12)
    np.testing.assert_array_equal(field.patches[:, 0], np.arange(NODES))
    moved = field.spread(field.smoothed(np.eye(NODES)[:, :1].repeat(3, 1), 10.0))[:, 0]
    order = np.linalg.norm(points - points[moved.argmax()], axis=1).argsort()
    assert moved[order[:50]].mean() > 5.0 * moved[order[2500:]].mean()


def test_interpolation_weights_sum_to_one_and_fall_to_nothing_at_the_last_node():
    weights = falling_weights(np.array([[0.0, 0.5, 1.0, 2.0], [3.0, 3.0, 3.0, 3.0]]))
    np.testing.assert_allclose(weights.sum(1), 1.0)
    assert (np.diff(weights[0]) < 0.0).all()
    assert weights[0, -1] < 1e-6
    np.testing.assert_allclose(weights[1], 0.25)


@FORMS
@pytest.mark.parametrize("count", [1, 2, 3, NODES + 1])
def test_tiny_clouds_and_coinciding_points_have_fields(count, form):
    for points in (_cloud(count), np.zeros((count, 3))):
        field = in_form(form, SmoothField, points)
        smoothed = in_form(form, field.smoothed, np.ones((len(field.nodes), 3)), 10.0)
        assert np.isfinite(in_form(form, field.spread, smoothed)).all()
