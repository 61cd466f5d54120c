"""Triangles and outlines drawn on a grid of samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .arrays import Array, Bits

MOST_CROSSINGS = 10_000_000  # of an outline and rows of samples; each takes some 60 bytes
ACROSS = 3  # samples across a cell: an odd number has no ties at half coverage


def covered(triangles: Array, height: int, width: int) -> NDArray[np.uint8]:
    """1 at those of the samples [height, width] that lie in one of ``triangles`` [F, 3, 2].

    Corners are columns and rows: the sample [r, c] lies at (c, r). A sample on an edge counts.
    """
    low, high = triangles[..., 1].min(1), triangles[..., 1].max(1)
    first = np.ceil(np.maximum(low, 0.0)).astype(np.int64)
    count = np.maximum(np.floor(np.minimum(high, height - 1.0)).astype(np.int64) - first + 1, 0)
    # Each triangle once for every row of samples that it crosses.
    row = np.arange(count.sum()) - np.repeat(count.cumsum() - count - first, count)
    corners = np.repeat(triangles, count, 0)
    ends = np.roll(corners, -1, 1)
    x, y = corners[..., 0], corners[..., 1]
    dx, dy = ends[..., 0] - x, ends[..., 1] - y
    at = row[:, None]
    # An edge along the row has both ends on other edges.
    crosses = (
        (dy != 0.0) & (np.minimum(y, ends[..., 1]) <= at) & (at <= np.maximum(y, ends[..., 1]))
    )
    crossing = x + (at - y) * dx / np.where(dy == 0.0, 1.0, dy)
    begin = np.ceil(np.where(crosses, crossing, np.inf).min(1)).clip(0, width)
    end = np.floor(np.where(crosses, crossing, -np.inf).max(1)).clip(-1, width - 1)
    crossed = begin <= end
    # The spans that have begun, less those that have ended, are the triangles over a sample.
    size, first_cell = height * (width + 1), row[crossed] * (width + 1)
    begun = np.bincount(first_cell + begin[crossed].astype(np.int64), minlength=size)
    ended = np.bincount(first_cell + end[crossed].astype(np.int64) + 1, minlength=size)
    inside = (begun - ended).reshape(height, width + 1).cumsum(1)[:, :-1] > 0
    return inside.astype(np.uint8)


def mostly_covered(triangles: Array, height: int, width: int) -> Bits:
    """The cells [height, width] that lie by more than half in ``triangles`` [F, 3, 2].

    A cell has `ACROSS` times `ACROSS` samples. Corners are columns and rows of samples, as in
    `covered`.
    """
    marks = covered(triangles, ACROSS * height, ACROSS * width)
    # Sums of slices take a tenth of the time of a sum over two axes.
    hits = np.zeros((height, width), np.uint8)
    for number in range(ACROSS**2):
        hits += marks[number // ACROSS :: ACROSS, number % ACROSS :: ACROSS]
    mask: Bits = 2 * hits > ACROSS**2
    return mask


def fill(mask: Bits, corners: Array, most: int) -> int:
    """Set the samples of ``mask`` [H, W] inside the closed outline ``corners`` [K, 2] (`covered`).

    A sample is inside if a line from it crosses the outline an odd number of times. Returns how
    many samples and crossings were looked at; raises ValueError for over ``most``.
    """
    sides = mask.shape[::-1]
    low = np.floor(corners.min(0)).clip(0, sides).astype(np.int64)
    width, height = (np.ceil(corners.max(0)) + 1).clip(low, sides).astype(np.int64) - low
    x, y = (corners - low).T
    across, down = np.roll(x, -1) - x, np.roll(y, -1) - y
    first = np.ceil(np.minimum(y, y + down)).clip(0, height).astype(np.int64)
    count = np.ceil(np.maximum(y, y + down)).clip(0, height).astype(np.int64) - first
    total = int(count.sum())
    if (work := total + int(width * height)) > most or total > MOST_CROSSINGS:
        raise ValueError(f"outlines that cross {total:,} rows of {width:,} pixels")
    row = np.arange(total) - np.repeat(count.cumsum() - count - first, count)
    edge = np.repeat(np.arange(len(x)), count)
    crossing = x[edge] + (row - y[edge]) * across[edge] / down[edge]
    column = np.ceil(crossing).clip(0, width).astype(np.int64)
    # Parities alone count, so that they may overflow.
    flips = np.bincount(row * (width + 1) + column, minlength=height * (width + 1))
    odd = flips.astype(np.uint8).reshape(height, width + 1)[:, :-1] & 1
    (left, top), inside = low, np.bitwise_xor.accumulate(odd, 1) == 1
    mask[top : top + height, left : left + width] |= inside
    return work
