"""Sums of Gaussians over a pixel grid (Eq. 2 and 3 before the tanh): the dispatcher, and the window in plain torch."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .dispatch import triton_runs, use_numba
from .splat_reference import splat_exact

# A tap below this value changes no float32 sum; it fixes the window's radius.
NEGLIGIBLE = 1e-8
# Taps held at once; bounds memory at about 400 MB however many points there are.
TAPS_PER_CHUNK = 1 << 24
# A tap scattered by torch costs about 30 times a multiply-add of the dense product.
TAP_COST = 30

KERNELS = ("auto", "compiled", "triton", "windowed", "exact")


def window_radius(sigma_sq: float) -> int:
    """Radius in pixels beyond which a Gaussian of variance ``sigma_sq`` (px^2) is negligible: 4 at 0.4."""
    return math.ceil(math.sqrt(2.0 * sigma_sq * math.log(1.0 / NEGLIGIBLE)))


def splat(
    points_px: Tensor,  # [M, N, 2]
    valid: Tensor,  # [M, N] bool
    height: int,
    width: int,
    sigma_sq: float,
    kernel: str = "auto",
) -> Tensor:
    """Sum of one un-normalised Gaussian per point at every pixel centre: the argument of the tanh in Eq. 2.

    Parameters
    ----------
    points_px : [M, N, 2] column and row of each point, in pixels; M is any batch of images.
    valid : [M, N] bool; points that are False add nothing and get no gradient.
    height, width : size of the image.
    sigma_sq : variance of the Gaussian, px^2.
    kernel : "compiled" (each point touches the pixels around it; on the CPU), "triton" (the same on a GPU), "windowed" (the
        same in plain torch, on any device), "exact" (every pixel, Eq. 2 as printed) or "auto" (see `cheapest`).

    Returns
    -------
    [M, height, width] sums, >= 0.

    Raises
    ------
    ValueError
        There is no kernel of that name, or it is "triton" and cannot run here.
    """
    if kernel == "auto":
        kernel = cheapest(points_px, height, width, sigma_sq)
    if kernel == "exact":
        return splat_exact(points_px, valid, height, width, sigma_sq)
    if kernel == "triton" and not triton_runs(points_px):
        found = f"{str(points_px.dtype).removeprefix('torch.')} on {points_px.device}"
        raise ValueError(f"kernel is 'triton', which needs triton and float32 points on a GPU; found {found}")
    if kernel in ("compiled", "triton", "windowed"):
        return _Windowed.apply(points_px, valid, height, width, float(sigma_sq), kernel)
    raise ValueError(f"kernel is {kernel!r}, expected one of {', '.join(KERNELS)}")


def cheapest(points_px: Tensor, height: int, width: int, sigma_sq: float) -> str:
    """The kernel that "auto" stands for: that of the GPU on one, compiled where that pays on the CPU, else one in plain torch.

    In plain torch the window is taken unless the image is small against it.
    """
    if triton_runs(points_px):
        return "triton"
    if use_numba(points_px):
        return "compiled"
    taps = (2 * window_radius(sigma_sq) + 1) ** 2
    return "windowed" if TAP_COST * taps < height * width else "exact"


class _Placed(NamedTuple):
    """The windows of n points of M images, in pictures with room around them: no tap needs a test."""

    offsets: Tensor  # [M, n, 2, k] from the taps' centres to the point, along x and y
    weights: Tensor  # [M, n, 2, k] of the taps along x and y
    corner: Tensor  # [M, n] flat index of each window's first tap


def _room(radius: int) -> int:
    """Pixels around the image: a window that touches it, or one that was parked beyond its corner, lies within them."""
    return 2 * radius + 1


def _place(points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float) -> _Placed:
    radius = window_radius(sigma_sq)
    room, reach = _room(radius), radius + 1
    x, y = points_px.unbind(-1)
    reached = valid & (x > -reach) & (x < width - 1 + reach) & (y > -reach) & (y < height - 1 + reach)
    # A point beyond the reach of the image is parked where no tap is inside: its integer coordinate could overflow.
    anchors = torch.where(reached.unsqueeze(-1), points_px, -reach)
    nearest = anchors.round()
    steps = torch.arange(-radius, radius + 1, device=points_px.device)
    offsets = (anchors - nearest).unsqueeze(-1) - steps
    column, row = (nearest.long() + (room - radius)).unbind(-1)
    stride = width + 2 * room
    image = torch.arange(len(points_px), device=points_px.device).mul_((height + 2 * room) * stride).unsqueeze(-1)
    corner = row.mul(stride).add_(column).add_(image)
    return _Placed(offsets, torch.exp(offsets.square().mul_(-0.5 / sigma_sq)), corner)


def _flat(placed: _Placed, stride: int) -> Tensor:
    """Flat index of every tap [M n k k]."""
    steps = torch.arange(placed.weights.shape[-1], device=placed.corner.device)
    window = (steps.unsqueeze(-1) * stride + steps).flatten()
    return (placed.corner.unsqueeze(-1) + window).flatten()


def _chunks(images: int, count: int, sigma_sq: float) -> list[slice]:
    per_point = max(images, 1) * (2 * window_radius(sigma_sq) + 1) ** 2
    size = max(1, TAPS_PER_CHUNK // per_point)
    return [slice(start, start + size) for start in range(0, count, size)]


class _Windowed(torch.autograd.Function):
    """Each point's window, added up; the backward pass reads the same window again, so nothing of its size k x k is stored."""

    @staticmethod
    def forward(ctx: Any, points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float, kernel: str) -> Tensor:
        ctx.save_for_backward(points_px, valid)
        ctx.sigma_sq, ctx.kernel = sigma_sq, kernel
        if kernel != "windowed":
            return _fast(kernel).sums(points_px, valid, height, width, sigma_sq, window_radius(sigma_sq))
        sums, ctx.placed = _scatter(points_px, valid, height, width, sigma_sq)
        return sums

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        points_px, valid = ctx.saved_tensors
        if ctx.kernel != "windowed":
            grad = _fast(ctx.kernel).gradient(grad_outputs[0], points_px, valid, ctx.sigma_sq, window_radius(ctx.sigma_sq))
        else:
            grad = _gather(grad_outputs[0], points_px, valid, ctx.sigma_sq, ctx.placed)
        return grad, None, None, None, None, None


