"""The cross-entropy: finite, and with a gradient, where the printed formula overflows or has none."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import oracles
from tso_cli.kernels.splat import splat
from tso_cli.silhouette.bce import silhouette_bce

from .common import SIGMA_SQ, disc, value_and_gradient


def _bce(points: torch.Tensor, mask: torch.Tensor, known: torch.Tensor | None = None) -> torch.Tensor:
    valid = torch.ones(1, len(points), dtype=torch.bool)
    sums = splat(points[None], valid, *mask.shape, SIGMA_SQ)
    return silhouette_bce(sums, mask[None], points[None], valid, SIGMA_SQ, None if known is None else known[None])[0]


def test_a_thousand_points_stacked_on_a_background_pixel_have_a_gradient():
    points = torch.tensor([[10.3, 10.0]]).repeat(1000, 1)
    mask = disc().float()
    value, gradient = value_and_gradient(lambda p: _bce(p, mask), points)
    assert torch.isfinite(torch.tensor(value))
    assert torch.isfinite(gradient).all()
    assert (gradient.abs().sum(1) > 1e-3).all()


def test_bce_is_log_sum_exp_over_all_points_where_points_cover_the_mask():
    generator = torch.Generator().manual_seed(0)
    mask = disc()
    points = torch.rand(1500, 2, generator=generator, dtype=torch.float64) * 30 + 17
    points[:5] = torch.rand(5, 2, generator=generator, dtype=torch.float64) * 63
    value, gradient = value_and_gradient(lambda p: _bce(p, mask), points)
    oracle, expected = value_and_gradient(lambda p: oracles.bce(p, mask, SIGMA_SQ), points)
    assert value == pytest.approx(oracle, rel=1e-6)
    torch.testing.assert_close(gradient, expected, atol=1e-5 * expected.abs().max().item(), rtol=1e-4)


# Beyond every window; and a pixel in the corner of the first point's square window, which the second one is nearer to.
SINGLE_PIXELS = {
    "beyond every window": ((10, slice(12, 40)), torch.linspace(0.2, 1.0, 28, dtype=torch.float64), [[11.3, 9.8]], 1e-6),
    "in the corner of a window": ((20, 20), 1.0, [[24.4, 24.4], [24.55, 20.0]], 1e-4),
}


@pytest.mark.parametrize("where", SINGLE_PIXELS)
def test_bce_of_far_pixels_is_log_sum_exp_with_the_nearest_point(where):
    place, values, points, tolerance = SINGLE_PIXELS[where]
    mask = torch.zeros(64, 64, dtype=torch.float64)
    mask[place] = values
    points = torch.tensor(points, dtype=torch.float64)
    value, gradient = value_and_gradient(lambda p: _bce(p, mask), points)
    expected, expected_gradient = value_and_gradient(lambda p: oracles.bce(p, mask, SIGMA_SQ), points)
    assert value == pytest.approx(expected, rel=1e-6)
    torch.testing.assert_close(gradient, expected_gradient, atol=tolerance, rtol=tolerance)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 39), st.floats(0, 39)), min_size=1, max_size=5), st.integers(0, 39), st.integers(0, 39))
def test_bce_of_a_few_points_is_log_sum_exp_up_to_the_count_of_the_nearest(points, row, column):
    mask = torch.zeros(40, 40, dtype=torch.float64)
    mask[row, column] = 1.0
    tensor = torch.tensor(points, dtype=torch.float64)
    mine = _bce(tensor, mask).item() / (4096 / 1600)
    oracle = oracles.bce(tensor, mask, SIGMA_SQ).item() / (4096 / 1600)
    assert oracle - 1e-2 <= mine <= oracle + math.log(len(points)) + 1e-2


def test_the_float64_gradient_of_bce_passes_finite_differences():
    mask = disc(12, 3.0)
    points = torch.tensor([[5.5, 5.5], [5.5, 5.5], [-1.2, 4.0], [3.0, 7.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda p: _bce(p, mask), (points,), eps=1e-6, atol=1e-4, rtol=1e-4)


def test_unknown_pixels_change_nothing():
    mask = disc()
    known = torch.ones_like(mask)
    known[:, 32:] = 0.0
    points = torch.tensor([[50.0, 30.0], [55.0, 50.0]], dtype=torch.float64)
    left = mask.clone()
    left[:, 32:] = 0.3
    value, gradient = value_and_gradient(lambda p: _bce(p, left, known), points)
    other, gradient_other = value_and_gradient(lambda p: _bce(p, mask, known), points)
    assert value == other
    torch.testing.assert_close(gradient, gradient_other)


def test_points_outside_the_image_are_not_background():
    mask = disc()
    inside = torch.tensor([[31.0, 31.0]], dtype=torch.float64)
    outside = torch.tensor([[-20.0, 30.0]], dtype=torch.float64)
    assert _bce(torch.cat([inside, outside]), mask).item() == pytest.approx(_bce(inside, mask).item())


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 11), st.floats(0, 9)), min_size=1, max_size=6, unique=True), st.integers(0, 1000))
def test_the_total_gradient_of_bce_is_that_of_log_sum_exp_on_soft_masks(points, seed):
    # soft masks everywhere: both terms of every pixel count
    mask = torch.rand(10, 12, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    tensor = torch.tensor(points, dtype=torch.float64)
    _, gradient = value_and_gradient(lambda p: _bce(p, mask), tensor)
    _, expected = value_and_gradient(lambda p: oracles.bce(p, mask, SIGMA_SQ), tensor)
    # the nearest point stands for all beyond the window; where several are as near, log-sum-exp shares the pull
    total, total_expected = gradient.sum(0), expected.sum(0)
    scale = expected.abs().sum() + 1.0
    assert (total - total_expected).abs().max() <= 0.2 * scale


def test_a_far_mask_pixel_attracts_its_nearest_point_with_the_weight_of_its_known_part():
    mask, points = torch.zeros(64, 64), torch.tensor([[20.0, 40.0], [5.0, 5.0]])
    mask[40, 50] = 1.0
    value, gradient = value_and_gradient(lambda p: _bce(p, mask), points)
    assert value > 30.0**2 / (2 * SIGMA_SQ)
    assert gradient[0, 0] < -10.0  # downhill is toward larger columns, where the pixel is
    rest = _bce(points, mask, 1.0 - mask)
    assert (_bce(points, mask, 1.0 - 0.75 * mask) - rest).item() == pytest.approx(0.25 * (value - rest.item()), rel=1e-5)


def test_twice_the_resolution_has_nearly_the_same_bce():
    points = torch.rand(2000, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 24 + 20
    mask, valid = disc(64), torch.ones(1, 2000, dtype=torch.bool)
    finer, finer_px = mask.repeat_interleave(2, 0).repeat_interleave(2, 1), (points[None] + 0.5) * 2 - 0.5
    fine = silhouette_bce(splat(finer_px, valid, 128, 128, 4 * SIGMA_SQ), finer[None], finer_px, valid, 4 * SIGMA_SQ)
    assert fine.item() == pytest.approx(_bce(points, mask).item(), rel=0.05)
