"""Noise of depth maps that differs from pixel to pixel, as sensors have it, and its removal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..geometry.arrays import Array, Bits
from ..geometry.view import View
from .findings import Finding

# The median size of a normal variable, in its deviations.
MEDIAN_OF_NORMAL = 0.6745
# Fewer second differences say nothing of the noise.
FEWEST_DIFFERENCES = 24
# A pixel is averaged with those up to this many away. Farther ones are often of another surface, as
# are depths that are this many deviations of the noise away.
REACH, ANOTHER_SURFACE = 2, 2.0


def without_noise(views: Sequence[View]) -> tuple[list[View], list[Finding]]:
    """The views with the depth maps smoothed whose noise is deeper than a pixel is wide."""
    rows = [_without_noise(view, number) for number, view in enumerate(views)]
    return [view for view, _ in rows], [finding for _, finding in rows if finding]


def _without_noise(view: View, number: int) -> tuple[View, Finding | None]:
    if view.depth is None:
        return view, None
    known = view.inside & np.isfinite(view.depth)
    # In a large picture most pixels are around the object.
    rows, columns = (np.flatnonzero(known.any(axis))[[0, -1]] + [0, 1] for axis in (1, 0))
    box = slice(*rows), slice(*columns)
    depth, known = view.depth[box], known[box]
    deviation = noise(depth, known)
    # The maps of some kinds have a unit of their own. An object is about as deep as it is wide.
    low, high = np.quantile(depth[known], [0.1, 0.9])
    if deviation <= (high - low) / np.subtract(view.box()[2:], view.box()[:2]).max():
        return view, None
    for axis in (0, 1):
        depth = _averaged(depth, known, axis, deviation)
    smoothed = view.depth.copy()
    smoothed[box] = depth
    finding = Finding("depth-noisy", (number,), values={"deviation": deviation})
    return replace(view, depth=smoothed), finding


def noise(depth: Array, known: Bits) -> float:
    """The standard deviation of noise that is independent from pixel to pixel.

    It is the median size of the second differences along rows and columns where ``depth`` [H, W] is
    ``known``, over that of normal noise. A smooth surface has hardly any, and edges are few.
    """
    values, sizes = np.where(known, depth, np.nan), []
    for part in (values, values.T):
        second = part[1:-1] - (part[:-2] + part[2:]) / 2.0
        sizes.append(np.abs(second[np.isfinite(second)]))
    joined = np.concatenate(sizes)
    if len(joined) < FEWEST_DIFFERENCES:
        return 0.0
    return float(np.median(joined) / (MEDIAN_OF_NORMAL * np.sqrt(1.5)))


def _averaged(depth: Array, known: Bits, axis: int, deviation: float) -> Array:
    """Each known pixel is the mean of those along the axis, by how near their depths are.

    A bilateral filter (Tomasi and Manduchi, 1998) with a box in space.
    """
    length, padding = depth.shape[axis], [(0, 0), (0, 0)]
    padding[axis] = REACH, REACH
    padded = np.pad(np.where(known, depth, np.inf), padding, constant_values=np.inf)
    here, total, weights = np.where(known, depth, 0.0), np.zeros(depth.shape), np.zeros(depth.shape)
    for start in range(2 * REACH + 1):
        other = padded.take(range(start, start + length), axis)
        weight = np.exp(-0.5 * np.square((other - here) / (ANOTHER_SURFACE * deviation)))
        total += weight * np.where(np.isfinite(other), other, 0.0)
        weights += weight
    return np.where(known, total / np.where(known, weights, 1.0), depth)
