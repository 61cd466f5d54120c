"""The mask losses' sums over pixels and points as compiled loops on the CPU: value and derivative in one pass.

Each has its twin in plain torch in `tso_cli.silhouette.losses`, which runs on any device and is what the tests hold it against.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .jit import compiled, part, share
from .nearest_numba import cell_edge, nearest_in_cells, nearest_in_column, sort_into_cells
from .simd import LOWEST, exp, log

LOG_TWO = math.log(2.0)


def cross_entropy(sums: Tensor, wanted: Tensor, unwanted: Tensor, uncovered: float) -> Tensor:
    """Binary cross-entropy [M] of mask and silhouette from the sums [M, H, W], without the pixels that wait for a point.

    ``wanted`` and ``unwanted`` [M, H, W] are the weights of the mask and of its complement. Mask pixels whose sum is at most
    ``uncovered`` add nothing.
    """
    total, slope = sums.new_empty(len(sums)), sums.detach().clone(memory_format=torch.contiguous_format)
    share(len(sums), 8 * sums.numel(), _cross_entropy, wanted, unwanted, uncovered, total, slope)
    return WithSlope.apply(sums, total, slope)


def pull_to_pixels(pixels: Tensor, weight: Tensor, points_px: Tensor, valid: Tensor, factor: float) -> Tensor:
    """Sum [M] over the marked pixels of weight * factor * squared distance to the nearest projected point."""
    total, slope = points_px.new_empty(len(points_px)), torch.zeros_like(points_px, memory_format=torch.contiguous_format)
    edge = cell_edge(pixels.shape[1], pixels.shape[2], points_px.shape[1])
    steps = 4 * pixels.numel() + 8 * valid.numel()
    share(len(pixels), steps, _pull_to_pixels, pixels, pixels.sum(-1), weight, points_px, valid, factor, edge, total, slope)
    return WithSlope.apply(points_px, total, slope)


def pull_to_mask(points_px: Tensor, valid: Tensor, inside: Tensor) -> Tensor:
    """Sum [M] over the points that fall on background of the squared distance to the nearest pixel that is ``inside``."""
    total, slope = points_px.new_empty(len(points_px)), torch.zeros_like(points_px, memory_format=torch.contiguous_format)
    share(len(inside), 8 * inside.numel() + 32 * valid.numel(), _pull_to_mask, points_px, valid, inside, total, slope)
    return WithSlope.apply(points_px, total, slope)


class WithSlope(torch.autograd.Function):
    """``value`` [M] as a function of ``variable`` [M, ...] whose derivative is ``slope``."""

    @staticmethod
    def forward(ctx: Any, variable: Tensor, value: Tensor, slope: Tensor) -> Tensor:
        ctx.save_for_backward(slope)
        return value

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        (slope,) = ctx.saved_tensors
        return grad_outputs[0].view(-1, 1, 1) * slope, None, None


@part
def entropy_of_row(line, wanted, unwanted, uncovered, asking):  # type: ignore[no-untyped-def]
    """Loss of a row of pixels; ``line``, their sums, becomes the derivative by them.

    ``asking`` is set where the mask wants a point and no window reaches. Returns the loss, and how many pixels ask. There is no
    branch in it, so that the compiler can work on many pixels at once.
    """
    kind = line.dtype.type
    zero, half, one, two, four = kind(0.0), kind(0.5), kind(1.0), kind(2.0), kind(4.0)
    least, limit, small, log_two = kind(LOWEST), kind(uncovered), kind(0.05), kind(LOG_TWO)
    loss, waiting = zero, 0
    for j in range(len(line)):
        s, wish, rest = line[j], wanted[j], unwanted[j]
        covered = s > limit
        twice = two * (s if covered else one)
        power = exp(max(-twice, least))
        # 1 - power, by its series where the difference would lose digits
        series = one - twice * kind(1.0 / 8.0) * (one - twice * kind(1.0 / 9.0))
        series = one - twice * kind(1.0 / 6.0) * (one - twice * kind(1.0 / 7.0) * series)
        series = one - twice * kind(1.0 / 4.0) * (one - twice * kind(1.0 / 5.0) * series)
        series = twice * (one - twice * half * (one - twice * kind(1.0 / 3.0) * series))
        complement = one - power if twice > half else series
        more = log(one + power)
        # -log tanh s, and -log(1 - tanh s)
        miss = more - log(complement)
        stray = twice + more - log_two if s > small else s * (one + s * (half - s * s * kind(1.0 / 12.0)))
        loss += (wish * miss if covered else zero) + rest * stray
        toward = four * power / (complement * (one + power)) if covered else zero
        line[j] = rest * two / (one + power) - wish * toward if covered else rest
        asks = wish > zero and not covered
        asking[j] = asks
        waiting += asks
    return loss, waiting


@compiled
def _cross_entropy(first, last, wanted, unwanted, uncovered, total, slope):  # type: ignore[no-untyped-def]
    asking = np.empty(slope.shape[2], np.bool_)
    for image in range(first, last):
        loss = 0.0
        for i in range(slope.shape[1]):
            loss += entropy_of_row(slope[image, i], wanted[image, i], unwanted[image, i], uncovered, asking)[0]
        total[image] = loss


@part
def pull_image(asking, waiting, weight, points, valid, factor, edge, slope):  # type: ignore[no-untyped-def]
    """Loss of the pixels that are ``asking`` [H, W], ``waiting`` [H] in each row; ``slope`` [N, 2] gets the derivative."""
    height, width = asking.shape
    some = 0
    for i in range(height):
        some += waiting[i]
    if some == 0:
        return 0.0
    cells = sort_into_cells(points, valid, height, width, edge)
    loss = 0.0
    for i in range(height):
        if waiting[i] == 0:
            continue
        for j in range(width):
            if not asking[i, j]:
                continue
            n = nearest_in_cells(float(j), float(i), edge, cells)
            if n < 0:
                return 0.0
            by_x, by_y = points[n, 0] - j, points[n, 1] - i
            w = factor * weight[i, j]
            loss += w * (by_x * by_x + by_y * by_y)
            slope[n, 0] += 2.0 * w * by_x
            slope[n, 1] += 2.0 * w * by_y
    return loss


@compiled
def _pull_to_pixels(first, last, pixels, waiting, weight, points, valid, factor, edge, total, slope):  # type: ignore[no-untyped-def]
    for image in range(first, last):
        total[image] = pull_image(
            pixels[image], waiting[image], weight[image], points[image], valid[image], factor, edge, slope[image]
        )


@compiled
def _pull_to_mask(first, last, points, valid, inside, total, slope):  # type: ignore[no-untyped-def]
    height, width = inside.shape[1:]
    near = np.empty((height, width), np.int32)
    for image in range(first, last):
        nearest_in_column(inside[image], near)
        loss = 0.0
        for n in range(points.shape[1]):
            x, y = np.rint(points[image, n, 0]), np.rint(points[image, n, 1])
            # What lies outside the image is unknown, not background.
            if not (valid[image, n] and x >= 0 and x < width and y >= 0 and y < height):
                continue
            i, j = int(y), int(x)
            if inside[image, i, j]:
                continue
            best, goal_row, goal_column = width * width + height * height, -1, -1
            for away in range(width):
                # No column further out can hold a nearer pixel.
                if away * away >= best:
                    break
                for column in (j - away, j + away):
                    if 0 <= column < width and near[i, column] >= 0:
                        squared = away * away + (near[i, column] - i) ** 2
                        if squared < best:
                            best, goal_row, goal_column = squared, near[i, column], column
            if goal_row >= 0:
                by_x, by_y = points[image, n, 0] - goal_column, points[image, n, 1] - goal_row
                loss += by_x * by_x + by_y * by_y
                slope[image, n, 0] = 2.0 * by_x
                slope[image, n, 1] = 2.0 * by_y
        total[image] = loss
