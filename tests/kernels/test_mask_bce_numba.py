"""The compiled mask loss: one function that is the plain losses put one after another."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numba import njit

from tso_cli.kernels import jit
from tso_cli.kernels import simd as lanes
from tso_cli.kernels.splat import splat
from tso_cli.silhouette.losses import PixelWeights, mask_loss, silhouette_bce


def _scene(images: int, count: int, height: int, width: int, dtype: torch.dtype = torch.float64):
    """Points, some beside the image or invalid, masks with soft rims, and weights of which a part is 0."""
    generator = torch.Generator().manual_seed(count)
    size = torch.tensor([width, height], dtype=dtype)
    points = (torch.rand(images, count, 2, generator=generator, dtype=dtype) * 1.4 - 0.2) * size
    valid = torch.rand(images, count, generator=generator) > 0.1
    noise = torch.rand(images, 1, 5, 6, generator=generator, dtype=dtype)
    mask = (4.0 * torch.nn.functional.interpolate(noise, (height, width), mode="bilinear").squeeze(1) - 1.5).clamp(0.0, 1.0)
    known = (torch.rand(mask.shape, generator=generator, dtype=dtype) * 1.5 - 0.3).clamp(0.0, 1.0)
    return points, valid, mask, known


@pytest.mark.parametrize("kernel", ["compiled", "windowed", "exact"])
@pytest.mark.parametrize("sigma_sq", [0.1, 0.4, 6.4])
@pytest.mark.parametrize("count", [1, 30, 900])
def test_value_and_gradient_are_those_of_the_exact_product_and_the_plain_loss(kernel, sigma_sq, count):
    points, valid, mask, known = _scene(4, count, 22, 30)
    points[1] = points[1] + 100.0  # beside the image
    valid[2] = False
    for weight in (known, None):
        found = []
        for form in (kernel, None):
            leaf = points.clone().requires_grad_()
            if form:
                value = mask_loss(leaf, valid, PixelWeights.of(mask, weight), sigma_sq, form)
            else:
                sums = splat(leaf, valid, 22, 30, sigma_sq, "exact")
                value = silhouette_bce(sums, mask, leaf, valid, sigma_sq, weight)
            value[[0, 1, 3]].sum().backward()
            found.append((value.detach(), leaf.grad))
        (fast, fast_gradient), (plain, gradient) = found
        # the window leaves out what is under 1e-8
        torch.testing.assert_close(fast, plain, rtol=1e-5, atol=1e-5)
        torch.testing.assert_close(fast_gradient, gradient, rtol=1e-4, atol=1e-5 * gradient.abs().max().item())


def test_in_single_precision_it_is_right_to_six_digits():
    points, valid, mask, known = _scene(3, 700, 40, 50)
    found = []
    for dtype in (torch.float64, torch.float32):
        leaf = points.to(dtype).detach().clone().requires_grad_()
        value = mask_loss(leaf, valid, PixelWeights.of(mask.to(dtype), known.to(dtype)), 0.4, "compiled")
        value.sum().backward()
        found.append((value.double(), leaf.grad.double()))
    (right, right_gradient), (value, gradient) = found
    torch.testing.assert_close(value, right, rtol=1e-6, atol=0.0)
    torch.testing.assert_close(gradient, right_gradient, rtol=1e-4, atol=2e-6 * right_gradient.abs().max().item())


def test_its_gradient_is_that_of_finite_differences():
    points, valid, mask, known = _scene(2, 12, 14, 17)
    target = PixelWeights.of(mask, known)
    leaf = points.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda p: mask_loss(p, valid, target, 0.7, "compiled"), (leaf,), eps=1e-7, atol=1e-4, rtol=1e-5
    )


@pytest.mark.parametrize("images", [1, 5])
def test_nothing_depends_on_the_number_of_threads_by_one_bit(monkeypatch, images):
    monkeypatch.setattr(jit, "WORTH_A_THREAD", 1)
    points, valid, mask, known = _scene(images, 3000, 150, 64, torch.float32)
    before = torch.get_num_threads()
    found = []
    try:
        for number in (1, 2, 7):
            torch.set_num_threads(number)
            leaf = points.clone().requires_grad_()
            value = mask_loss(leaf, valid, PixelWeights.of(mask, known), 0.4, "compiled")
            value.sum().backward()
            found.append((value.detach(), leaf.grad))
    finally:
        torch.set_num_threads(before)
    for value, gradient in found[1:]:
        assert torch.equal(value, found[0][0])
        assert torch.equal(gradient, found[0][1])


def test_a_lone_point_moves_toward_the_uncovered_pixel():
    mask = torch.zeros(1, 40, 40)
    mask[0, 30, 35] = 1.0
    point = torch.tensor([[[4.0, 6.0]]], requires_grad=True)
    mask_loss(point, torch.ones(1, 1, dtype=torch.bool), PixelWeights.of(mask), 0.4, "compiled").sum().backward()
    downhill = -point.grad[0, 0]
    torch.testing.assert_close(
        downhill / downhill.norm(), torch.tensor([31.0, 24.0]) / np.hypot(31.0, 24.0), atol=1e-3, rtol=0.0
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_exponentials_and_logarithms_are_right(dtype):
    @njit
    def both(x, powers, logs):
        for i in range(len(x)):
            powers[i], logs[i] = lanes.exp(-x[i]), lanes.log(x[i])

    x = np.geomspace(1e-30, 80.0, 20001).astype(dtype)
    powers, logs = np.empty_like(x), np.empty_like(x)
    both(x, powers, logs)
    near = x < 1.0
    exact = np.exp(-x.astype(np.float64))
    precision = 3e-7 if dtype == np.float32 else 1e-15
    np.testing.assert_allclose(powers[near], exact[near], rtol=precision)
    np.testing.assert_allclose(powers, exact, rtol=20 * precision)
    np.testing.assert_allclose(logs, np.log(x.astype(np.float64)), rtol=precision, atol=precision)
