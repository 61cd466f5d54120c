"""The mask losses' sums over pixels and points as compiled loops on the CPU: value and derivative in one pass.

Each has its twin in plain torch in :mod:`tso_cli.losses`, which runs on any device and is what the tests hold it against.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .compiled_nearest import nearest_in_column, nearest_points
from .jit import compiled, share


def cross_entropy(sums: Tensor, mask: Tensor, known: Tensor | None, uncovered: float) -> Tensor:
    """Binary cross-entropy [M] of mask and silhouette from the sums [M, H, W], without the pixels that wait for a point.

    Mask pixels whose sum is at most ``uncovered`` add nothing. ``known`` [M, H, W] weighs the pixels; None counts all.
    """
    total, slope = sums.new_empty(len(sums)), torch.empty_like(sums, memory_format=torch.contiguous_format)
    weight = torch.ones(1, 1, 1, dtype=sums.dtype).expand_as(sums) if known is None else known
    share(len(sums), 8 * sums.numel(), _cross_entropy, sums, weight, mask, uncovered, total, slope)
    return WithSlope.apply(sums, total, slope)


def pull_to_pixels(pixels: Tensor, weight: Tensor, points_px: Tensor, valid: Tensor, factor: float) -> Tensor:
    """Sum [M] over the marked pixels of weight * factor * squared distance to the nearest projected point."""
    total, slope = points_px.new_empty(len(points_px)), torch.zeros_like(points_px, memory_format=torch.contiguous_format)
    index = nearest_points(pixels, points_px, valid)
    share(len(pixels), 2 * pixels.numel(), _pull_to_pixels, index, weight, points_px, factor, total, slope)
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
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        (slope,) = ctx.saved_tensors
        return grad_outputs[0].view(-1, 1, 1) * slope, None, None


@compiled
def _cross_entropy(first, last, sums, weight, mask, uncovered, total, slope):  # type: ignore[no-untyped-def]
    for image in range(first, last):
        loss = 0.0
        for i in range(sums.shape[1]):
            for j in range(sums.shape[2]):
                s, m, w = sums[image, i, j], float(mask[image, i, j]), float(weight[image, i, j])
                if s <= uncovered:
                    # most of a picture: -log(1 - tanh s) is s here
                    loss += w * (1.0 - m) * s
                    slope[image, i, j] = w * (1.0 - m)
                    continue
                power = math.exp(-2.0 * s)
                complement = 1.0 - power if s > 1e-3 else 2.0 * s * (1.0 - s * (1.0 - s * (2.0 - s) / 3.0))
                rate = 0.0
                if m != 1.0:
                    # -log(1 - tanh s)
                    loss += w * (1.0 - m) * (2.0 * s + math.log(0.5 + 0.5 * power))
                    rate += (1.0 - m) * 2.0 / (1.0 + power)
                if m != 0.0:
                    # -log tanh s
                    loss += w * m * math.log((1.0 + power) / complement)
                    rate -= m * 4.0 * power / (complement * (1.0 + power))
                slope[image, i, j] = w * rate
        total[image] = loss


@compiled
def _pull_to_pixels(first, last, index, weight, points, factor, total, slope):  # type: ignore[no-untyped-def]
    for image in range(first, last):
        loss = 0.0
        for i in range(index.shape[1]):
            for j in range(index.shape[2]):
                n = index[image, i, j]
                if n < 0:
                    continue
                by_x, by_y = points[image, n, 0] - j, points[image, n, 1] - i
                w = factor * weight[image, i, j]
                loss += w * (by_x * by_x + by_y * by_y)
                slope[image, n, 0] += 2.0 * w * by_x
                slope[image, n, 1] += 2.0 * w * by_y
        total[image] = loss


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
