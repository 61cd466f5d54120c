"""Sums of Gaussians over a pixel grid (Eq. 2 and 3 before the tanh): dispatch, and two forms in plain torch."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .tensors import called, triton_runs, use_numba
from .window import window_radius

# A tap below this value changes no float32 sum; it fixes the window's radius.
# Taps held at once; bounds memory at about 400 MB however many points there are.
TAPS_PER_CHUNK = 1 << 24
# A tap scattered by torch costs about 30 times a multiply-add of the dense product.
TAP_COST = 30

KERNELS = ("auto", "compiled", "triton", "windowed", "exact")


def splat(points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float, kernel: str = "auto") -> Tensor:
    """Sum of one un-normalised Gaussian per point at every pixel centre: the argument of the tanh in Eq. 2.

    Parameters
    ----------
    points_px : [M, N, 2] column and row. valid : [M, N] bool; points that are False add nothing and get no gradient.
    sigma_sq : variance of the Gaussian, px^2.
    kernel : "exact" (every pixel, Eq. 2 as printed), "windowed" (only the pixels around each point; both in plain torch, on
        any device), "compiled" (windowed, numba on the CPU), "triton" (windowed, on a GPU) or "auto" (see `cheapest`).

    Returns
    -------
    [M, height, width] sums, >= 0. Raises ValueError for a kernel that does not exist or cannot run here.
    """
    if kernel == "auto":
        kernel = cheapest(points_px, height, width, sigma_sq)
    if kernel == "exact":
        return _exact(points_px, valid, height, width, sigma_sq)
    if kernel == "triton" and not triton_runs(points_px):
        found = f"{str(points_px.dtype).removeprefix('torch.')} on {points_px.device}"
        raise ValueError(f"kernel is 'triton', which needs triton and float32 points on a GPU; found {found}")
    if kernel in ("compiled", "triton", "windowed"):
        return _Windowed.apply(points_px, valid, height, width, float(sigma_sq), kernel)
    raise ValueError(f"kernel is {kernel!r}, expected one of {', '.join(KERNELS)}")


def cheapest(points_px: Tensor, height: int, width: int, sigma_sq: float) -> str:
    """The kernel that "auto" stands for: see `tso_cli.kernels.tensors`; in plain torch the one with less to compute."""
    if triton_runs(points_px):
        return "triton"
    if use_numba(points_px):
        return "compiled"
    taps = (2 * window_radius(sigma_sq) + 1) ** 2
    return "windowed" if TAP_COST * taps < height * width else "exact"


def _exact(points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float) -> Tensor:
    """The reference: the matrix product of phi(y - j) [H, N] and phi(x - i) [N, W] is the sum over points of their product."""
    columns = torch.arange(width, device=points_px.device, dtype=points_px.dtype)
    rows = torch.arange(height, device=points_px.device, dtype=points_px.dtype)
    x, y = torch.where(valid.unsqueeze(-1), points_px, 0.0).unbind(-1)
    along_x = _gaussian(x.unsqueeze(-1) - columns, sigma_sq) * valid.unsqueeze(-1)  # [M, N, W]
    along_y = _gaussian(y.unsqueeze(-1) - rows, sigma_sq)  # [M, N, H]
    return along_y.transpose(-1, -2) @ along_x


def _gaussian(distance: Tensor, sigma_sq: float) -> Tensor:
    exponent = distance.square() * (-0.5 / sigma_sq)
    # Below this the value is denormal, and a product of denormals is ten times slower; the true value is under 1e-37.
    smallest = -85.0 if distance.dtype == torch.float32 else -700.0
    return torch.exp(exponent.clamp_min(smallest)) * (exponent > smallest)


class _Windowed(torch.autograd.Function):
    """The sum of each point's window; backward reads the same window again, so nothing of its size k x k is stored."""

    @staticmethod
    def forward(ctx: Any, points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float, kernel: str) -> Tensor:
        ctx.save_for_backward(points_px, valid)
        ctx.sigma_sq, ctx.kernel = sigma_sq, kernel
        if kernel != "windowed":
            return _run(kernel, "sums", points_px, valid, height, width, sigma_sq, window_radius(sigma_sq))
        sums, ctx.windows = _scatter(points_px, valid, height, width, sigma_sq)
        return sums

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        points_px, valid = ctx.saved_tensors
        if ctx.kernel != "windowed":
            grad = _run(ctx.kernel, "gradient", grad_outputs[0], points_px, valid, ctx.sigma_sq, window_radius(ctx.sigma_sq))
        else:
            grad = _gather(grad_outputs[0], points_px, valid, ctx.sigma_sq, ctx.windows)
        return grad, None, None, None, None, None