def _fast(kernel: str) -> Any:
    """The module of a kernel that is not plain torch; importing it is slow."""
    if kernel == "triton":
        from . import splat_triton as triton_splat

        return triton_splat
    from . import splat_numba as compiled

    return compiled


def _scatter(points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float) -> tuple[Tensor, _Placed | None]:
    """The sums [M, H, W], and where the windows lie if one chunk held them all."""
    images, count = valid.shape
    room = _room(window_radius(sigma_sq))
    stride = width + 2 * room
    sums = points_px.new_zeros(images * (height + 2 * room) * stride)
    chunks = _chunks(images, count, sigma_sq)
    placed = None
    for part in chunks:
        placed = _place(points_px[:, part], valid[:, part], height, width, sigma_sq)
        along_x, along_y = placed.weights.unbind(2)
        sums.scatter_add_(0, _flat(placed, stride), (along_y.unsqueeze(-1) * along_x.unsqueeze(-2)).flatten())
    sums = sums.view(images, -1, stride)[:, room : room + height, room : room + width].contiguous()
    return sums, placed if len(chunks) == 1 else None


def _gather(grad_sums: Tensor, points_px: Tensor, valid: Tensor, sigma_sq: float, placed: _Placed | None) -> Tensor:
    """Derivative [M, N, 2] by ``points_px``, from that by the sums [M, H, W]."""
    images, count = valid.shape
    height, width = grad_sums.shape[1:]
    room = _room(window_radius(sigma_sq))
    padded = torch.nn.functional.pad(grad_sums, (room, room, room, room)).flatten()
    grads = []
    for part in _chunks(images, count, sigma_sq):
        own = placed or _place(points_px[:, part], valid[:, part], height, width, sigma_sq)
        side = own.weights.shape[-1]
        taps = padded.index_select(0, _flat(own, width + 2 * room)).view(*own.corner.shape, side, side)
        along_x, along_y = own.weights.unbind(2)
        # of every column the taps weighed along y, and of every row those weighed along x
        weighed = torch.cat([along_y.unsqueeze(-2) @ taps, (taps @ along_x.unsqueeze(-1)).transpose(-1, -2)], -2)
        # d/dx exp(-dx^2 / 2 sigma^2) = -dx / sigma^2 times the weight itself
        grads.append((weighed * own.weights * own.offsets).sum(-1) / -sigma_sq)
    return torch.cat(grads, 1) if grads else torch.zeros_like(points_px)
