"""Sums of Gaussians over a pixel grid (Eq. 2 and 3 before the tanh).

The choice of a form, and the reference in plain torch.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .gpu import triton_runs
from .splat_numpy import Splat
from .window import window_radius


def splat(
    points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float, kernel: str = "auto"
) -> Tensor:
    """Sum, at every pixel centre, of one un-normalised Gaussian per point (in the tanh of Eq. 2).

    Parameters
    ----------
    points_px : [M, N, 2] column and row.
    valid : [M, N] bool; points that are False add nothing and get no gradient.
    sigma_sq : variance of the Gaussian, px^2.
    kernel : "exact": every pixel, Eq. 2 as printed, in plain torch. "numpy": only the rows around
        each point, on the CPU. "triton": only the pixels around each point, on a GPU. "auto": the
        quickest that can run.

    Returns
    -------
    [M, height, width] sums, >= 0.
    """
    if kernel == "auto":
        on_cpu = points_px.device.type == "cpu"
        kernel = "triton" if triton_runs(points_px) else "numpy" if on_cpu else "exact"
    if kernel == "exact":
        return _exact(points_px, valid, height, width, sigma_sq)
    return _Windowed.apply(points_px, valid, height, width, float(sigma_sq), kernel)


def _exact(points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float) -> Tensor:
    """The reference: phi(y - j) [H, N] times phi(x - i) [N, W]; this product sums over points."""
    columns = torch.arange(width, device=points_px.device, dtype=points_px.dtype)
    rows = torch.arange(height, device=points_px.device, dtype=points_px.dtype)
    x, y = torch.where(valid.unsqueeze(-1), points_px, 0.0).unbind(-1)
    along_x = _gaussian(x.unsqueeze(-1) - columns, sigma_sq) * valid.unsqueeze(-1)  # [M, N, W]
    along_y = _gaussian(y.unsqueeze(-1) - rows, sigma_sq)  # [M, N, H]
    return along_y.transpose(-1, -2) @ along_x


def _gaussian(distance: Tensor, sigma_sq: float) -> Tensor:
    exponent = distance.square() * (-0.5 / sigma_sq)
    # Under this exponent the value is denormal (under 1e-37), and products of denormals are ten
    # times slower. Such values are 0.
    smallest = -85.0 if distance.dtype == torch.float32 else -700.0
    return torch.exp(exponent.clamp_min(smallest)) * (exponent > smallest)


class _Windowed(torch.autograd.Function):
    """The sums over the windows of points. Backward computes each window again; none is stored."""

    @staticmethod
    def forward(
        ctx: Any,
        points_px: Tensor,
        valid: Tensor,
        height: int,
        width: int,
        sigma_sq: float,
        kernel: str,
    ) -> Tensor:
        ctx.save_for_backward(points_px, valid)
        ctx.sigma_sq, ctx.kernel = sigma_sq, kernel
        if kernel == "triton":
            from .splat_triton import sums

            return sums(points_px, valid, height, width, sigma_sq, window_radius(sigma_sq))
        out = points_px.new_empty(len(points_px), height, width)
        for image, (splat, _) in zip(out, _splats(points_px, valid, out, sigma_sq), strict=True):
            image.copy_(torch.from_numpy(splat.sums))
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        (points_px, valid), (by_sums,) = ctx.saved_tensors, grad_outputs
        if ctx.kernel == "triton":
            from .splat_triton import gradient

            radius = window_radius(ctx.sigma_sq)
            grad = gradient(by_sums, points_px, valid, ctx.sigma_sq, radius)
        else:
            grad = torch.zeros_like(points_px)
            splats = _splats(points_px, valid, by_sums, ctx.sigma_sq)
            for image, by_pixels, (splat, drawn) in zip(grad, by_sums, splats, strict=True):
                by_points = splat.gradient(by_pixels.double().numpy())
                image[drawn] = torch.from_numpy(by_points).to(image)
        return grad, None, None, None, None, None


def _splats(
    points_px: Tensor, valid: Tensor, images: Tensor, sigma_sq: float
) -> Iterator[tuple[Splat, Tensor]]:
    """The sums of each of the ``images`` [M, H, W], and which points [N] are drawn."""
    for points, drawn in zip(points_px, valid & points_px.isfinite().all(-1), strict=True):
        drawn_px = points[drawn].double().numpy()
        yield Splat(drawn_px, images.shape[1], images.shape[2], sigma_sq), drawn
