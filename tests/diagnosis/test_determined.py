"""How far masks and depth maps determine a shape: the normal matrix, and what follows from it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import oracles
from tests.scenes import example, problem_of, turned
from tso_cli import Camera, RefineConfig, refine
from tso_cli.diagnosis.determined import (
    NEIGHBOURS,
    ROBUST_SCALE,
    all_blocks,
    contour,
    normal_blocks,
    shares_fixed,
)
from tso_cli.evaluation.footprint import footprint
from tso_cli.geometry.rotations import from_vectors
from tso_cli.losses.depth import DepthTarget
from tso_cli.losses.mask_chamfer import MaskTarget
from tso_cli.optimisation.objective import ViewTarget
from tso_cli.optimisation.presets import PRIOR_WEIGHT

CHAIR = example("chair")
CAMERA = Camera.canonical(64, 64)
FLAT = replace(CAMERA, K=CAMERA.K @ np.diag([0.5, 0.5, 1.0]), model="orthographic")


def ball(count: int = 500, radius: float = 0.4) -> np.ndarray:
    """Points of a sphere, evenly spread (Fibonacci)."""
    height = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    turn, ring = np.pi * (1.0 + 5.0**0.5) * np.arange(count), np.sqrt(1.0 - height**2)
    return radius * np.stack([ring * np.cos(turn), ring * np.sin(turn), height], 1)


BALL = ball()


def target(points, camera, weight=1.0, depth=None) -> ViewTarget:
    """What `camera` shows of a cloud, without gaps between its points."""
    mask = MaskTarget.of(np.float64(footprint(points, camera)))
    depth_target = None if depth is None else DepthTarget.of(depth, mask.inside, camera)
    return ViewTarget(camera, mask, depth_target, weight)


def depth_of_ball(camera: Camera = CAMERA) -> np.ndarray:
    """The depths of the front of `BALL`, NaN beside it."""
    rows, columns = np.indices((64, 64))
    rays = np.stack([columns, rows, np.ones((64, 64))], -1) @ np.linalg.inv(camera.K).T
    # |s ray - t|^2 = 0.16, the nearer of its two solutions.
    a, b, c = (rays**2).sum(-1), rays @ camera.t, camera.t @ camera.t - 0.16
    with np.errstate(invalid="ignore"):
        return (b - np.sqrt(b**2 - a * c)) / a


def blocks(points, *views) -> np.ndarray:
    return sum(normal_blocks(points, view) for view in views)


def confidence(points, *views) -> np.ndarray:
    return shares_fixed(points, blocks(points, *views))


def from_the_right(camera: Camera, degrees: float = 90.0) -> Camera:
    turn = from_vectors(np.array([0.0, np.radians(degrees), 0.0]))
    return replace(camera, R=turn @ camera.R)


def residuals(points: torch.Tensor, view: ViewTarget) -> torch.Tensor:
    """Weighted residuals of a mask's contour and a depth map; who answers for whom is fixed."""
    scale = 64.0 / max(view.mask.inside.shape)
    pixels, depths = oracles.project(points, view.camera)
    rows, columns = np.nonzero(contour(view.mask))
    cells = torch.tensor(np.stack([columns, rows], 1), dtype=torch.float64)
    offsets = scale * (pixels[torch.cdist(cells, pixels.detach()).argmin(1)] - cells)
    weight = view.weight * scale * slope(offsets.detach().square().sum(1))
    parts = [(weight.sqrt()[:, None] * offsets).flatten()]
    if view.depth is not None:
        surface, per_unit = map(torch.tensor, (view.depth.surface, view.depth.per_unit))
        owner = torch.cdist(surface, points.detach()).argmin(1)
        squared = (points[owner] - surface).square().sum(1).detach() * per_unit**2
        weight = view.weight * scale**2 * slope(squared)
        of_surface = oracles.project(surface, view.camera)[1]
        parts.append(weight.sqrt() * per_unit * (depths[owner] - of_surface))
    return torch.cat(parts)


def slope(squared: torch.Tensor) -> torch.Tensor:
    """The derivative of the robust cost, by autograd: the weight of a residual."""
    squared = squared.clone().requires_grad_()
    return torch.autograd.grad(oracles.robust(squared, ROBUST_SCALE).sum(), squared)[0]


@pytest.mark.parametrize("camera", [CAMERA, FLAT], ids=["perspective", "orthographic"])
def test_the_blocks_are_those_of_the_jacobian_of_the_residuals(camera):
    points = ball(60) + 0.02 * np.random.default_rng(0).normal(size=(60, 3))
    turned_camera = replace(camera, R=from_vectors(np.array([0.4, -0.8, 0.3])) @ camera.R)
    depth = depth_of_ball(turned_camera) if camera is CAMERA else None
    view = target(BALL, turned_camera, 0.7, depth)
    J = torch.autograd.functional.jacobian(
        lambda flat: residuals(flat.reshape(-1, 3), view), torch.tensor(points).flatten()
    )
    normal = (J.T @ J).reshape(60, 3, 60, 3).numpy()
    index = np.arange(60)
    np.testing.assert_allclose(blocks(points, view), normal[index, :, index], atol=1e-8)
    # A residual concerns one point: there is nothing beside the blocks.
    normal[index, :, index] = 0.0
    assert not normal.any()


def test_a_confidence_is_the_share_of_the_variance_that_the_evidence_takes_off():
    points = ball(200)
    evidence = blocks(points, target(points, CAMERA))
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    held = PRIOR_WEIGHT * 1024.0 / 200
    shares = []
    for near in np.argsort(apart, axis=1)[:, :NEIGHBOURS]:
        found = np.linalg.eigvalsh(evidence[near].mean(0))
        shares.append((found / (found + held)).mean())
    np.testing.assert_allclose(shares_fixed(points, evidence), shares, atol=1e-9)


