"""The windowed sums of Gaussians as compiled loops on the CPU: each tap is touched once forward and once backward."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .jit import RANGES_PER_THREAD, compiled, part, share
from .simd import LANES, LOWEST, add_rows, exp, project_rows

# Points whose weights are computed together, and used when they have long been written.
BLOCK = 32
# Weights below exp of this count as zero: the product of two would be a denormal number, ten times slower.
NOTHING = -43.75
# So far from every point that the weight is zero: what a window does not fill of its last sixteen lanes.
NOWHERE = 1e9
# Basic steps that the weights of a point cost beside its taps.
PER_POINT = 64


def sums(points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float, radius: int) -> Tensor:
    """As `splat`, for float32 or float64 on the CPU.

    Each pixel adds up its points in the cloud's order, so that bands of rows can be filled side by side.
    """
    images, count = valid.shape
    out = torch.empty(images, height, width, dtype=points_px.dtype)
    bands = bands_for(images, height, radius)
    share(images * bands, work(images, count, radius), _add, points_px, valid, window(sigma_sq, radius, out), bands, out)
    return out


def gradient(grad_sums: Tensor, points_px: Tensor, valid: Tensor, sigma_sq: float, radius: int) -> Tensor:
    """Derivative [M, N, 2] by ``points_px``, from that by the sums [M, H, W]."""
    images, count = valid.shape
    out = torch.zeros(images, count, 2, dtype=points_px.dtype)
    kernel = window(sigma_sq, radius, out)
    padded = torch.nn.functional.pad(grad_sums, (2 * radius, len(kernel.steps)))
    share(images * count, work(images, count, radius), project_back, points_px, valid, kernel, padded, out)
    return out


class Window(NamedTuple):
    """The taps of a point.

    Attributes
    ----------
    steps : offsets from the pixel nearest to it along one axis, filled up to whole lanes.
    radius : the largest of them.
    factor : what a squared distance (px^2) is multiplied with in the exponent.
    """

    steps: NDArray[Any]
    radius: int
    factor: float


def window(sigma_sq: float, radius: int, like: Tensor) -> Window:
    """The window of this radius, in the precision of ``like``."""
    steps = np.full(-(-(2 * radius + 1) // LANES) * LANES, NOWHERE, torch.empty(0, dtype=like.dtype).numpy().dtype)
    steps[: 2 * radius + 1] = np.arange(-radius, radius + 1)
    return Window(steps, radius, -0.5 / sigma_sq)


def bands_for(images: int, height: int, radius: int) -> int:
    """Into how many bands of rows images are cut, so that every thread has some."""
    if torch.get_num_threads() == 1 or not images:
        return 1
    # A point whose window crosses into another band is computed twice: bands are kept high against the window.
    wanted = -(-RANGES_PER_THREAD * torch.get_num_threads() // images)
    return max(1, min(wanted, height // (4 * radius + 2)))


def work(images: int, count: int, radius: int) -> int:
    """Basic steps to touch every tap of every point once."""
    return images * count * (PER_POINT + (2 * radius + 1) ** 2)


@part
def _reaches(x, y, top, bottom, width, radius):  # type: ignore[no-untyped-def]
    """Whether a window centred on the pixel nearest to (x, y) touches these rows. Nothing that is no number does."""
    column, row = np.rint(x), np.rint(y)
    return column >= -radius and column < width + radius and row >= top - radius and row < bottom + radius


@part
def _weigh(points, chosen, count, kernel, along_x, along_y):  # type: ignore[no-untyped-def]
    """The separable weights of the first ``count`` points that are ``chosen``, a row each."""
    kind, steps = points.dtype.type, kernel.steps
    by, least, nothing, zero = kind(kernel.factor), kind(LOWEST), kind(NOTHING), kind(0.0)
    for i in range(count):
        x, y = points[chosen[i], 0], points[chosen[i], 1]
        dx, dy = x - np.rint(x), y - np.rint(y)
        for k in range(len(steps)):
            exponent = (dx - steps[k]) * (dx - steps[k]) * by
            weight = exp(max(exponent, least))
            along_x[i, k] = weight if exponent > nothing else zero
        for k in range(len(steps)):
            exponent = (dy - steps[k]) * (dy - steps[k]) * by
            weight = exp(max(exponent, least))
            along_y[i, k] = weight if exponent > nothing else zero


@part
def add_band(points, valid, kernel, top, bottom, padded):  # type: ignore[no-untyped-def]
    """Write the sums of the rows ``top`` to ``bottom`` of an image, from its points [N, 2], into ``padded``.

    ``padded`` [bottom - top, 2 radius + width + lanes] has room beside the image for the part of a window that lies outside it,
    so that no tap needs a test: column c of the image is its column 2 radius + c.
    """
    radius, span, stride = kernel.radius, len(kernel.steps), padded.shape[1]
    width = stride - 2 * radius - span
    padded[:] = 0.0
    flat = padded.reshape(-1)
    chosen = np.empty(BLOCK, np.int64)
    along_x, along_y = np.empty((BLOCK, span), points.dtype), np.empty((BLOCK, span), points.dtype)
    across, down = along_x.reshape(-1), along_y.reshape(-1)
    size = 0
    for n in range(len(points)):
        if valid[n] and _reaches(points[n, 0], points[n, 1], top, bottom, width, radius):
            chosen[size] = n
            size += 1
        if size < BLOCK and n + 1 < len(points):
            continue
        _weigh(points, chosen, size, kernel, along_x, along_y)
        for i in range(size):
            column, row = int(np.rint(points[chosen[i], 0])), int(np.rint(points[chosen[i], 1]))
            start, stop = max(row - radius, top), min(row + radius + 1, bottom)
            weight = i * span + start - row + radius
            for k in range(0, span, LANES):
                place = (start - top) * stride + column + radius + k
                add_rows(flat, place, stride, stop - start, down, weight, across, i * span + k)
        size = 0


@compiled
def _add(first, last, points, valid, kernel, bands, out):  # type: ignore[no-untyped-def]
    """Fill the bands ``first`` to ``last`` of ``out`` [M, H, W], counted through all images."""
    height, width = out.shape[1:]
    left = 2 * kernel.radius
    for task in range(first, last):
        image, band = task // bands, task % bands
        top, bottom = band * height // bands, (band + 1) * height // bands
        padded = np.empty((bottom - top, left + width + len(kernel.steps)), points.dtype)
        add_band(points[image], valid[image], kernel, top, bottom, padded)
        for i in range(top, bottom):
            for j in range(width):
                out[image, i, j] = padded[i - top, left + j]


@compiled
def project_back(first, last, points, valid, kernel, padded, out):  # type: ignore[no-untyped-def]
    """Add to ``out`` [M, N, 2] what the points ``first`` to ``last``, counted through all images, get from their windows.

    ``padded`` holds the derivative by the sums, in rows as those of `add_band`; beside the image it is 0.
    """
    count, height, stride = points.shape[1], padded.shape[1], padded.shape[2]
    steps, radius, factor = kernel
    span = len(steps)
    width = stride - 2 * radius - span
    chosen = np.empty(BLOCK, np.int64)
    along_x, along_y = np.empty((BLOCK, span), points.dtype), np.empty((BLOCK, span), points.dtype)
    slope_x, slope_y = np.empty((BLOCK, span), points.dtype), np.empty((BLOCK, span), points.dtype)
    right, across, down, left = along_x.reshape(-1), slope_x.reshape(-1), along_y.reshape(-1), slope_y.reshape(-1)
    for image in range(first // count, -(-last // count)):
        own, flat = points[image], padded[image].reshape(-1)
        start, stop = max(first - image * count, 0), min(last - image * count, count)
        size = 0
        for n in range(start, stop):
            if valid[image, n] and _reaches(own[n, 0], own[n, 1], 0, height, width, radius):
                chosen[size] = n
                size += 1
            if size < BLOCK and n + 1 < stop:
                continue
            _weigh(own, chosen, size, kernel, along_x, along_y)
            # d/dx exp(-dx^2 / 2 sigma^2) = -dx / sigma^2 times the weight itself
            for i in range(size):
                x, y = own[chosen[i], 0], own[chosen[i], 1]
                dx, dy = x - np.rint(x), y - np.rint(y)
                for k in range(span):
                    slope_x[i, k] = along_x[i, k] * (dx - steps[k])
                    slope_y[i, k] = along_y[i, k] * (dy - steps[k])
            for i in range(size):
                column, row = int(np.rint(own[chosen[i], 0])), int(np.rint(own[chosen[i], 1]))
                top, bottom = max(row - radius, 0), min(row + radius + 1, height)
                weight = i * span + top - row + radius
                by_x = by_y = 0.0
                for k in range(0, span, LANES):
                    place = top * stride + column + radius + k
                    x, y = project_rows(flat, place, stride, bottom - top, down, left, weight, right, across, i * span + k)
                    by_x += x
                    by_y += y
                out[image, chosen[i], 0] += 2.0 * factor * by_x
                out[image, chosen[i], 1] += 2.0 * factor * by_y
            size = 0
