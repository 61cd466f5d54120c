"""The mask Chamfer loss, and that the compiled loop is plain torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tso_cli.silhouette.mask_chamfer import COVERED_WITHIN, MaskTarget, mask_chamfer_loss, resolvability

from tso_cli.silhouette import mask_chamfer


def _mask(seed: int = 0, height: int = 24, width: int = 32) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[:height, :width]
    disc = (row - 12) ** 2 / 40 + (column - 15) ** 2 / 90 < 1
    return torch.tensor(np.stack([disc, disc & (rng.random(disc.shape) < 0.9)]).astype(np.float64))


def _points(count: int = 60, seed: int = 1) -> torch.Tensor:
    return torch.tensor(np.random.default_rng(seed).uniform([-3, -3], [35, 27], (2, count, 2)))


def _loss(points, mask, robust_scale=3.0, valid=None, known=None, counts=None):
    valid = torch.ones(points.shape[:2], dtype=torch.bool) if valid is None else valid
    return mask_chamfer_loss(points, valid, MaskTarget.of(mask, known), robust_scale, counts)


def test_a_covered_mask_costs_nothing():
    mask = torch.zeros(1, 64, 64, dtype=torch.float64)
    mask[0, 20:30, 20:30] = 1.0
    rows, columns = torch.nonzero(mask[0], as_tuple=True)
    points = torch.stack([columns, rows], -1)[None].double() + 0.5 * COVERED_WITHIN
    assert _loss(points, mask).item() == 0.0


@pytest.mark.parametrize("grain", [1.0, 6.0])
def test_cells_that_a_point_covers_are_the_same_marked_or_measured(grain, monkeypatch):
    mask, points = _mask(), _points().requires_grad_()
    target = MaskTarget.of(mask, grain=torch.tensor([grain, 0.5 * grain]))
    valid = torch.arange(60).expand(2, 60) % 5 > 0
    results = []
    for most in (100.0, 0.0):
        monkeypatch.setattr(mask_chamfer, "MARKED_WITHIN", most)
        loss = mask_chamfer_loss(points, valid, target, 3.0)
        results.append((loss.detach(), *torch.autograd.grad(loss.sum(), points)))
    for marked, measured in zip(*results, strict=True):
        torch.testing.assert_close(measured, marked, rtol=1e-12, atol=1e-12)


def test_points_outside_the_image_or_on_unknown_pixels_cost_nothing():
    mask = torch.zeros(1, 16, 16, dtype=torch.float64)
    mask[0, 4, 10] = 1.0
    known = torch.ones_like(mask)
    known[0, :, :3] = 0.0
    there = torch.tensor([[[10.0, 4.0], [-5.0, 4.0], [1.0, 8.0]]], dtype=torch.float64)
    assert _loss(there, mask, known=known).item() == 0.0
    assert _loss(there, mask).item() > 0.0


def test_pixels_many_times_the_robust_scale_away_have_next_to_no_gradient():
    mask = torch.zeros(1, 64, 64, dtype=torch.float64)
    mask[0, 4, 60] = 1.0
    point = torch.tensor([[[10.0, 4.0]]], dtype=torch.float64, requires_grad=True)
    far, near = (torch.autograd.grad(_loss(point, mask, scale).sum(), point)[0].abs().max() for scale in (2.0, 200.0))
    assert far < 1e-3 * near


def test_the_gradient_is_that_of_finite_differences():
    points, mask = _points(12).requires_grad_(), _mask()
    assert torch.autograd.gradcheck(lambda points: _loss(points, mask), points)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("truncated", [False, True])
def test_compiled_and_plain_agree(monkeypatch, dtype, truncated):
    points, mask = _points().to(dtype).requires_grad_(), _mask()
    if truncated:
        mask[1, 8:16, 20:] = 1.0
    valid = torch.rand(points.shape[:2], generator=torch.Generator().manual_seed(0)) < 0.8
    known = (torch.rand(mask.shape, generator=torch.Generator().manual_seed(1)) < 0.9).double()
    results = []
    for compiled in (False, True):
        monkeypatch.setattr(mask_chamfer, "use_numba", lambda points, compiled=compiled: compiled)
        loss = _loss(points, mask, valid=valid, known=known, counts=torch.tensor([60, 50]))
        results.append((loss.detach(), torch.autograd.grad(loss.sum(), points)[0]))
    for plain, fast in zip(*results, strict=True):
        torch.testing.assert_close(fast, plain, rtol=1e-5 if dtype == torch.float32 else 1e-12, atol=1e-6)


def test_an_image_of_twice_the_size_costs_the_same():
    mask = torch.zeros(1, 64, 64, dtype=torch.float64)
    mask[0, 10:40, 20:50] = 1.0
    points = torch.tensor(np.random.default_rng(2).uniform(5, 55, (1, 40, 2)))
    finer = mask.repeat_interleave(2, 1).repeat_interleave(2, 2)
    assert _loss((points + 0.5) * 2 - 0.5, finer).item() == pytest.approx(_loss(points, mask).item(), rel=0.05)


def test_a_strip_thinner_than_a_pixel_is_not_resolved_and_a_wider_one_is():
    along = torch.linspace(0, 6, 12, dtype=torch.float64)
    across = torch.tensor([-0.5, 0.5] * 6, dtype=torch.float64)
    strips = torch.stack([torch.stack([along, width * across], -1) for width in (0.2, 1.0, 2.0)])
    # half as far from the middle as it is wide, which is its standard deviation
    expected = torch.tensor([0.0, (0.5 - 0.2) / 0.6, 1.0], dtype=torch.float64)
    enlarged = resolvability(2.0 * strips, torch.full((3,), 2.0, dtype=torch.float64))
    for result in (resolvability(strips), enlarged):
        torch.testing.assert_close(result, expected, rtol=0.0, atol=0.02)


def test_stray_points_are_weighted_by_their_resolvability():
    points, mask = _points(), _mask()
    valid, target = torch.ones(points.shape[:2], dtype=torch.bool), MaskTarget.of(mask)
    unresolved, half, resolved = (
        mask_chamfer_loss(points, valid, target, 3.0, resolvability=torch.full_like(points[..., 0], x)) for x in (0.0, 0.5, 1.0)
    )
    torch.testing.assert_close(resolved, mask_chamfer_loss(points, valid, target, 3.0))
    torch.testing.assert_close(half, (unresolved + resolved) / 2.0)
    assert (unresolved < resolved).all()
    assert (unresolved > 0.0).all()


def test_of_a_truncated_object_pixels_nearest_to_points_beyond_the_border_cost_nothing():
    mask = torch.zeros(1, 64, 64)
    mask[0, 20:40, :30] = 1.0  # it goes on to the left
    points = torch.tensor([[[10.0, 30.0], [-6.0, 22.0]]], requires_grad=True)
    there = torch.ones(1, 2, dtype=torch.bool)
    loss = mask_chamfer_loss(points, there, MaskTarget.of(mask), 6.0)
    (grad,) = torch.autograd.grad(loss.sum(), points)
    assert (grad[0, 1] == 0.0).all()
    # The same as a mask in which those pixels are unknown.
    rows, columns = torch.meshgrid(torch.arange(64.0), torch.arange(64.0), indexing="ij")
    to_each = [(columns - x).square() + (rows - y).square() for x, y in points.detach()[0].tolist()]
    known = (to_each[0] <= to_each[1]).float()[None]
    alone = mask_chamfer_loss(points[:, :1], there[:, :1], MaskTarget.of(mask, known), 6.0, torch.tensor([2.0]))
    assert loss.item() == pytest.approx(alone.item(), rel=1e-6)


def test_of_an_object_that_is_not_truncated_a_point_beyond_the_border_is_attracted():
    mask = torch.zeros(1, 64, 64)
    mask[0, 20:40, 2:30] = 1.0
    point = torch.tensor([[[-6.0, 22.0]]], requires_grad=True)
    _loss(point, mask, 6.0).sum().backward()
    assert point.grad[0, 0, 0] < 0.0
    assert _loss(point, mask, 6.0, valid=torch.zeros(1, 1, dtype=torch.bool)).tolist() == [0.0]
