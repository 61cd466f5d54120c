"""The mask Chamfer loss against all pairs in torch."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from tests import oracles
from tests.scenes import block
from tso_cli.geometry.camera import NEAR
from tso_cli.losses.mask_chamfer import (
    COVERED_WITHIN,
    RESOLVED,
    MaskTarget,
    mask_chamfer,
    resolved_share,
)
from tso_cli.optimisation.objective import ViewTarget, ViewTargets

from .common import assert_equal, assert_gradient, by_autograd
from .scenes import HEIGHT, PLACES, WIDTH, camera_of, points_at, points_of, scattered

RANDOM = np.random.default_rng(0)
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
DISC = ((ROWS - 12) ** 2 / 40 + (COLUMNS - 15) ** 2 / 90 < 1).astype(float)
LINE = np.where(ROWS == COLUMNS // 2 + 3, 0.3, 0.0)
KNOWN = (RANDOM.random(DISC.shape) < 0.9).astype(float)
LARGER_IMAGE = (-0.5, -2.3, 40.5, 30.0)

PARTS = "parts that the mask hardly resolves"
# Targets, and the camera's model.
SCENES = {
    "one object": (MaskTarget.of(DISC), "perspective"),
    "orthographic": (MaskTarget.of(DISC), "orthographic"),
    "a mask with holes and unknown pixels": (
        MaskTarget.of(DISC * KNOWN[::-1], KNOWN),
        "perspective",
    ),
    "a truncated object": (
        MaskTarget.of(np.where(COLUMNS > 18, DISC.max(), DISC), truncated=True),
        "perspective",
    ),
    "a mask thinner than a pixel": (MaskTarget.of(LINE), "perspective"),
    "an enlarged mask": (MaskTarget.of(DISC, cells_per_mask_pixel=3.3), "perspective"),
    "a mask enlarged beyond the pixels next to a point": (
        MaskTarget.of(DISC, cells_per_mask_pixel=4.5),
        "perspective",
    ),
    "a part of a larger image": (MaskTarget.of(DISC, bounds=LARGER_IMAGE), "perspective"),
    PARTS: (MaskTarget.of(DISC), "perspective"),
}


def _scene(name: str) -> tuple[ViewTargets, np.ndarray]:
    """The targets of one view, and points that lie in front of the camera and behind it."""
    target, model = SCENES[name]
    camera, pixels = camera_of(model), scattered()
    depth = np.random.default_rng(3).uniform(1.0, 3.0, len(pixels))
    depth[3:60:8] *= -1.0
    resolved = np.random.default_rng(4).random(len(pixels)) if name == PARTS else None
    views = ViewTargets((ViewTarget(camera, target, None, 0.7, resolved),))
    return views, points_at(pixels, camera, depth)


def _oracle(points: torch.Tensor, targets: ViewTargets) -> torch.Tensor:
    """The loss by one view from all pairs of points and pixels."""
    (view,) = targets.views
    target, (pixels, depth) = view.mask, oracles.project(points, view.camera)
    valid = (depth > NEAR) | (view.camera.model == "orthographic")
    left, top, right, bottom = target.bounds
    x, y = pixels.detach().T
    in_image = valid & (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
    observed = in_image if target.truncated else valid
    area = target.scale**2
    # Of foreground pixels equally near, the uppermost, then the leftmost one counts.
    foreground = torch.tensor(np.argwhere(target.inside)[:, ::-1].copy(), dtype=torch.float64)
    squared = (foreground[:, None] - pixels).square().sum(2)
    nearest = squared.masked_fill(~valid, torch.inf).argmin(1)
    squared = squared.gather(1, nearest[:, None])[:, 0]
    paired = observed[nearest] & (squared > (COVERED_WITHIN * target.cells_per_mask_pixel) ** 2)
    uncovered = (squared[paired] * area**2).sum()
    own_pixel = torch.stack([x.clamp(0, WIDTH - 1), y.clamp(0, HEIGHT - 1)], 1).round()
    on_background = observed & in_image
    on_background[on_background.clone()] = torch.tensor(target.outside)[
        tuple(own_pixel[on_background].long().T.flip(0))
    ]
    nearest = (own_pixel[:, None] - foreground).square().sum(2).argmin(1)
    outside = (pixels - foreground[nearest]).square().sum(1) * area * (1024.0 / len(points))
    if view.resolved is not None:
        outside = outside * torch.tensor(view.resolved)
    return view.weight * (uncovered + outside[on_background].sum())


def _of_points(targets: ViewTargets, some: np.ndarray) -> ViewTargets:
    """The targets for ``some`` points of the scene."""
    (view,) = targets.views
    return ViewTargets(
        (view if view.resolved is None else replace(view, resolved=view.resolved[some]),)
    )


@pytest.mark.parametrize("name", SCENES)
def test_value_and_gradient_are_those_of_all_pairs(name):
    targets, points = _scene(name)
    expected = by_autograd(lambda leaf: _oracle(leaf, targets), points)
    assert expected[0] > 1.0
    assert_equal(targets.loss(points), expected)


def test_of_points_equally_near_the_first_is_drawn():
    targets, points = _scene("one object")
    twice = np.concatenate([points, points])
    assert_equal(targets.loss(twice), by_autograd(lambda leaf: _oracle(leaf, targets), twice))


@pytest.mark.parametrize("name", SCENES)
def test_the_gradient_is_that_of_finite_differences(name):
    targets, points = _scene(name)
    some = np.r_[:12, len(points) - 8 : len(points)]
    assert_gradient(_of_points(targets, some).loss, points[some], 1e-7, 1e-4)


@settings(max_examples=40, deadline=None)
@given(PLACES, st.sampled_from(sorted(SCENES)))
def test_any_points_cost_what_all_pairs_cost(places, name):
    targets, _ = _scene(name)
    points = points_of(places, targets.views[0].camera)
    targets = _of_points(targets, np.arange(len(points)))
    value, gradient = targets.loss(points)
    if np.isfinite(value):
        expected = by_autograd(lambda leaf: _oracle(leaf, targets), points)[0]
        assert value == pytest.approx(expected, rel=1e-8, abs=1e-8)
    else:
        assert not gradient.any()


@pytest.mark.parametrize("name", ["one object", "a truncated object"])
def test_a_view_that_observes_no_point_has_an_infinite_loss(name):
    targets, points = _scene(name)
    places, camera = ((9.0, -2.0), (-50.0, 2.0)), targets.views[0].camera
    behind, beyond = (
        points_at(np.full((4, 2), place), camera, np.full(4, depth)) for place, depth in places
    )
    value, gradient = targets.loss(behind)
    assert value == np.inf
    assert not gradient.any()
    # Points beyond the border that truncates the object cannot be compared.
    assert np.isinf(targets.loss(beyond)[0]) == (name == "a truncated object")
    unweighted = ViewTargets((replace(targets.views[0], weight=0.0),))
    assert unweighted.loss(behind)[0] == 0.0


def _loss(pixels, target: MaskTarget) -> tuple[float, np.ndarray]:
    """By pixels in place of points."""
    return mask_chamfer(np.asarray(pixels, float), np.ones(len(pixels), bool), target)


def test_a_covered_mask_costs_nothing():
    square = block(np.s_[20:30, 20:30])
    value, gradient = _loss(
        np.argwhere(square)[:, ::-1] + 0.5 * COVERED_WITHIN, MaskTarget.of(square)
    )
    assert value == 0.0
    assert not gradient.any()


def test_a_strip_of_0_7_px_hardly_counts_outside_the_mask_and_a_wide_one_fully():
    """The share is the variance across, of pixels of the mask, over that of a resolved part."""
    grid = np.stack(np.meshgrid(np.linspace(-5.0, 5.0, 41), np.linspace(-0.5, 0.5, 101)), -1)
    strips = [grid.reshape(-1, 2) * [1.0, width] for width in (0.7, 3.0, 30.0)]
    for scale in (1.0, 2.0):
        share = resolved_share(scale * np.stack(strips), scale)
        assert share[0] == pytest.approx(0.7**2 / 12.0 / RESOLVED**2, rel=0.05)
        np.testing.assert_array_equal(share[1:], 1.0)


def test_a_turned_part_is_resolved_as_it_was():
    parts = np.random.default_rng(5).normal(size=(6, 24, 2)) * [3.0, 0.4]
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    share = resolved_share(parts)
    assert 0.0 < share.min() <= share.max() < 1.0
    np.testing.assert_allclose(resolved_share(parts @ turn + 7.0), share)


def test_an_image_of_twice_the_size_costs_the_same():
    mask, points = block(np.s_[10:40, 20:50]), np.random.default_rng(2).uniform(5, 55, (40, 2))
    finer = _loss((points + 0.5) * 2 - 0.5, MaskTarget.of(mask.repeat(2, 0).repeat(2, 1)))[0]
    assert finer == pytest.approx(_loss(points, MaskTarget.of(mask))[0], rel=0.05)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 40), (40, 1), (30, 47)])
@pytest.mark.parametrize("share", [0.003, 0.05, 0.6])
def test_the_nearest_foreground_pixel_is_as_near_as_scipys(height, width, share):
    inside = np.random.default_rng(height * width).random((height, width)) < share
    inside[0, -1] = True
    nearest = MaskTarget.of(inside.astype(float)).nearest_foreground
    assert inside[tuple(np.moveaxis(nearest, 2, 0))].all()
    distance = np.linalg.norm(nearest - np.moveaxis(np.mgrid[:height, :width], 0, 2), axis=2)
    np.testing.assert_allclose(distance, distance_transform_edt(~inside), atol=1e-9)
