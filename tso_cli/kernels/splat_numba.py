"""The windowed sums of Gaussians as compiled loops on the CPU.

A tap is one pixel in the window of one point. It is visited once forward and once backward.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .jit import RANGES_PER_THREAD, Array, Marks, compiled, part, share
from .simd import LANES, LOWEST, add_rows, exp, project_rows

# Points whose weights are computed together, and are used while they are in the cache.
BLOCK = 32
# A weight is 0 under exp of this exponent: the product of two such weights would be a denormal
# number of float32, and arithmetic with denormals is ten times slower.
NEGLIGIBLE_EXPONENT = -43.75
# Offset of the empty lanes of a window. It is so far from every point that the weight is 0.
PADDING = 1e9
# Basic steps for the weights of a point, in addition to the steps for its taps.
STEPS_PER_POINT = 64


def sums(
    points_px: Array,
    valid: Marks,
    height: int,
    width: int,
    sigma_sq: float,
    radius: int,
    threads: int = 1,
) -> Array:
    """The windowed sums [M, H, W] of the Gaussians of points [M, N, 2], float32 or float64.

    Each pixel adds its points in the order of the cloud, so that bands of rows can be filled in
    parallel.
    """
    images, count = valid.shape
    out = np.empty((images, height, width), points_px.dtype)
    bands, steps = _bands(images, height, radius, threads), _steps(images, count, radius)
    window = _window(sigma_sq, radius, out.dtype)
    share(images * bands, steps, threads, _add, points_px, valid, window, bands, out)
    return out


def gradient(
    by_sums: Array, points_px: Array, valid: Marks, sigma_sq: float, radius: int, threads: int = 1
) -> Array:
    """Derivative [M, N, 2] by ``points_px``, from that by the sums [M, H, W]."""
    images, count = valid.shape
    out = np.zeros((images, count, 2), points_px.dtype)
    window = _window(sigma_sq, radius, out.dtype)
    height, width = by_sums.shape[1:]
    padded = np.zeros((images, height, width + 2 * radius + len(window.steps)), points_px.dtype)
    padded[:, :, 2 * radius : 2 * radius + width] = by_sums
    steps = _steps(images, count, radius)
    share(images * count, steps, threads, _gather, points_px, valid, window, padded, out)
    return out


class Window(NamedTuple):
    """The taps of a point along one axis."""

    steps: NDArray[Any]  # offsets from the pixel of the point, padded to whole SIMD vectors
    radius: int
    factor: float  # of a squared distance (px^2) in the exponent


def _window(sigma_sq: float, radius: int, kind: np.dtype[Any]) -> Window:
    steps = np.full(-(-(2 * radius + 1) // LANES) * LANES, PADDING, kind)
    steps[: 2 * radius + 1] = np.arange(-radius, radius + 1)
    return Window(steps, radius, -0.5 / sigma_sq)


def _bands(images: int, height: int, radius: int, threads: int) -> int:
    """Number of bands of rows that each image is cut into, so that every thread gets some."""
    if threads == 1 or not images:
        return 1
    # A point whose window crosses into another band is computed twice, so a band is at least twice
    # as high as a window.
    bands = -(-RANGES_PER_THREAD * threads // images)
    return max(1, min(bands, height // (4 * radius + 2)))


def _steps(images: int, count: int, radius: int) -> int:
    """Basic steps to touch every tap of every point once."""
    return images * count * (STEPS_PER_POINT + (2 * radius + 1) ** 2)


@part
def _touches(x, y, top, bottom, width, radius):  # type: ignore[no-untyped-def]
    """Whether the window around (x, y) touches these rows; False for NaN."""
    column, row = np.rint(x), np.rint(y)
    return (
        column >= -radius
        and column < width + radius
        and row >= top - radius
        and row < bottom + radius
    )


@part
def _weigh(points, chosen, count, window, along_x, along_y):  # type: ignore[no-untyped-def]
    """The separable weights of the first ``count`` points that are ``chosen``, a row each."""
    kind, steps = points.dtype.type, window.steps
    by, least = kind(window.factor), kind(LOWEST)
    negligible, zero = kind(NEGLIGIBLE_EXPONENT), kind(0.0)
    for i in range(count):
        x, y = points[chosen[i], 0], points[chosen[i], 1]
        dx, dy = x - np.rint(x), y - np.rint(y)
        for k in range(len(steps)):
            exponent = (dx - steps[k]) * (dx - steps[k]) * by
            weight = exp(max(exponent, least))
            along_x[i, k] = weight if exponent > negligible else zero
        for k in range(len(steps)):
            exponent = (dy - steps[k]) * (dy - steps[k]) * by
            weight = exp(max(exponent, least))
            along_y[i, k] = weight if exponent > negligible else zero


@compiled
def _add(first, last, points, valid, window, bands, out):  # type: ignore[no-untyped-def]
    """Fill the bands ``first`` to ``last`` of ``out`` [M, H, W], counted through all images."""
    height, width = out.shape[1:]
    radius, span = window.radius, len(window.steps)
    # Margins take the part of a window outside the image, so that no tap needs a test. Column c of
    # the image stands at 2 radius + c.
    stride = 2 * radius + width + span
    chosen = np.empty(BLOCK, np.int64)
    along_x, along_y = np.empty((BLOCK, span), points.dtype), np.empty((BLOCK, span), points.dtype)
    across, down = along_x.reshape(-1), along_y.reshape(-1)
    for task in range(first, last):
        cloud, visible, band = points[task // bands], valid[task // bands], task % bands
        top, bottom = band * height // bands, (band + 1) * height // bands
        padded = np.zeros((bottom - top, stride), points.dtype)
        flat, size = padded.reshape(-1), 0
        for n in range(len(cloud)):
            if visible[n] and _touches(cloud[n, 0], cloud[n, 1], top, bottom, width, radius):
                chosen[size] = n
                size += 1
            if size < BLOCK and n + 1 < len(cloud):
                continue
            _weigh(cloud, chosen, size, window, along_x, along_y)
            for i in range(size):
                column, row = int(np.rint(cloud[chosen[i], 0])), int(np.rint(cloud[chosen[i], 1]))
                start, stop = max(row - radius, top), min(row + radius + 1, bottom)
                weight = i * span + start - row + radius
                for k in range(0, span, LANES):
                    place = (start - top) * stride + column + radius + k
                    add_rows(flat, place, stride, stop - start, down, weight, across, i * span + k)
            size = 0
        out[task // bands, top:bottom] = padded[:, 2 * radius : 2 * radius + width]


@compiled
def _gather(first, last, points, valid, window, padded, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` [M, N, 2] for the points ``first`` to ``last``, counted through all images.

    ``padded`` holds the derivative by the sums, in rows like the padded rows of `_add`. It is 0
    outside the image.
    """
    count, height, stride = points.shape[1], padded.shape[1], padded.shape[2]
    steps, radius, factor = window
    span = len(steps)
    width = stride - 2 * radius - span
    chosen = np.empty(BLOCK, np.int64)
    along_x, along_y = np.empty((BLOCK, span), points.dtype), np.empty((BLOCK, span), points.dtype)
    slope_x, slope_y = np.empty((BLOCK, span), points.dtype), np.empty((BLOCK, span), points.dtype)
    right, across = along_x.reshape(-1), slope_x.reshape(-1)
    down, left = along_y.reshape(-1), slope_y.reshape(-1)
    for image in range(first // count, -(-last // count)):
        cloud, flat = points[image], padded[image].reshape(-1)
        start, stop = max(first - image * count, 0), min(last - image * count, count)
        size = 0
        for n in range(start, stop):
            if valid[image, n] and _touches(cloud[n, 0], cloud[n, 1], 0, height, width, radius):
                chosen[size] = n
                size += 1
            if size < BLOCK and n + 1 < stop:
                continue
            _weigh(cloud, chosen, size, window, along_x, along_y)
            # d/dx exp(-dx^2 / 2 sigma^2) = -dx / sigma^2 times the weight itself
            for i in range(size):
                x, y = cloud[chosen[i], 0], cloud[chosen[i], 1]
                dx, dy = x - np.rint(x), y - np.rint(y)
                for k in range(span):
                    slope_x[i, k] = along_x[i, k] * (dx - steps[k])
                    slope_y[i, k] = along_y[i, k] * (dy - steps[k])
            for i in range(size):
                column, row = int(np.rint(cloud[chosen[i], 0])), int(np.rint(cloud[chosen[i], 1]))
                top, bottom = max(row - radius, 0), min(row + radius + 1, height)
                weight = i * span + top - row + radius
                by_x = by_y = 0.0
                for k in range(0, span, LANES):
                    place = top * stride + column + radius + k
                    x, y = project_rows(
                        flat, place, stride, bottom - top, down, left, weight, right, across,
                        i * span + k,
                    )  # fmt: skip
                    by_x += x
                    by_y += y
                out[image, chosen[i], 0] += 2.0 * factor * by_x
                out[image, chosen[i], 1] += 2.0 * factor * by_y
            size = 0
