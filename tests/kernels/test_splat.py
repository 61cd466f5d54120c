"""The sums of Gaussians: the windowed kernels against the exact product, and that against the printed formula."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import oracles
from tso_cli.kernels import splat as splat_module
from tso_cli.kernels.splat import splat, window_radius

WINDOWED = ("windowed", "compiled")


def _cloud(seed: int, count: int, size: int, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return (torch.rand(2, count, 2, generator=generator, dtype=dtype) * 1.6 - 0.3) * size


def _both(points: torch.Tensor, valid: torch.Tensor, height: int, width: int, sigma_sq: float, fast: str = "windowed"):
    """Silhouette, and gradient of a random weighted sum of it, from the exact kernel and a fast one."""
    weight = torch.randn(len(points), height, width, generator=torch.Generator().manual_seed(1), dtype=points.dtype)
    for kernel in ("exact", fast):
        leaf = points.clone().requires_grad_()
        silhouette = torch.tanh(splat(leaf, valid, height, width, sigma_sq, kernel))
        (silhouette * weight).sum().backward()
        yield silhouette.detach(), leaf.grad


def _assert_agree(points: torch.Tensor, height: int, width: int, sigma_sq: float, kernel: str) -> None:
    valid = torch.ones(points.shape[:2], dtype=torch.bool)
    (exact, exact_grad), (fast, fast_grad) = _both(points, valid, height, width, sigma_sq, kernel)
    assert (exact - fast).abs().max() <= 1e-5 * exact.abs().max()
    assert (exact_grad - fast_grad).abs().max() <= 1e-5 * exact_grad.abs().max()


@pytest.mark.parametrize("sigma_sq", [0.1, 0.4, 1.6, 6.4])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("kernel", WINDOWED)
def test_the_windowed_kernels_agree_with_the_exact_product_in_value_and_gradient(kernel, sigma_sq, dtype):
    _assert_agree(_cloud(0, 300, 40, dtype), 40, 56, sigma_sq, kernel)


@pytest.mark.parametrize("kernel", WINDOWED)
@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-12, 36), st.floats(-12, 36)), min_size=1, max_size=20),
    st.floats(0.05, 8.0),
)
def test_the_kernels_agree_for_any_points_inside_and_outside_the_image(kernel, points, sigma_sq):
    tensor = torch.tensor([points], dtype=torch.float64)
    valid = torch.ones(tensor.shape[:2], dtype=torch.bool)
    (exact, exact_grad), (fast, fast_grad) = _both(tensor, valid, 24, 20, sigma_sq, kernel)
    # far outside, all entries are below what a tap may neglect
    assert (exact - fast).abs().max() <= 1e-5 * exact.abs().max() + 1e-6
    assert (exact_grad - fast_grad).abs().max() <= 1e-5 * exact_grad.abs().max() + 1e-6


def test_the_exact_product_is_the_printed_formula():
    points = _cloud(2, 50, 24)
    valid = torch.ones(points.shape[:2], dtype=torch.bool)
    for image, cloud in zip(splat(points, valid, 24, 30, 0.4, "exact"), points, strict=True):
        torch.testing.assert_close(image, oracles.silhouette_sums(cloud, 24, 30, 0.4), atol=1e-12, rtol=1e-12)


SINGULAR_POINTS = {
    "on a boundary between pixels": [[3.5, 4.5], [2.5, 7.0], [6.0, 1.5]],
    "on pixel centres": [[3.0, 4.0], [0.0, 0.0], [9.0, 7.0]],
    "outside the image": [[-2.3, 4.0], [11.2, -1.4], [5.0, 9.6]],
    "stacked": [[4.2, 4.3]] * 4,
}


@pytest.mark.parametrize("where", SINGULAR_POINTS)
@pytest.mark.parametrize("kernel", ["exact", *WINDOWED])
def test_gradients_are_those_of_finite_differences(where, kernel):
    points = torch.tensor([SINGULAR_POINTS[where]], dtype=torch.float64, requires_grad=True)
    valid = torch.ones(points.shape[:2], dtype=torch.bool)

    def silhouette(p):
        return torch.tanh(splat(p, valid, 8, 10, 0.4, kernel))

    # A point on a boundary changes its window under finite differences: taps of 1e-11 come and go.
    assert torch.autograd.gradcheck(silhouette, (points,), eps=1e-5, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("kernel", ["exact", *WINDOWED])
def test_invalid_points_add_nothing_and_get_no_gradient(kernel):
    points = torch.tensor([[[4.0, 4.0], [5.0, 2.0]]], requires_grad=True)
    valid = torch.tensor([[True, False]])
    sums = splat(points, valid, 8, 8, 0.4, kernel)
    torch.testing.assert_close(sums, splat(points[:, :1], valid[:, :1], 8, 8, 0.4, kernel))
    (sums.square().sum() + sums[0, 4, 5]).backward()
    assert points.grad is not None
    assert points.grad[0, 1].abs().max() == 0.0
    assert points.grad[0, 0].abs().max() > 0.0


@pytest.mark.parametrize("kernel", ["exact", *WINDOWED])
def test_points_at_huge_coordinates_add_nothing_and_break_nothing(kernel):
    points = torch.tensor([[[1e30, 3.0], [-1e12, 4.0], [3.0, 3e9], [2.0, 2.0]]], requires_grad=True)
    sums = splat(points, torch.ones(1, 4, dtype=torch.bool), 6, 6, 0.4, kernel)
    sums.sum().backward()
    assert torch.isfinite(sums).all()
    assert points.grad is not None
    assert torch.isfinite(points.grad).all()
    assert sums[0, 2, 2].item() == pytest.approx(1.0)


@pytest.mark.parametrize("kernel", ["exact", *WINDOWED])
def test_clouds_without_points_have_empty_sums(kernel):
    assert splat(torch.empty(2, 0, 2), torch.empty(2, 0, dtype=torch.bool), 5, 6, 0.4, kernel).tolist() == [[[0.0] * 6] * 5] * 2


@pytest.mark.parametrize("kernel", WINDOWED)
def test_points_that_are_not_finite_add_nothing(kernel):
    points = torch.tensor([[[float("nan"), 3.0], [3.0, float("inf")], [2.0, 2.0]]])
    valid = torch.ones(1, 3, dtype=torch.bool)
    torch.testing.assert_close(splat(points, valid, 6, 6, 0.4, kernel), splat(points[:, 2:], valid[:, 2:], 6, 6, 0.4, "exact"))


@pytest.mark.parametrize("kernel", WINDOWED)
def test_the_kernels_agree_where_sixteen_thousand_points_stack(kernel):
    _assert_agree(torch.tensor([31.7, 20.2], dtype=torch.float64).expand(1, 16384, 2), 64, 64, 0.4, kernel)


def test_a_cloud_split_into_chunks_gives_the_same_sums_and_gradient(monkeypatch):
    points = _cloud(3, 200, 30)
    valid = torch.ones(points.shape[:2], dtype=torch.bool)
    *_, whole = _both(points, valid, 30, 30, 0.4)
    monkeypatch.setattr(splat_module, "TAPS_PER_CHUNK", 81 * 2 * 7)
    *_, parts = _both(points, valid, 30, 30, 0.4)
    torch.testing.assert_close(parts, whole)


def test_transposed_and_expanded_tensors_give_the_same_sums():
    points, valid = _cloud(6, 30, 20)[:1], torch.ones(1, 30, dtype=torch.bool)
    strided = points.transpose(1, 2).contiguous().transpose(1, 2).expand(3, -1, -1)
    sums = splat(strided, valid.expand(3, -1), 20, 20, 0.4, "compiled")
    assert torch.equal(sums[2], splat(points, valid, 20, 20, 0.4, "compiled")[0])


def test_the_window_has_radius_four_at_the_papers_variance():
    assert window_radius(0.4) == 4
