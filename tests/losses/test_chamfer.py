"""The Chamfer distance to the start (Eq. 7): exact, whatever was proved without a search."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import oracles
from tso_cli.losses.chamfer import ChamferToStart, spacings

from .common import assert_gradient, by_autograd

CLOUDS = {
    "random": lambda rng: rng.random((400, 3)),
    "of one leaf": lambda rng: rng.random((5, 3)),
    "of one point": lambda rng: rng.random((1, 3)),
    "clustered": lambda rng: rng.normal(size=(400, 3)) * 1e-3 + rng.integers(0, 3, (400, 1)),
    "duplicated": lambda rng: np.tile(rng.random((40, 3)), (10, 1)),
    "flat": lambda rng: rng.random((300, 3)) * [1.0, 0.0, 1.0],
    "with an outlier": lambda rng: np.concatenate([rng.random((300, 3)), [[500.0, 0.0, -3.0]]]),
    "all in one place": lambda rng: np.tile(rng.random((1, 3)), (300, 1)),
}


def _assert_exact(
    chamfer: ChamferToStart, moved: np.ndarray, compare_gradients: bool = True
) -> None:
    start = torch.tensor(chamfer.initial)
    expected, slope = by_autograd(lambda leaf: sum(oracles.chamfer(leaf, start)), moved)
    value, gradient = chamfer(moved)
    assert value == pytest.approx(expected, rel=1e-9, abs=1e-14)
    if compare_gradients:
        np.testing.assert_allclose(gradient, slope, atol=1e-9 * max(np.abs(slope).max(), 1e-3))


@pytest.mark.parametrize("cloud", CLOUDS)
@pytest.mark.parametrize("step", [0.0, 1e-2, 0.3])
def test_value_and_gradient_are_those_of_all_pairs_at_every_step(cloud, step):
    rng = np.random.default_rng(1)
    start = CLOUDS[cloud](rng)
    chamfer = ChamferToStart(start)
    drift, noise = rng.normal(size=(2, *start.shape))
    for factor in (0.0, 0.5, 1.0, -1.0):
        # Of duplicates either may be the nearest.
        _assert_exact(
            chamfer,
            start + step * (factor * drift + 0.3 * noise),
            cloud not in ("duplicated", "all in one place"),
        )


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-1, 1, width=32)] * 6), min_size=1, max_size=30), st.floats(0, 1)
)
def test_the_distance_is_that_of_all_pairs_whatever_moved(rows, step):
    start, way = np.array(rows)[:, :3], np.array(rows)[:, 3:]
    _assert_exact(ChamferToStart(start), start + step * way, compare_gradients=False)


@pytest.mark.parametrize("cloud", CLOUDS)
def test_the_gradient_is_that_of_finite_differences(cloud):
    rng = np.random.default_rng(2)
    start = CLOUDS[cloud](rng)[:12]
    assert_gradient(ChamferToStart(start), start + 0.02 * rng.random(start.shape), 1e-7)


def test_a_point_that_is_nan_makes_the_distance_nan():
    start = np.random.default_rng(5).random((50, 3))
    moved = start.copy()
    moved[7] = np.nan
    assert np.isnan(ChamferToStart(start)(moved)[0])


def test_the_spacing_of_a_point_is_the_distance_to_the_nearest_of_the_rest():
    points = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 0.0]])
    np.testing.assert_allclose(spacings(points), [3.0, 3.0, 0.0, 0.0])
    assert spacings(points[:1]) == [np.inf]
