"""The windowed sums of Gaussians as compiled loops on the CPU: each tap is touched once forward and once backward."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from .jit import RANGES_PER_THREAD, compiled, share

# Rows of taps are worked on in blocks of this many, which the compiler turns into vector instructions.
BLOCK = 16
# Below this a weight counts as zero: the product of two would be a denormal number, ten times slower.
TINY = 1e-19
# Divided by instead of 0, where sigma^2 is so small that both are 0.
SMALLEST = 1e-30
# Steps that the weights of a point cost beside its taps.
PER_POINT = 64


def sums(points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float, radius: int) -> Tensor:
    """As :func:`tso_cli.kernels.splat.splat`, for float32 or float64 on the CPU.

    Each pixel adds up its points in the cloud's order, so that bands of rows can be filled side by side.
    """
    images, count = valid.shape
    out = torch.empty(images, height, width, dtype=points_px.dtype)
    bands = 1
    if torch.get_num_threads() > 1 and images:
        # A point whose window crosses into another band is computed twice: bands are kept high against the window.
        wanted = -(-RANGES_PER_THREAD * torch.get_num_threads() // images)
        bands = max(1, min(wanted, height // (4 * radius + 2)))
    steps = images * count * (PER_POINT + _taps(radius))
    share(images * bands, steps, _add, points_px, valid, sigma_sq, _decay(sigma_sq, radius, points_px), bands, out)
    return out


def gradient(grad_sums: Tensor, points_px: Tensor, valid: Tensor, sigma_sq: float, radius: int) -> Tensor:
    """Derivative [M, N, 2] by ``points_px``, from that by the sums [M, H, W]."""
    images, count = valid.shape
    out = torch.empty(images, count, 2, dtype=points_px.dtype)
    margin = 2 * radius, radius + _blocked(radius)
    padded = torch.nn.functional.pad(grad_sums, margin)
    steps = images * count * (PER_POINT + _taps(radius))
    share(images * count, steps, _gather, points_px, valid, sigma_sq, _decay(sigma_sq, radius, points_px), padded, out)
    return out


def _decay(sigma_sq: float, radius: int, like: Tensor) -> Tensor:
    """exp(-k / sigma^2), k = 0 to radius: by how much more each further tap falls than the one before it."""
    return torch.tensor([math.exp(-k / sigma_sq) for k in range(radius + 1)], dtype=like.dtype)


def _taps(radius: int) -> int:
    return (2 * radius + 1) * _blocked(radius)


def _blocked(radius: int) -> int:
    return -(-(2 * radius + 1) // BLOCK) * BLOCK


@compiled
def _weigh(offset, sigma_sq, decay, weights):  # type: ignore[no-untyped-def]
    """exp(-(offset - k)^2 / (2 sigma^2)) for k = -radius to radius, |offset| <= 0.5, with two exponentials.

    From one tap to the next the weight falls by exp((offset - 0.5) / sigma^2) exp(-k / sigma^2) to the right, with -offset to
    the left. No factor is above 1; the two differ by exp(-1 / sigma^2), so that the larger one gives the other.
    """
    # Numbers of the weights' own precision: an exponential of float32 costs half as much.
    kind = weights.dtype.type
    inverse, half = kind(1.0 / sigma_sq), kind(0.5)
    radius = len(decay) - 1
    right = left = weights[radius] = math.exp(-half * offset * offset * inverse)
    larger = math.exp((abs(offset) - half) * inverse)
    smaller = decay[1] / max(larger, kind(SMALLEST))
    to_right, to_left = (larger, smaller) if offset > kind(0.0) else (smaller, larger)
    for k in range(radius):
        right *= to_right * decay[k]
        left *= to_left * decay[k]
        weights[radius + 1 + k] = right if right > kind(TINY) else kind(0.0)
        weights[radius - 1 - k] = left if left > kind(TINY) else kind(0.0)


@compiled
def _reaches(x, y, height, width, radius):  # type: ignore[no-untyped-def]
    """Whether a window centred on the pixel nearest to (x, y) touches the image. Nothing that is no number does."""
    column, row = np.rint(x), np.rint(y)
    return column >= -radius and column < width + radius and row >= -radius and row < height + radius


@compiled
def _add(first, last, points, valid, sigma_sq, decay, bands, out):  # type: ignore[no-untyped-def]
    """Fill the bands ``first`` to ``last`` of ``out`` [M, H, W], counted through all images."""
    height, width = out.shape[1:]
    radius = len(decay) - 1
    span = (2 * radius + BLOCK) // BLOCK * BLOCK
    along_x, along_y = np.zeros(span, points.dtype), np.zeros(2 * radius + 1, points.dtype)
    for task in range(first, last):
        image, band = task // bands, task % bands
        top, bottom = band * height // bands, (band + 1) * height // bands
        # Room beside the image for the part of a window that lies outside it: no tap needs a test.
        padded = np.zeros((bottom - top, width + 3 * radius + span), points.dtype)
        for n in range(points.shape[1]):
            x, y = points[image, n, 0], points[image, n, 1]
            if not (valid[image, n] and _reaches(x, y, height, width, radius)):
                continue
            column, row = int(np.rint(x)), int(np.rint(y))
            start, stop = max(row - radius, top), min(row + radius + 1, bottom)
            if start >= stop:
                continue
            _weigh(x - np.rint(x), sigma_sq, decay, along_x)
            _weigh(y - np.rint(y), sigma_sq, decay, along_y)
            for j in range(start, stop):
                weight = along_y[j - row + radius]
                line = padded[j - top, column + radius : column + radius + span]
                for k in range(span):
                    line[k] += weight * along_x[k]
        out[image, top:bottom] = padded[:, 2 * radius : 2 * radius + width]


@compiled
def _gather(first, last, points, valid, sigma_sq, decay, padded, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` [M, N, 2] for the points ``first`` to ``last``, counted through all images."""
    count, height = points.shape[1], padded.shape[1]
    radius = len(decay) - 1
    span = (2 * radius + BLOCK) // BLOCK * BLOCK
    width = padded.shape[2] - 3 * radius - span
    along_x, along_y = np.zeros(span, points.dtype), np.zeros(2 * radius + 1, points.dtype)
    slope_x = np.zeros(span, points.dtype)
    for task in range(first, last):
        image, n = task // count, task % count
        x, y = points[image, n, 0], points[image, n, 1]
        by_x = by_y = 0.0
        if valid[image, n] and _reaches(x, y, height, width, radius):
            column, row = int(np.rint(x)), int(np.rint(y))
            _weigh(x - np.rint(x), sigma_sq, decay, along_x)
            _weigh(y - np.rint(y), sigma_sq, decay, along_y)
            for k in range(2 * radius + 1):
                slope_x[k] = along_x[k] * (x - (column + k - radius))
            for j in range(max(row - radius, 0), min(row + radius + 1, height)):
                line = padded[image, j, column + radius : column + radius + span]
                value = slope = points.dtype.type(0.0)
                for k in range(span):
                    value += along_x[k] * line[k]
                    slope += slope_x[k] * line[k]
                by_x += along_y[j - row + radius] * slope
                by_y += along_y[j - row + radius] * (y - j) * value
        # d/dx exp(-dx^2 / 2 sigma^2) = -dx / sigma^2 times the weight itself
        out[image, n, 0] = -by_x / sigma_sq
        out[image, n, 1] = -by_y / sigma_sq
