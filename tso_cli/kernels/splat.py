"""Sums of Gaussians over a pixel grid (Eq. 2 and 3 before the tanh).

The choice of a form, and the reference in plain torch.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .tensors import called, triton_runs, use_numba
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
    kernel : "exact": every pixel, Eq. 2 as printed, in plain torch. "compiled": only the pixels
        around each point, numba on the CPU. "triton": as "compiled", on a GPU. "auto": see
        `tso_cli.kernels.tensors`.

    Returns
    -------
    [M, height, width] sums, >= 0.
    """
    if kernel == "auto":
        kernel = (
            "triton" if triton_runs(points_px) else "compiled" if use_numba(points_px) else "exact"
        )
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
        radius = window_radius(sigma_sq)
        return _run(kernel, "sums", points_px, valid, height, width, sigma_sq, radius)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        window = ctx.sigma_sq, window_radius(ctx.sigma_sq)
        grad = _run(ctx.kernel, "gradient", grad_outputs[0], *ctx.saved_tensors, *window)
        return grad, None, None, None, None, None


def _run(kernel: str, name: str, *arguments: Any) -> Tensor:
    """Call the function ``name`` of the "compiled" or "triton" form, whose import is slow."""
    result: Tensor
    if kernel == "triton":
        from . import splat_triton

        result = getattr(splat_triton, name)(*arguments)
    else:
        from . import splat_numba

        result = called(getattr(splat_numba, name), *arguments)
    return result
