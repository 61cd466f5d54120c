"""Cross-entropy and distances between pixels and points as compiled loops on the CPU.

Value and gradient come from one pass. The reference forms are `tso_cli.losses.silhouette` in numpy,
and `tso_cli.silhouette.bce` and `affinity` in torch.
"""

from __future__ import annotations

import math

import numpy as np

from .jit import Array, Marks, compiled, kept_on_disk, part, share
from .nearest_numba import (
    cell_edge,
    nearest_in_cells,
    nearest_in_column,
    nearest_marked,
    sort_into_cells,
)
from .simd import LOWEST, exp, log

LOG_TWO = math.log(2.0)
# Under this sum, 2 s + log(1 + e^-2s) - log 2 loses digits of float32; its series is used.
SMALL_SUM = 0.05


def cross_entropy(
    sums: Array, foreground: Array, background: Array, uncovered: float, threads: int = 1
) -> tuple[Array, Array, Marks]:
    """Binary cross-entropy of mask and silhouette (Eq. 4), without the uncovered mask pixels.

    A mask pixel is uncovered if its sum is at most ``uncovered``.

    Parameters
    ----------
    sums : [M, H, W]. foreground, background : [M, H, W] weights of the two terms of Eq. 4.

    Returns
    -------
    The cross-entropy [M], its derivative [M, H, W] by ``sums``, and the uncovered pixels [M, H, W].
    """
    images, height, width = sums.shape
    gradient, waiting = sums.copy(), np.empty(sums.shape, bool)
    loss = np.empty((images, height))
    rows = (array.reshape(-1, width) for array in (foreground, background, gradient, waiting))
    share(
        images * height, 8 * sums.size, threads, _cross_entropy, *rows, uncovered, loss.reshape(-1)
    )
    # The rows are added in order, so that the number of threads changes no bit.
    return loss.cumsum(1)[:, -1], gradient, waiting


def pixels_to_points(
    pixels: Marks, weight: Array, points_px: Array, valid: Marks, factor: float, threads: int = 1
) -> tuple[Array, Array]:
    """Sum [M] over ``pixels`` [M, H, W] of weight * factor * squared distance to the nearest point.

    Returns the sum, and its derivative [M, N, 2] by the projected points.
    """
    total, gradient = np.empty(len(points_px)), np.zeros_like(points_px)
    edge = cell_edge(pixels.shape[1], pixels.shape[2], points_px.shape[1])
    steps = 4 * pixels.size + 8 * valid.size
    arguments = pixels, weight, points_px, valid, factor, edge, total, gradient
    share(len(pixels), steps, threads, _pixels_to_points, *arguments)
    return total, gradient


def points_to_mask(
    points_px: Array, valid: Marks, inside: Marks, threads: int = 1
) -> tuple[Array, Array]:
    """Sum [M] over points outside the mask of the squared distance to the nearest mask pixel.

    ``inside`` [M, H, W] is the mask. Returns the sum, and its derivative [M, N, 2] by the points.
    """
    total, gradient = np.empty(len(points_px)), np.zeros_like(points_px)
    steps = 8 * inside.size + 32 * valid.size
    share(len(inside), steps, threads, _points_to_mask, points_px, valid, inside, total, gradient)
    return total, gradient


@part
def _entropy_of_row(sums, foreground, background, uncovered, waiting):  # type: ignore[no-untyped-def]
    """Loss of a row of pixels; replaces ``sums`` by the derivative.

    It has no branches, so that the compiler makes SIMD code of it.
    """
    kind = sums.dtype.type
    zero, half, one, two, four = kind(0.0), kind(0.5), kind(1.0), kind(2.0), kind(4.0)
    least, limit, small, log_two = kind(LOWEST), kind(uncovered), kind(SMALL_SUM), kind(LOG_TWO)
    loss = zero
    for j in range(len(sums)):
        s, cover, free = sums[j], foreground[j], background[j]
        covered = s > limit
        twice = two * (s if covered else one)
        power = exp(max(-twice, least))
        # 1 - power; by its series where the difference would lose digits
        series = one - twice * kind(1.0 / 8.0) * (one - twice * kind(1.0 / 9.0))
        series = one - twice * kind(1.0 / 6.0) * (one - twice * kind(1.0 / 7.0) * series)
        series = one - twice * kind(1.0 / 4.0) * (one - twice * kind(1.0 / 5.0) * series)
        series = twice * (one - twice * half * (one - twice * kind(1.0 / 3.0) * series))
        complement = one - power if twice > half else series
        more = log(one + power)
        # -log tanh s, and -log(1 - tanh s)
        missed = more - log(complement)
        extra = (
            twice + more - log_two
            if s > small
            else s * (one + s * (half - s * s * kind(1.0 / 12.0)))
        )
        loss += (cover * missed if covered else zero) + free * extra
        toward = four * power / (complement * (one + power)) if covered else zero
        sums[j] = free * two / (one + power) - cover * toward if covered else free
        waiting[j] = cover > zero and s <= limit
    return loss


@compiled
def _cross_entropy(first, last, foreground, background, gradient, waiting, uncovered, loss):  # type: ignore[no-untyped-def]
    for row in range(first, last):
        loss[row] = _entropy_of_row(
            gradient[row], foreground[row], background[row], uncovered, waiting[row]
        )


@compiled
def _pixels_to_points(first, last, pixels, weight, points, valid, factor, edge, total, gradient):  # type: ignore[no-untyped-def]
    height, width = pixels.shape[1:]
    for image in range(first, last):
        total[image] = 0.0
        if not pixels[image].any() or not valid[image].any():
            continue
        cells = sort_into_cells(points[image], valid[image], height, width, edge)
        begin, order = cells[2], cells[5]
        if begin[-1] == 0:
            continue
        loss, place, above = 0.0, 0, np.zeros(width, np.int64)
        for i in range(height):
            for j in range(width):
                if pixels[image, i, j]:
                    place = nearest_in_cells(float(j), float(i), edge, cells, place, above[j])
                    above[j], n = place, order[place]
                    by_x, by_y = points[image, n, 0] - j, points[image, n, 1] - i
                    w = factor * weight[image, i, j]
                    loss += w * (by_x * by_x + by_y * by_y)
                    gradient[image, n, 0] += 2.0 * w * by_x
                    gradient[image, n, 1] += 2.0 * w * by_y
        total[image] = loss


@kept_on_disk
def _points_to_mask(first, last, points, valid, inside, total, gradient):  # type: ignore[no-untyped-def]
    height, width = inside.shape[1:]
    nearest_row = np.empty((height, width), np.int32)
    for image in range(first, last):
        nearest_in_column(inside[image], nearest_row)
        loss = 0.0
        for n in range(points.shape[1]):
            x, y = np.rint(points[image, n, 0]), np.rint(points[image, n, 1])
            # A pixel outside the image is unknown, not background.
            if not (valid[image, n] and x >= 0 and x < width and y >= 0 and y < height):
                continue
            i, j = int(y), int(x)
            if inside[image, i, j]:
                continue
            row, column = nearest_marked(i, j, nearest_row)
            if row >= 0:
                by_x, by_y = points[image, n, 0] - column, points[image, n, 1] - row
                loss += by_x * by_x + by_y * by_y
                gradient[image, n, 0] = 2.0 * by_x
                gradient[image, n, 1] = 2.0 * by_y
        total[image] = loss
