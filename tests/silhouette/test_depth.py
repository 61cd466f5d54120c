"""The depth loss, its gradient, and refinements with depth maps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tso_cli.silhouette.depth import DepthTarget, depth_loss

from tso_cli import Camera, RefineConfig, refine, refine_batch
from tso_cli.errors import InputError
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.points import normalise_longest_side
from tso_cli.geometry.view import View
from tso_cli.refinement.objective import MaskChamferObjective, ViewTargets
from tso_cli.refinement.resampled_view import resample_view
from tso_cli.silhouette.projection import CameraBatch, Projected, project

SIZE = 64
CAMERA = Camera.canonical(SIZE, SIZE)


def wall(depth: float = 2.0) -> np.ndarray:
    """A depth map of a wall, square to the camera, known in its middle."""
    wall = np.full((SIZE, SIZE), np.nan)
    wall[24:40, 24:40] = depth
    return wall


def on(column: float, row: float, depth: float) -> list[float]:
    """The world point that the canonical camera sees at that pixel and depth."""
    return [(column - 31.5) / 120.0 * depth, -(row - 31.5) / 120.0 * depth, 2.0 - depth]


def cost(points: np.ndarray, depth: np.ndarray, robust_scale: float = 3.0) -> float:
    return float(loss(torch.tensor(points, dtype=torch.float64).reshape(1, -1, 3), depth, robust_scale))


def loss(points: torch.Tensor, depth: np.ndarray, robust_scale: float = 3.0) -> torch.Tensor:
    cameras = CameraBatch.of([CAMERA], points).one_each()
    inside = torch.ones(1, SIZE, SIZE, dtype=torch.bool)
    target = DepthTarget.of(torch.tensor(depth, dtype=points.dtype)[None], inside, cameras)
    projected = Projected(*(part[:, 0] for part in project(points, cameras)))
    return depth_loss(points, projected, target, robust_scale, torch.tensor([points.shape[1]]))


def grid(depth: float, step: float = 1.0) -> np.ndarray:
    return np.array([on(c, r, depth) for c in np.arange(24, 40, step) for r in np.arange(24, 40, step)])


def test_a_surface_that_no_point_reaches_costs_the_robust_square_of_its_distance_in_pixels():
    """One pixel, one point 4 px behind its surface: 120 px to 2 units, so 60 px to one."""
    depth = np.full((SIZE, SIZE), np.nan)
    depth[30, 30] = 2.0
    behind = np.array([on(30, 30, 2.0 + 4.0 / 60.0)])
    distance = np.linalg.norm(behind[0] - on(30, 30, 2.0)) * 60.0
    assert cost(behind, depth, 3.0) == pytest.approx(distance**2 * 9.0 / (9.0 + distance**2), rel=1e-9)


def test_covered_surfaces_and_points_hidden_behind_them_cost_nothing():
    assert cost(np.concatenate([grid(2.0), grid(2.3)]), wall()) == 0.0


def test_a_point_in_front_of_the_surface_is_pushed_back():
    points = np.concatenate([grid(2.0), [on(32, 32, 2.0 - 3.0 / 60.0)]])
    expected = 9.0 * 4.0 / (4.0 + 9.0) * 1024.0 / len(points)
    assert cost(points, wall(), 2.0) == pytest.approx(expected, rel=1e-9)
    moved = torch.tensor(points)[None].requires_grad_()
    loss(moved, wall(), 2.0).sum().backward()
    slope = moved.grad[0]
    assert slope[:-1].abs().max() == 0.0
    # the camera looks along -z of the world: downhill is away from it
    assert slope[-1, 2] > 0.0


def test_a_point_on_the_nearer_side_of_an_edge_is_not_taken_to_be_in_front_of_the_farther():
    depth = wall()
    depth[:, 32:] += 0.5
    near = np.array([on(31.6, 30, 2.0)])
    far = np.array([on(34.0, 30, 2.0)])
    free = wall()
    free[:] = np.nan
    free[30, 30:36] = depth[30, 30:36]
    reached = np.array([on(c, 30, free[30, c]) for c in range(30, 36)])
    assert cost(np.concatenate([reached, near]), free) == 0.0
    assert cost(np.concatenate([reached, far]), free) > 0.0


def test_the_gradient_is_that_of_finite_differences():
    rng = np.random.default_rng(3)
    depth = wall() + 0.05 * rng.standard_normal((SIZE, SIZE))
    points = torch.tensor(rng.uniform(-0.2, 0.2, (1, 40, 3)), dtype=torch.float64, requires_grad=True)
    assert float(loss(points.detach(), depth)) > 1.0
    assert torch.autograd.gradcheck(lambda moved: loss(moved, depth), points, eps=1e-7, atol=1e-4, rtol=1e-4)


def test_a_depth_map_is_resampled_without_averaging_across_edges():
    camera = Camera.canonical(256, 256)
    depth = np.where(np.arange(256) < 130, 2.0, 3.0)[None].repeat(256, 0)
    mask = np.zeros((256, 256), np.float32)
    mask[64:192, 64:192] = 1.0
    resampled = resample_view(View(mask, camera, depth=depth), 0.4, np.zeros(3), 2.0)
    assert resampled.depth.shape == (64, 64)
    assert set(np.unique(resampled.depth)) == {1.0, 1.5}


def sheet(slope: float) -> np.ndarray:
    """A square sheet, nearer to the camera on its right."""
    x, y = np.random.default_rng(0).uniform(-0.45, 0.45, (2, 600))
    return np.stack([x, y, slope * x], 1)


def seen_sheet() -> tuple[np.ndarray, View]:
    """A sheet square to the camera as the start of a tilted one, whose mask hardly tells."""
    mask = np.zeros((SIZE, SIZE), np.float32)
    mask[5:59, 5:59] = 1.0
    across = (np.arange(SIZE) - 31.5) / 120.0
    depth = np.where(mask > 0.5, 2.0 / (1.0 + 0.4 * across), np.nan)
    return sheet(0.0), View(mask, CAMERA, depth=depth)


def test_a_depth_map_brings_a_cloud_nearer_than_its_mask_alone():
    start, view = seen_sheet()
    target = sheet(0.4)
    alone = View(view.mask, CAMERA)
    config = RefineConfig(steps=45, symmetry="none")
    with_depth, without = (chamfer(refine(start, v, config=config).points, target).chamfer for v in (view, alone))
    assert with_depth < 0.3 * without


def test_views_with_and_without_a_depth_map_add_up():
    start, view = seen_sheet()
    other = View(view.mask.T.copy(), Camera(CAMERA.K, np.diag([1.0, 1.0, 1.0]), CAMERA.t, SIZE, SIZE))
    points = torch.tensor(start)[None]

    def total(*views: View) -> float:
        resampled = [resample_view(one, 0.4, np.zeros(3), 1.0) for one in views]
        return float(MaskChamferObjective(ViewTargets([resampled], torch.tensor([len(start)]), points), 3.0)(points))

    assert total(view, other) == pytest.approx(total(view) + total(other), rel=1e-6)
    assert total(view) > total(View(view.mask, CAMERA)) + 10.0


def test_unusable_depth_maps_are_refused():
    start, view = seen_sheet()
    mask = view.mask
    with pytest.raises(InputError, match=r"depth map has shape \[3, 3\], the mask is 64x64"):
        View(mask, CAMERA, depth=np.ones((3, 3)))
    with pytest.raises(InputError, match="smallest depth is -1, expected 0"):
        View(mask, CAMERA, depth=-np.ones((SIZE, SIZE)))
    with pytest.raises(InputError, match="no foreground pixel has a depth"):
        View(mask, CAMERA, depth=np.where(mask > 0.5, 0.0, 2.0))
    flat = Camera(CAMERA.K, CAMERA.R, CAMERA.t, SIZE, SIZE, "orthographic")
    with pytest.raises(InputError, match="orthographic, expected perspective"):
        View(mask, flat, depth=np.ones((SIZE, SIZE)))
    with pytest.raises(InputError, match="preset best, found points with paper"):
        refine(normalise_longest_side(start), view, config=RefineConfig(preset="paper"))


def test_depth_maps_without_known_pixels_and_points_behind_the_camera_cost_nothing():
    assert cost(grid(2.2), np.full((SIZE, SIZE), np.nan)) == 0.0
    assert cost(np.array([[0.0, 0.0, 5.0]]), wall()) == 0.0


def test_the_unit_changes_nothing_and_scenes_with_and_without_depth_share_a_batch():
    start, view = seen_sheet()
    config = RefineConfig(steps=9, symmetry="none")
    expected = refine(start, view, config=config).points
    large = replace(view, camera=replace(CAMERA, t=1000.0 * CAMERA.t), depth=1000.0 * view.depth)
    assert np.abs(refine(1000.0 * start, large, config=config).points / 1000.0 - expected).max() < 1e-4
    both = refine_batch([(start, view), (start, View(view.mask, CAMERA))], config)
    assert np.abs(both[0].points - expected).max() < 1e-5
