"""The windowed sums of Gaussians as Triton kernels on a GPU. Experimental.

A tap is one pixel in the window of one point. It is visited once forward and once backward.
Importing this module imports triton, which builds of torch for GPUs contain: import it only where a
kernel runs.
"""

from __future__ import annotations

from typing import Any

import torch
import triton
import triton.language as tl
from torch import Tensor

# Columns of a window that a program works on at once. Wider windows are cut into strips.
MOST_COLUMNS = 128
# Taps that one program holds: one row of the windows of several points.
TAPS_PER_PROGRAM = 512


def sums(
    points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float, radius: int
) -> Tensor:
    """As `tso_cli.kernels.splat.splat`, for float32 on a GPU.

    The order of atomic additions varies, and with it the last bits.
    """
    images, count = valid.shape
    out = torch.zeros(images, height, width, dtype=points_px.dtype, device=points_px.device)
    _launch(_add, points_px, valid, out, sigma_sq, radius)
    return out


def gradient(
    grad_sums: Tensor, points_px: Tensor, valid: Tensor, sigma_sq: float, radius: int
) -> Tensor:
    """Derivative [M, N, 2] by ``points_px``, from the derivative by the sums [M, H, W]."""
    out = torch.empty_like(points_px, memory_format=torch.contiguous_format)
    _launch(_gather, points_px, valid, grad_sums.contiguous(), sigma_sq, radius, out)
    return out


def _launch(
    kernel: Any,
    points_px: Tensor,
    valid: Tensor,
    image: Tensor,
    sigma_sq: float,
    radius: int,
    *out: Tensor,
) -> None:
    if not valid.numel():
        return
    taps = min(triton.next_power_of_2(2 * radius + 1), MOST_COLUMNS)
    block = TAPS_PER_PROGRAM // taps
    # Triton launches on the current GPU; the points may be on another one.
    with torch.cuda.device_of(points_px):
        kernel[triton.cdiv(valid.numel(), block),](
            points_px.contiguous(), valid.contiguous().view(torch.uint8), image, *out,
            valid.numel(), valid.shape[1], image.shape[1], image.shape[2], 1.0 / sigma_sq, radius,
            POINTS=block, TAPS=taps,
        )  # fmt: skip


@triton.jit
def _axis(coordinate, reached):  # type: ignore[no-untyped-def]
    """Nearest integer to each coordinate, and the rest; 0 where the image is not reached.

    Integers outside the image could overflow.
    """
    place = tl.where(reached, coordinate, 0.0)
    nearest = tl.floor(place + 0.5)
    return nearest.to(tl.int32), place - nearest


@triton.jit
def _placed(points, valid, total, per_image, height, width, radius, POINTS: tl.constexpr):  # type: ignore[no-untyped-def]
    """The points of this program.

    Number, whether the window touches the image, start of the image, pixel, offset from the pixel.
    """
    number = tl.program_id(0).to(tl.int64) * POINTS + tl.arange(0, POINTS)
    there = number < total
    there = there & (tl.load(valid + number, mask=there, other=0) != 0)
    x = tl.load(points + 2 * number, mask=there, other=0.0)
    y = tl.load(points + 2 * number + 1, mask=there, other=0.0)
    # NaN passes no comparison.
    reached = (
        there
        & (x >= -radius - 0.5)
        & (x < width + radius - 0.5)
        & (y >= -radius - 0.5)
        & (y < height + radius - 0.5)
    )
    column, offset_x = _axis(x, reached)
    row, offset_y = _axis(y, reached)
    start = (number // per_image) * height * width
    return number, reached, start, column, row, offset_x, offset_y


@triton.jit
def _add(  # type: ignore[no-untyped-def]
    points, valid, out, total, per_image, height, width, inverse, radius,
    POINTS: tl.constexpr, TAPS: tl.constexpr,
):  # fmt: skip
    _, reached, start, column, row, offset_x, offset_y = _placed(
        points, valid, total, per_image, height, width, radius, POINTS
    )
    for strip in range(0, 2 * radius + 1, TAPS):
        step = strip + tl.arange(0, TAPS) - radius
        to_x = offset_x[:, None] - step[None, :]
        along_x = tl.exp(-0.5 * inverse * to_x * to_x)
        k = column[:, None] + step[None, :]
        inside = reached[:, None] & (step[None, :] <= radius) & (k >= 0) & (k < width)
        for up in range(0, 2 * radius + 1):
            to_y = offset_y - (up - radius)
            j = row + (up - radius)
            place = out + (start + j * width)[:, None] + k
            weight = tl.exp(-0.5 * inverse * to_y * to_y)[:, None] * along_x
            tl.atomic_add(
                place, weight, mask=inside & ((j >= 0) & (j < height))[:, None], sem="relaxed"
            )


@triton.jit
def _gather(  # type: ignore[no-untyped-def]
    points, valid, image, out, total, per_image, height, width, inverse, radius,
    POINTS: tl.constexpr, TAPS: tl.constexpr,
):  # fmt: skip
    number, reached, start, column, row, offset_x, offset_y = _placed(
        points, valid, total, per_image, height, width, radius, POINTS
    )
    by_x = tl.zeros([POINTS], tl.float32)
    by_y = tl.zeros([POINTS], tl.float32)
    for strip in range(0, 2 * radius + 1, TAPS):
        step = strip + tl.arange(0, TAPS) - radius
        to_x = offset_x[:, None] - step[None, :]
        along_x = tl.exp(-0.5 * inverse * to_x * to_x)
        k = column[:, None] + step[None, :]
        inside = reached[:, None] & (step[None, :] <= radius) & (k >= 0) & (k < width)
        # For each column: the weighted sum of its taps, and the same sum times their vertical
        # distance.
        value = tl.zeros([POINTS, TAPS], tl.float32)
        slope = tl.zeros([POINTS, TAPS], tl.float32)
        for up in range(0, 2 * radius + 1):
            to_y = offset_y - (up - radius)
            j = row + (up - radius)
            place = image + (start + j * width)[:, None] + k
            taps = tl.load(place, mask=inside & ((j >= 0) & (j < height))[:, None], other=0.0)
            along_y = tl.exp(-0.5 * inverse * to_y * to_y)
            value += along_y[:, None] * taps
            slope += (along_y * to_y)[:, None] * taps
        by_x += tl.sum(along_x * to_x * value, 1)
        by_y += tl.sum(along_x * slope, 1)
    # d/dx exp(-dx^2 / 2 sigma^2) = -dx / sigma^2 times the weight itself
    there = number < total
    tl.store(out + 2 * number, -inverse * by_x, mask=there)
    tl.store(out + 2 * number + 1, -inverse * by_y, mask=there)