def test_one_mask_determines_nothing_along_the_lines_of_sight():
    found = blocks(BALL, target(BALL, CAMERA))
    sight = BALL - CAMERA.position
    assert found.any()
    np.testing.assert_allclose(np.einsum("nij,nj->ni", found, sight), 0.0, atol=1e-9)
    assert confidence(BALL, target(BALL, FLAT)).max() <= 2.0 / 3.0


def test_a_second_mask_from_the_side_determines_what_the_first_does_not():
    along = CAMERA.R[2]
    side, behind = (target(BALL, from_the_right(FLAT, degrees)) for degrees in (90.0, 180.0))
    first = target(BALL, FLAT)
    depth = {
        name: np.einsum("i,nij,j->", along, blocks(BALL, first, view), along)
        for name, view in {"side": side, "behind": behind}.items()
    }
    assert depth["behind"] == pytest.approx(0.0, abs=1e-9)
    assert depth["side"] > 100.0
    one, opposite, both = (
        confidence(BALL, *views).mean() for views in ((first,), (first, behind), (first, side))
    )
    assert one < opposite < both


def test_a_depth_map_determines_the_depth_of_what_it_sees():
    mask, both = target(BALL, CAMERA), target(BALL, CAMERA, depth=depth_of_ball())
    added = blocks(BALL, both) - blocks(BALL, mask)
    along = CAMERA.R[2]
    of_depth = np.einsum("i,nij,j->n", along, added, along)
    np.testing.assert_allclose(np.trace(added, axis1=1, axis2=2), of_depth, atol=1e-8)
    towards = -(BALL @ along)
    assert of_depth[towards > 0.2].min() > 0.0
    assert of_depth[towards < 0.0].max() == 0.0
    # What lies beside has a little of it.
    more = confidence(BALL, both) - confidence(BALL, mask)
    assert more[towards > 0.2].mean() > 0.2
    assert more[towards < -0.2].mean() < 0.05


def test_a_point_within_or_behind_others_is_less_determined_than_one_at_the_outline():
    within = 0.3 * ball(100)
    points = np.concatenate([BALL, within])
    found = confidence(points, *(target(BALL, turned(CAMERA, angle)) for angle in (0.0, 90.0)))
    at_outline = np.abs(BALL @ CAMERA.R[2]) < 0.05
    assert found[len(BALL) :].max() < 0.05
    assert found[: len(BALL)][at_outline].mean() > 0.5


def test_what_is_far_from_its_point_determines_nothing():
    far = BALL * 0.2
    near, lost = (blocks(points, target(BALL, CAMERA)) for points in (BALL, far))
    assert lost.sum() < 0.05 * near.sum()


def test_a_finer_grid_says_the_same():
    shares = [
        confidence(BALL, target(BALL, CAMERA.resized(size, size))).mean() for size in (64, 128)
    ]
    assert shares[0] == pytest.approx(shares[1], rel=0.05)


@given(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3), st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_a_world_that_is_turned_has_turned_blocks_and_the_same_confidence(vector, seed):
    points = BALL + 0.03 * np.random.default_rng(seed).normal(size=BALL.shape)
    turn = from_vectors(np.array(vector))
    views = [target(BALL, CAMERA), target(BALL, CAMERA.before_placed(turn, np.zeros(3), 1.0))]
    views[1] = replace(views[0], camera=views[1].camera)
    plain, moved = blocks(points, views[0]), blocks(points @ turn, views[1])
    np.testing.assert_allclose(moved, turn.T @ plain @ turn, atol=1e-6 * plain.max())
    found = confidence(points, views[0])
    assert found.min() >= 0.0
    assert found.max() <= 1.0


def test_a_view_that_sees_no_point_says_nothing():
    behind = replace(CAMERA, t=np.array([0.0, 0.0, -5.0]))
    assert not blocks(BALL, replace(target(BALL, CAMERA), camera=behind)).any()


def test_a_flipped_view_counts_as_a_quarter_of_its_original():
    problem = problem_of(CHAIR.points, CHAIR.view, symmetry="x")
    points, weights = problem.cloud.start, [0.8]
    given, flipped = (normal_blocks(points, view) for view in problem.targets(weights).views)
    found = all_blocks(points, problem, weights)
    np.testing.assert_allclose(found, given + 0.25 * flipped)


def test_the_result_says_what_is_determined():
    result = refine(CHAIR.points, CHAIR.view, config=RefineConfig(point_confidence=True))
    assert 0.2 < result.determined < 2.0 / 3.0
    assert result.point_confidence.shape == (len(CHAIR.points),)
    assert result.point_confidence.mean() == pytest.approx(result.determined)


def test_of_the_preset_paper_nothing_is_said():
    result = refine(CHAIR.points, CHAIR.view, config=RefineConfig(preset="paper", steps=2))
    assert result.determined is result.point_confidence is None


def test_vertices_and_points_that_follow_are_interpolated_and_outliers_have_none():
    dense = example("chair").target
    rng = np.random.default_rng(0)
    more = np.concatenate([dense, dense + 0.002 * rng.normal(size=dense.shape), [[9.0, 9.0, 9.0]]])
    result = refine(more, CHAIR.view, config=RefineConfig(point_confidence=True))
    assert result.outliers[-1]
    assert result.point_confidence[-1] == 0.0
    twins = result.point_confidence[:-1].reshape(2, -1)
    assert np.corrcoef(twins)[0, 1] > 0.9
