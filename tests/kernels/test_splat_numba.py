"""The compiled sums: threads, sizes and odd tensors do not matter."""

from __future__ import annotations

import pytest
import torch

from tso_cli.kernels.splat import splat


def _clouds(seed: int, images: int, count: int, size: float, dtype: torch.dtype = torch.float32):
    generator = torch.Generator().manual_seed(seed)
    points = (torch.rand(images, count, 2, generator=generator, dtype=dtype) * 1.4 - 0.2) * size
    return points, torch.rand(images, count, generator=generator) > 0.1


@pytest.mark.parametrize(("images", "count", "height", "width"), [(1, 2000, 200, 90), (7, 300, 40, 50), (3, 1, 5, 4)])
def test_sums_and_gradients_do_not_depend_on_the_number_of_threads_by_one_bit(
    assert_same_on_threads, images, count, height, width
):
    points, valid = _clouds(0, images, count, float(width))
    weight = torch.randn(images, height, width, generator=torch.Generator().manual_seed(1))

    def sums_and_gradient():
        leaf = points.clone().requires_grad_()
        sums = splat(leaf, valid, height, width, 0.7, "compiled")
        (sums * weight).sum().backward()
        return sums.detach(), leaf.grad

    assert_same_on_threads(sums_and_gradient)


@pytest.mark.parametrize("sigma_sq", [1e-4, 0.05, 100.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_very_narrow_and_very_wide_kernels_are_those_of_the_exact_product(dtype, sigma_sq):
    points, valid = _clouds(5, 2, 40, 30.0, dtype)
    points[0, :4] = torch.tensor([[3.0, 3.0], [4.5, 6.0], [7.0, 7.5], [-0.5, 2.0]])
    leaves = [points.clone().requires_grad_() for _ in range(2)]
    exact, fast = (splat(p, valid, 30, 34, sigma_sq, k) for p, k in zip(leaves, ("exact", "compiled"), strict=True))
    (exact.tanh().sum() + fast.tanh().sum()).backward()
    torch.testing.assert_close(fast, exact, atol=1e-5 * exact.max().item(), rtol=0)
    largest = leaves[0].grad.abs().max().item()
    torch.testing.assert_close(leaves[1].grad, leaves[0].grad, atol=1e-5 * largest, rtol=0)
