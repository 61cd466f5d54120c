"""The sums of Gaussians.

The sums by bands of rows against the exact product, and the product against the printed formula.
"""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import oracles
from tso_cli.kernels import splat_numpy
from tso_cli.kernels.splat import splat

KERNELS = pytest.mark.parametrize("kernel", ["exact", "numpy"])


def _cloud(seed: int, count: int, size: int, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return (torch.rand(2, count, 2, generator=generator, dtype=dtype) * 1.6 - 0.3) * size


def _assert_agree(
    points: torch.Tensor, height: int, width: int, sigma_sq: float, atol: float
) -> None:
    """Both kernels give the same sums and gradient."""
    results = (
        _sums_and_gradient(points, height, width, sigma_sq, kernel) for kernel in ("exact", "numpy")
    )
    for exact, fast in zip(*results, strict=True):
        assert (exact - fast).abs().max() <= 1e-5 * exact.abs().max() + atol


def _sums_and_gradient(points: torch.Tensor, height: int, width: int, sigma_sq: float, kernel: str):
    """Sums of Gaussians, and the gradient of a randomly weighted sum of the silhouette."""
    weight = torch.randn(
        len(points), height, width, generator=torch.Generator().manual_seed(1), dtype=points.dtype
    )
    leaf = points.clone().requires_grad_()
    sums = splat(
        leaf, torch.ones(points.shape[:2], dtype=torch.bool), height, width, sigma_sq, kernel
    )
    (torch.tanh(sums) * weight).sum().backward()
    return sums.detach(), leaf.grad


@pytest.mark.parametrize("sigma_sq", [1e-4, 0.05, 0.4, 1.6, 6.4, 100.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_kernel_in_numpy_agrees_with_the_exact_product_in_value_and_gradient(sigma_sq, dtype):
    _assert_agree(_cloud(0, 300, 40, dtype), 40, 56, sigma_sq, 0.0)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-12, 36), st.floats(-12, 36)), min_size=1, max_size=20),
    st.floats(0.05, 8.0),
)
def test_the_kernels_agree_for_any_points_inside_and_outside_the_image(points, sigma_sq):
    # far outside, all entries are below what a tap may neglect
    _assert_agree(torch.tensor([points], dtype=torch.float64), 24, 20, sigma_sq, 1e-6)


def test_the_exact_product_is_the_printed_formula():
    points = _cloud(2, 50, 24)
    valid = torch.ones(points.shape[:2], dtype=torch.bool)
    for image, cloud in zip(splat(points, valid, 24, 30, 0.4, "exact"), points, strict=True):
        torch.testing.assert_close(
            image, oracles.silhouette_sums(cloud, 24, 30, 0.4), atol=1e-12, rtol=1e-12
        )


SINGULAR_POINTS = {
    "on a boundary between pixels": [[3.5, 4.5], [2.5, 7.0], [6.0, 1.5]],
    "on pixel centres": [[3.0, 4.0], [0.0, 0.0], [9.0, 7.0]],
    "outside the image": [[-2.3, 4.0], [11.2, -1.4], [5.0, 9.6]],
    "stacked": [[4.2, 4.3]] * 4,
}


@pytest.mark.parametrize("where", SINGULAR_POINTS)
@KERNELS
def test_gradients_are_those_of_finite_differences(where, kernel):
    points = torch.tensor([SINGULAR_POINTS[where]], dtype=torch.float64, requires_grad=True)
    valid = torch.ones(points.shape[:2], dtype=torch.bool)

    def silhouette(p):
        return torch.tanh(splat(p, valid, 8, 10, 0.4, kernel))

    # A point on a boundary changes its window under finite differences: taps of 1e-11 come and go.
    assert torch.autograd.gradcheck(silhouette, (points,), eps=1e-5, atol=1e-6, rtol=1e-5)


@KERNELS
def test_invalid_points_add_nothing_and_get_no_gradient(kernel):
    points = torch.tensor([[[4.0, 4.0], [5.0, 2.0]]], requires_grad=True)
    valid = torch.tensor([[True, False]])
    sums = splat(points, valid, 8, 8, 0.4, kernel)
    torch.testing.assert_close(sums, splat(points[:, :1], valid[:, :1], 8, 8, 0.4, kernel))
    (sums.square().sum() + sums[0, 4, 5]).backward()
    assert points.grad[0, 0].any()
    assert not points.grad[0, 1].any()


@KERNELS
def test_points_at_huge_coordinates_add_nothing_and_break_nothing(kernel):
    points = torch.tensor([[[1e30, 3.0], [-1e12, 4.0], [3.0, 3e9], [2.0, 2.0]]], requires_grad=True)
    sums = splat(points, torch.ones(1, 4, dtype=torch.bool), 6, 6, 0.4, kernel)
    sums.sum().backward()
    assert torch.isfinite(sums).all()
    assert torch.isfinite(points.grad).all()
    assert sums[0, 2, 2].item() == pytest.approx(1.0)


def test_second_derivatives_are_refused_and_not_silently_dropped():
    points = torch.rand(1, 5, 2, requires_grad=True)
    sums = splat(points, torch.ones(1, 5, dtype=torch.bool), 8, 8, 0.4, "numpy")
    (gradient,) = torch.autograd.grad(sums.square().sum(), points, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


def test_many_points_are_drawn_in_parts(monkeypatch):
    points = _cloud(3, 300, 40)
    whole = _sums_and_gradient(points, 40, 56, 0.4, "numpy")
    monkeypatch.setattr(splat_numpy, "POINTS_AT_ONCE", 7)
    for part, expected in zip(_sums_and_gradient(points, 40, 56, 0.4, "numpy"), whole, strict=True):
        torch.testing.assert_close(part, expected, rtol=1e-6, atol=1e-6)
