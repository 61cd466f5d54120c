"""The depth loss and its gradient."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings

from tests import oracles
from tso_cli.geometry.camera import Camera
from tso_cli.losses.depth import ROBUST_SCALE, TOLERANCE, DepthTarget, depth_loss
from tso_cli.losses.projection import project_differentiably

from .common import assert_equal, assert_gradient, by_autograd
from .scenes import HEIGHT, PLACES, WIDTH, camera_of, points_at, points_of, scattered

SIZE = 64
CANONICAL = Camera.canonical(SIZE, SIZE)


def wall(depth: float = 2.0) -> np.ndarray:
    """A depth map of a wall, square to the camera, known in its middle."""
    wall = np.full((SIZE, SIZE), np.nan)
    wall[24:40, 24:40] = depth
    return wall


def on(column: float, row: float, depth: float) -> list[float]:
    """The world point that the canonical camera sees at that pixel and depth."""
    return points_at(np.array([[column, row]]), CANONICAL, np.array([depth]))[0].tolist()


def loss(points, depth: np.ndarray, camera: Camera = CANONICAL) -> tuple[float, np.ndarray]:
    target = DepthTarget.of(depth, np.ones(depth.shape, bool), camera)
    points = np.asarray(points, float)
    return depth_loss(points, project_differentiably(points, camera), target)


def grid(depth: float, step: float = 1.0) -> np.ndarray:
    return np.array(
        [on(c, r, depth) for c in np.arange(24, 40, step) for r in np.arange(24, 40, step)]
    )


def _uneven() -> np.ndarray:
    """A rough surface with an edge and unknown pixels."""
    rng = np.random.default_rng(3)
    depth = 2.0 + 0.05 * rng.normal(size=(HEIGHT, WIDTH)) + 0.4 * (np.arange(WIDTH) > 20)
    return np.where(rng.random(depth.shape) < 0.7, depth, np.nan)


def _scene(count: int) -> np.ndarray:
    """Points in front of, on and behind the surface, at borders, and behind the camera."""
    pixels = scattered()[-count:]
    depth = np.random.default_rng(4).uniform(1.5, 2.6, count)
    depth[::9] = -1.0
    return points_at(pixels, camera_of(), depth)


def _oracle(points: torch.Tensor, depth: np.ndarray) -> torch.Tensor:
    """By all pairs of pixels and points, and point by point."""
    camera = camera_of()
    pixels, own_depth = oracles.project(points, camera)
    valid = own_depth > 1e-3
    rows, columns = np.nonzero(np.isfinite(depth))
    known = torch.tensor(depth[rows, columns])
    surface = torch.tensor(points_at(np.stack([columns, rows], 1), camera, depth[rows, columns]))
    focal, area = (
        float(np.sqrt(camera.K[0, 0] * camera.K[1, 1])) * 64.0 / WIDTH,
        (64.0 / WIDTH) ** 2,
    )

    def robust(squared: torch.Tensor) -> torch.Tensor:
        return torch.where(squared > TOLERANCE**2, oracles.robust(squared, ROBUST_SCALE), 0.0).sum()

    squared = (surface[:, None] - points).square().sum(2).masked_fill(~valid, torch.inf)
    total = robust(squared.min(1).values * (focal / known) ** 2) * area
    for z, (column, row), exists in zip(own_depth, pixels, valid, strict=True):
        i, j = round(row.item()), round(column.item())
        if exists and 0 <= i < HEIGHT and 0 <= j < WIDTH and np.isfinite(depth[i, j]):
            least = np.nanmin(depth[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2])
            total = total + robust(
                ((least - z).clamp_min(0.0) * focal / depth[i, j]).square()
            ) * 1024.0 / len(points)
    return total


def test_value_and_gradient_are_those_of_all_pairs():
    points = _scene(60)
    expected = by_autograd(lambda leaf: _oracle(leaf, _uneven()), points)
    assert expected[0] > 1.0
    assert_equal(loss(points, _uneven(), camera_of()), expected)


def test_the_gradient_is_that_of_finite_differences():
    assert_gradient(lambda at: loss(at, _uneven(), camera_of()), _scene(20), 1e-7, 1e-4)


@settings(max_examples=30, deadline=None)
@given(PLACES)
def test_any_points_cost_what_all_pairs_cost(places):
    points = points_of(places, camera_of())
    expected = by_autograd(lambda leaf: _oracle(leaf, _uneven()), points)[0]
    value, _ = loss(points, _uneven(), camera_of())
    # Without a point before the camera the oracle is not a number.
    assert value == pytest.approx(expected if np.isfinite(expected) else 0.0, rel=1e-8, abs=1e-8)


def test_points_on_a_surface_or_hidden_behind_it_cost_nothing_and_a_point_in_front_is_pushed_back():
    points = np.concatenate([grid(2.0), [on(32, 32, 2.0 - 3.0 / 60.0)]])
    assert loss(np.concatenate([grid(2.0), grid(2.3)]), wall())[0] == 0.0
    value, gradient = loss(points, wall())
    assert value == pytest.approx(9.0 * 9.0 / (9.0 + 9.0) * 1024.0 / len(points), rel=1e-9)
    # The camera looks along -z of the world: downhill is away from it.
    assert gradient[-1, 2] > 0.0
    assert not gradient[:-1].any()


def test_a_point_on_the_nearer_side_of_an_edge_is_not_taken_to_be_in_front_of_the_farther():
    depth = wall()
    depth[:, 32:] += 0.5
    edge = np.full_like(depth, np.nan)
    edge[30, 30:36] = depth[30, 30:36]
    reached = [on(c, 30, edge[30, c]) for c in range(30, 36)]
    assert loss([*reached, on(31.6, 30, 2.0)], edge)[0] == 0.0
    assert loss([*reached, on(34.0, 30, 2.0)], edge)[0] > 0.0