def _run(kernel: str, name: str, *arguments: Any) -> Tensor:
    """Call the function of that name of a kernel that is not plain torch; importing it is slow."""
    result: Tensor
    if kernel == "triton":
        from . import splat_triton

        result = getattr(splat_triton, name)(*arguments)
    else:
        from . import splat_numba

        result = called(getattr(splat_numba, name), *arguments)
    return result


class _Windows(NamedTuple):
    """The windows of n points of M images, each image padded so that no tap needs a test."""

    offsets: Tensor  # [M, n, 2, k] from the taps' centres to the point, along x and y
    weights: Tensor  # [M, n, 2, k] of the taps along x and y
    corner: Tensor  # [M, n] flat index of each window's first tap


def _windows(points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float) -> _Windows:
    radius = window_radius(sigma_sq)
    # The padding holds every window that touches the image, and those parked beyond its corner.
    padding, limit = 2 * radius + 1, radius + 1
    x, y = points_px.unbind(-1)
    near = valid & (x > -limit) & (x < width - 1 + limit) & (y > -limit) & (y < height - 1 + limit)
    # Points far from the image are parked where no tap is inside: their integer coordinates could overflow.
    centres = torch.where(near.unsqueeze(-1), points_px, -limit)
    pixels = centres.round()
    steps = torch.arange(-radius, radius + 1, device=points_px.device)
    offsets = (centres - pixels).unsqueeze(-1) - steps
    column, row = (pixels.long() + (padding - radius)).unbind(-1)
    stride = width + 2 * padding
    image = torch.arange(len(points_px), device=points_px.device).mul_((height + 2 * padding) * stride).unsqueeze(-1)
    corner = row.mul(stride).add_(column).add_(image)
    return _Windows(offsets, torch.exp(offsets.square().mul_(-0.5 / sigma_sq)), corner)


def _taps(windows: _Windows, stride: int) -> Tensor:
    """Flat index of every tap [M n k k]."""
    steps = torch.arange(windows.weights.shape[-1], device=windows.corner.device)
    window = (steps.unsqueeze(-1) * stride + steps).flatten()
    return (windows.corner.unsqueeze(-1) + window).flatten()


def _chunks(images: int, count: int, sigma_sq: float) -> list[slice]:
    per_point = max(images, 1) * (2 * window_radius(sigma_sq) + 1) ** 2
    size = max(1, TAPS_PER_CHUNK // per_point)
    return [slice(start, start + size) for start in range(0, count, size)]


def _scatter(points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float) -> tuple[Tensor, _Windows | None]:
    """The sums [M, H, W], and the windows if one chunk holds them all."""
    images, count = valid.shape
    padding = 2 * window_radius(sigma_sq) + 1
    stride = width + 2 * padding
    sums = points_px.new_zeros(images * (height + 2 * padding) * stride)
    chunks = _chunks(images, count, sigma_sq)
    windows = None
    for part in chunks:
        windows = _windows(points_px[:, part], valid[:, part], height, width, sigma_sq)
        along_x, along_y = windows.weights.unbind(2)
        sums.scatter_add_(0, _taps(windows, stride), (along_y.unsqueeze(-1) * along_x.unsqueeze(-2)).flatten())
    sums = sums.view(images, -1, stride)[:, padding : padding + height, padding : padding + width].contiguous()
    return sums, windows if len(chunks) == 1 else None


def _gather(grad_sums: Tensor, points_px: Tensor, valid: Tensor, sigma_sq: float, windows: _Windows | None) -> Tensor:
    """Derivative [M, N, 2] by ``points_px``, from that by the sums [M, H, W]."""
    images, count = valid.shape
    height, width = grad_sums.shape[1:]
    padding = 2 * window_radius(sigma_sq) + 1
    padded = torch.nn.functional.pad(grad_sums, (padding, padding, padding, padding)).flatten()
    grads = []
    for part in _chunks(images, count, sigma_sq):
        chunk = windows or _windows(points_px[:, part], valid[:, part], height, width, sigma_sq)
        side = chunk.weights.shape[-1]
        taps = padded.index_select(0, _taps(chunk, width + 2 * padding)).view(*chunk.corner.shape, side, side)
        along_x, along_y = chunk.weights.unbind(2)
        # of every column the taps weighed along y, and of every row those weighed along x
        weighed = torch.cat([along_y.unsqueeze(-2) @ taps, (taps @ along_x.unsqueeze(-1)).transpose(-1, -2)], -2)
        # d/dx exp(-dx^2 / 2 sigma^2) = -dx / sigma^2 times the weight itself
        grads.append((weighed * chunk.weights * chunk.offsets).sum(-1) / -sigma_sq)
    return torch.cat(grads, 1) if grads else torch.zeros_like(points_px)
