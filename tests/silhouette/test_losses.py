"""The losses: finite and alive where the printed formulas overflow or die."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import oracles
from tso_cli.kernels.splat import splat
from tso_cli.silhouette.losses import ChamferToInitial, affinity, chamfer, silhouette_bce

SIGMA_SQ = 0.4


def _bce(points: torch.Tensor, mask: torch.Tensor, known: torch.Tensor | None = None) -> torch.Tensor:
    valid = torch.ones(1, len(points), dtype=torch.bool)
    sums = splat(points[None], valid, *mask.shape, SIGMA_SQ)
    return silhouette_bce(sums, mask[None], points[None], valid, SIGMA_SQ, None if known is None else known[None])[0]


def _affinity(points: torch.Tensor, mask: torch.Tensor, form: str) -> torch.Tensor:
    valid = torch.ones(1, len(points), dtype=torch.bool)
    return affinity(splat(points[None], valid, *mask.shape, SIGMA_SQ), mask[None], points[None], valid, form)[0]


def _disc(size: int = 64, radius: float = 12.0) -> torch.Tensor:
    axis = torch.arange(size, dtype=torch.float64) - (size - 1) / 2.0
    return ((axis[:, None] ** 2 + axis[None] ** 2) < radius**2).double()


def _value_and_gradient(loss, points: torch.Tensor) -> tuple[float, torch.Tensor]:
    leaf = points.clone().requires_grad_()
    value = loss(leaf)
    value.backward()
    assert leaf.grad is not None
    return value.item(), leaf.grad


def test_a_thousand_points_stacked_on_a_background_pixel_still_feel_it():
    points = torch.tensor([[10.3, 10.0]]).repeat(1000, 1)
    mask = _disc().float()
    value, gradient = _value_and_gradient(lambda p: _bce(p, mask), points)
    assert torch.isfinite(torch.tensor(value))
    assert torch.isfinite(gradient).all()
    assert (gradient.abs().sum(1) > 1e-3).all()


def test_a_mask_pixel_thirty_pixels_away_pulls_its_nearest_point():
    mask = torch.zeros(64, 64)
    mask[40, 50] = 1.0
    points = torch.tensor([[20.0, 40.0], [5.0, 5.0]])
    value, gradient = _value_and_gradient(lambda p: _bce(p, mask), points)
    assert value > 30.0**2 / (2 * SIGMA_SQ)
    assert gradient[0, 0] < -10.0  # downhill is toward larger columns, where the pixel is


@pytest.mark.parametrize("seed", range(3))
def test_bce_is_log_sum_exp_over_all_points_where_points_cover_the_mask(seed):
    generator = torch.Generator().manual_seed(seed)
    mask = _disc()
    points = torch.rand(3000, 2, generator=generator, dtype=torch.float64) * 30 + 17
    points[:5] = torch.rand(5, 2, generator=generator, dtype=torch.float64) * 63
    mine, gradient = _value_and_gradient(lambda p: _bce(p, mask), points)
    oracle, expected = _value_and_gradient(lambda p: oracles.bce(p, mask, SIGMA_SQ), points)
    assert mine == pytest.approx(oracle, rel=1e-6)
    torch.testing.assert_close(gradient, expected, atol=1e-5 * expected.abs().max().item(), rtol=1e-4)


def test_bce_beyond_every_window_is_that_of_log_sum_exp_with_one_point():
    mask = torch.zeros(64, 64, dtype=torch.float64)
    mask[10, 12:40] = torch.linspace(0.2, 1.0, 28, dtype=torch.float64)
    points = torch.tensor([[11.3, 9.8]], dtype=torch.float64)
    mine, gradient = _value_and_gradient(lambda p: _bce(p, mask), points)
    oracle, expected = _value_and_gradient(lambda p: oracles.bce(p, mask, SIGMA_SQ), points)
    assert mine == pytest.approx(oracle, rel=1e-6)
    torch.testing.assert_close(gradient, expected, atol=1e-6, rtol=1e-6)


def test_a_point_just_beyond_its_window_is_nearer_than_the_corner_of_anothers():
    mask = torch.zeros(64, 64, dtype=torch.float64)
    mask[20, 20] = 1.0
    # the second is nearer, but only the first one's square window holds the pixel
    points = torch.tensor([[24.4, 24.4], [24.55, 20.0]], dtype=torch.float64)
    mine, gradient = _value_and_gradient(lambda p: _bce(p, mask), points)
    oracle, expected = _value_and_gradient(lambda p: oracles.bce(p, mask, SIGMA_SQ), points)
    assert mine == pytest.approx(oracle, rel=1e-6)
    torch.testing.assert_close(gradient, expected, atol=1e-4, rtol=1e-4)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 39), st.floats(0, 39)), min_size=1, max_size=5), st.integers(0, 39), st.integers(0, 39))
def test_bce_of_a_few_points_is_log_sum_exp_up_to_the_count_of_the_nearest(points, row, column):
    mask = torch.zeros(40, 40, dtype=torch.float64)
    mask[row, column] = 1.0
    tensor = torch.tensor(points, dtype=torch.float64)
    mine = _bce(tensor, mask).item() / (4096 / 1600)
    oracle = oracles.bce(tensor, mask, SIGMA_SQ).item() / (4096 / 1600)
    assert oracle - 1e-2 <= mine <= oracle + math.log(len(points)) + 1e-2


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 11), st.floats(0, 9)), min_size=1, max_size=6, unique=True), st.integers(0, 1000))
def test_the_total_pull_of_bce_is_that_of_log_sum_exp_on_soft_masks(points, seed):
    # soft masks everywhere: both terms of every pixel count
    mask = torch.rand(10, 12, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    tensor = torch.tensor(points, dtype=torch.float64)
    _, gradient = _value_and_gradient(lambda p: _bce(p, mask), tensor)
    _, expected = _value_and_gradient(lambda p: oracles.bce(p, mask, SIGMA_SQ), tensor)
    # the nearest point stands for all beyond the window; where several are as near, log-sum-exp shares the pull
    total, total_expected = gradient.sum(0), expected.sum(0)
    scale = expected.abs().sum() + 1.0
    assert (total - total_expected).abs().max() <= 0.2 * scale


def test_the_float64_gradient_of_bce_passes_finite_differences():
    mask = _disc(12, 3.0)
    points = torch.tensor([[5.5, 5.5], [5.5, 5.5], [-1.2, 4.0], [3.0, 7.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda p: _bce(p, mask), (points,), eps=1e-6, atol=1e-4, rtol=1e-4)


def test_bce_is_stated_for_64_pixels_at_any_resolution():
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(2000, 2, generator=generator, dtype=torch.float64) * 24 + 20
    mask = _disc(64)
    valid = torch.ones(1, 2000, dtype=torch.bool)
    finer = mask.repeat_interleave(2, 0).repeat_interleave(2, 1)
    finer_px = (points + 0.5) * 2 - 0.5
    sums = splat(finer_px[None], valid, 128, 128, 4 * SIGMA_SQ)
    fine = silhouette_bce(sums, finer[None], finer_px[None], valid, 4 * SIGMA_SQ)[0]
    assert fine.item() == pytest.approx(_bce(points, mask).item(), rel=0.05)


def test_unknown_pixels_neither_push_nor_pull():
    mask = _disc()
    known = torch.ones_like(mask)
    known[:, 32:] = 0.0
    points = torch.tensor([[50.0, 30.0], [55.0, 50.0]], dtype=torch.float64)
    left = mask.clone()
    left[:, 32:] = 0.3
    mine, gradient = _value_and_gradient(lambda p: _bce(p, left, known), points)
    other, gradient_other = _value_and_gradient(lambda p: _bce(p, mask, known), points)
    assert mine == other
    torch.testing.assert_close(gradient, gradient_other)


def test_the_weight_of_a_far_pixel_is_its_known_share():
    mask = torch.zeros(64, 64, dtype=torch.float64)
    mask[40, 50] = 1.0
    points = torch.tensor([[20.0, 40.0]], dtype=torch.float64)
    known = torch.ones_like(mask)
    known[40, 50] = 0.25
    rest = _bce(points, mask, 1.0 - mask)
    whole, part = _bce(points, mask) - rest, _bce(points, mask, known) - rest
    assert part.item() == pytest.approx(0.25 * whole.item())


def test_points_outside_the_image_are_not_background():
    mask = _disc()
    inside = torch.tensor([[31.0, 31.0]], dtype=torch.float64)
    with_outside = torch.cat([inside, torch.tensor([[-20.0, 30.0]], dtype=torch.float64)])
    assert _bce(with_outside, mask).item() == pytest.approx(_bce(inside, mask).item())
    assert _affinity(with_outside, mask, "points").item() == pytest.approx(_affinity(inside, mask, "points").item())


def test_the_printed_affinity_loss_is_that_of_all_pairs_of_pixels():
    generator = torch.Generator().manual_seed(4)
    points = torch.rand(40, 2, generator=generator, dtype=torch.float64) * 20
    mask = _disc(20, 6.0)
    valid = torch.ones(1, 40, dtype=torch.bool)
    silhouette = torch.tanh(splat(points[None], valid, 20, 20, SIGMA_SQ, "exact"))[0]
    soft = 0.9 * mask + 0.1 * torch.rand(20, 20, generator=generator, dtype=torch.float64)
    for own in (mask, soft):
        assert _affinity(points, own, "paper").item() == pytest.approx(oracles.affinity_paper(silhouette, own).item(), rel=1e-6)


def test_the_printed_affinity_of_a_batch_is_that_of_its_pictures_one_by_one():
    generator = torch.Generator().manual_seed(17)
    points = torch.rand(4, 60, 2, generator=generator, dtype=torch.float64) * 18
    points[3] += 100.0  # no silhouette
    masks = (torch.rand(4, 18, 20, generator=generator) > 0.8).double()
    valid = torch.ones(4, 60, dtype=torch.bool)
    sums = splat(points, valid, 18, 20, SIGMA_SQ)
    values = affinity(sums, masks, points, valid, "paper")
    for i in range(3):
        assert values[i].item() == pytest.approx(oracles.affinity_paper(torch.tanh(sums[i]), masks[i]).item(), rel=1e-9)
    assert values[3].item() == pytest.approx(0.0, abs=1e-9)


def test_of_all_pixels_that_are_not_zero_the_printed_loss_would_ask_next_to_nothing_of_an_uncovered_mask():
    """The rim of a Gaussian is not zero: the least product is found there, however far the mask pixel is."""
    mask = torch.zeros(40, 40, dtype=torch.float64)
    mask[20, 30] = 1.0
    point = torch.tensor([[[8.0, 20.0]]], dtype=torch.float64)
    silhouette = torch.tanh(splat(point, torch.ones(1, 1, dtype=torch.bool), 40, 40, SIGMA_SQ))[0]
    over_half = oracles.affinity_paper(silhouette, mask, 0.5) - oracles.affinity_paper(silhouette, mask, 0.0)
    assert over_half > 300.0 * (4096.0 / 1600.0) ** 2


def test_a_step_down_the_points_affinity_moves_a_lone_point_toward_an_uncovered_pixel():
    mask = torch.zeros(64, 64)
    mask[30:34, 50:54] = 1.0
    point = torch.tensor([[20.0, 31.0]])
    _, gradient = _value_and_gradient(lambda p: _affinity(p, mask, "points"), point)
    goal = torch.tensor([51.5, 31.5])
    moved = point - 1e-4 * gradient
    assert (moved[0] - goal).norm() < (point[0] - goal).norm()


def test_a_stray_point_is_pulled_to_the_mask_and_a_covered_mask_asks_for_nothing():
    mask = _disc(32, 6.0)
    rows, columns = torch.nonzero(mask, as_tuple=True)
    covering = torch.stack([columns, rows], 1).double()
    value, gradient = _value_and_gradient(lambda p: _affinity(p, mask, "points"), covering)
    assert value == 0.0
    assert gradient.abs().max() == 0.0
    stray = torch.cat([covering, torch.tensor([[3.0, 16.0]], dtype=torch.float64)])
    _, gradient = _value_and_gradient(lambda p: _affinity(p, mask, "points"), stray)
    assert gradient[-1, 0] < 0.0
    assert gradient[:-1].abs().max() == 0.0


@pytest.mark.parametrize("form", ["paper", "points"])
def test_the_gradient_of_the_affinity_loss_is_that_of_finite_differences(form):
    points = torch.tensor([[5.2, 5.1], [9.3, 2.2], [1.1, 8.7]], dtype=torch.float64, requires_grad=True)
    mask = _disc(12, 3.0)
    assert torch.autograd.gradcheck(lambda p: _affinity(p, mask, form), (points,), eps=1e-6, atol=1e-3, rtol=1e-4)


def test_chamfer_is_that_of_all_pairs_and_its_gradient_that_of_finite_differences():
    generator = torch.Generator().manual_seed(5)
    a = torch.rand(2, 30, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    b = torch.rand(2, 20, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    forward, backward = chamfer(a, b)
    for i in range(2):
        expected = oracles.chamfer(a[i], b[i])
        assert (forward[i].item(), backward[i].item()) == pytest.approx((expected[0].item(), expected[1].item()))
    assert torch.autograd.gradcheck(lambda x, y: sum(chamfer(x, y)), (a, b), eps=1e-7, atol=1e-6)


def test_the_regulariser_is_the_chamfer_distance_to_the_start():
    generator = torch.Generator().manual_seed(6)
    start = torch.rand(200, 3, generator=generator, dtype=torch.float64)
    for step in (0.0, 0.01, 0.2):
        moved = start + step * torch.randn(start.shape, generator=generator, dtype=torch.float64)
        assert ChamferToInitial(start[None])(moved[None]).item() == pytest.approx(
            sum(oracles.chamfer(moved, start)).item(), abs=1e-15
        )
