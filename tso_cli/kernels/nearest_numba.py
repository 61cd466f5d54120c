"""Exact nearest neighbours as compiled loops on the CPU: points to pixels, pixels in a column, batches of small clouds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import compiled, part, share

Array = NDArray[np.floating[Any]]

# Points per cell of the grid, on average over the image. Fastest from 1,000 to 100,000 points.
POINTS_PER_CELL = 1.0
# Queries compared with a point at once: the compiler makes SIMD code of them, and they stay in the first-level cache.
BLOCK = 256


def cell_edge(height: int, width: int, count: int) -> float:
    """Edge in pixels of the cells that ``count`` points of an image are sorted into."""
    return max(1.0, math.sqrt(POINTS_PER_CELL * height * width / max(1, count)))


def nearest_in_rows(queries: Array, data: Array, threads: int = 1) -> NDArray[np.int64]:
    """[B, Q] which of the points [B, N, 3] is nearest to each query [B, Q, 3], by all pairs."""
    index = np.empty(queries.shape[:2], np.int64)
    share(len(queries), index.size * data.shape[1] // 8, threads, _compare_all, queries, data, index)
    return index


@part
def _cell(x, y, edge, rows, columns):  # type: ignore[no-untyped-def]
    """Row and column of the cell that holds (x, y), clamped to the grid."""
    row = min(max((y + 0.5) / edge, 0.0), rows - 1.0)
    column = min(max((x + 0.5) / edge, 0.0), columns - 1.0)
    return int(row), int(column)


@part
def sort_into_cells(points, valid, height, width, edge):  # type: ignore[no-untyped-def]
    """Sort the points [N, 2] of an image into a grid of cells.

    Returns ``empty_rings`` [rows, columns], rings of empty cells around each; ``begin``, the points of cell c being those from
    begin[c] to begin[c + 1]; and their coordinates and numbers in that order.
    """
    count = len(points)
    rows, columns = int(math.ceil(height / edge)), int(math.ceil(width / edge))
    # While points are sorted in, the start of cell c stands at c + 1.
    begin = np.zeros(rows * columns + 2, np.int64)
    xs, ys, order = np.empty(count, np.float64), np.empty(count, np.float64), np.empty(count, np.int64)
    cells = np.empty(count, np.int64)
    for n in range(count):
        x, y = points[n, 0], points[n, 1]
        cells[n] = -1
        if valid[n] and np.isfinite(x) and np.isfinite(y):
            row, column = _cell(x, y, edge, rows, columns)
            cells[n] = row * columns + column
            begin[cells[n] + 2] += 1
    empty_rings = np.empty((rows, columns), np.int32)
    for i in range(rows):
        for j in range(columns):
            empty_rings[i, j] = 0 if begin[i * columns + j + 2] else rows + columns
    for cell in range(rows * columns):
        begin[cell + 2] += begin[cell + 1]
    for n in range(count):
        if cells[n] >= 0:
            place = begin[cells[n] + 1]
            begin[cells[n] + 1] += 1
            xs[place], ys[place], order[place] = points[n, 0], points[n, 1], n
    for i in range(rows):
        for j in range(columns):
            if i:
                for k in range(max(j - 1, 0), min(j + 2, columns)):
                    empty_rings[i, j] = min(empty_rings[i, j], empty_rings[i - 1, k] + 1)
            if j:
                empty_rings[i, j] = min(empty_rings[i, j], empty_rings[i, j - 1] + 1)
    for i in range(rows - 1, -1, -1):
        for j in range(columns - 1, -1, -1):
            if i < rows - 1:
                for k in range(max(j - 1, 0), min(j + 2, columns)):
                    empty_rings[i, j] = min(empty_rings[i, j], empty_rings[i + 1, k] + 1)
            if j < columns - 1:
                empty_rings[i, j] = min(empty_rings[i, j], empty_rings[i, j + 1] + 1)
    return empty_rings, begin, xs, ys, order


@part
def nearest_in_cells(x, y, edge, cells):  # type: ignore[no-untyped-def]
    """The first of the points nearest to the pixel (x, y), searching cells ring by ring; -1 without points."""
    empty_rings, begin, xs, ys, order = cells
    rows, columns = empty_rings.shape
    row, column = _cell(x, y, edge, rows, columns)
    best, chosen = np.inf, -1
    ring = empty_rings[row, column]
    if ring >= rows + columns:
        return -1
    while True:
        left, right = max(column - ring, 0), min(column + ring, columns - 1)
        for i in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            # Cells of a row are contiguous: all of the ring's top and bottom rows, else its two sides.
            whole = i == row - ring or i == row + ring
            for side in range(1 if whole else 2):
                if not whole and not (0 <= (column - ring if side == 0 else column + ring) < columns):
                    continue
                from_cell = i * columns + (left if whole or side == 0 else right)
                to_cell = i * columns + (right if whole or side == 1 else left)
                for n in range(begin[from_cell], begin[to_cell + 1]):
                    squared = (xs[n] - x) * (xs[n] - x) + (ys[n] - y) * (ys[n] - y)
                    if squared < best or (squared == best and order[n] < chosen):
                        best, chosen = squared, order[n]
        # Distance to the nearest cell not yet searched. A point beyond the image is even further than its cell.
        beyond = np.inf
        if column - ring > 0:
            beyond = min(beyond, x + 0.5 - (column - ring) * edge)
        if column + ring < columns - 1:
            beyond = min(beyond, (column + ring + 1) * edge - x - 0.5)
        if row - ring > 0:
            beyond = min(beyond, y + 0.5 - (row - ring) * edge)
        if row + ring < rows - 1:
            beyond = min(beyond, (row + ring + 1) * edge - y - 0.5)
        if best < beyond * beyond * (1.0 - 1e-12) or beyond == np.inf:
            return chosen
        ring += 1


@part
def nearest_in_column(marked, near):  # type: ignore[no-untyped-def]
    """Fill ``near`` [H, W] with the row of the marked pixel nearest in the same column (the upper of two), -1 without one."""
    height, width = marked.shape
    for j in range(width):
        near[0, j] = 0 if marked[0, j] else -1
    for i in range(1, height):
        for j in range(width):
            near[i, j] = i if marked[i, j] else near[i - 1, j]
    for i in range(height - 2, -1, -1):
        for j in range(width):
            below = near[i + 1, j]
            if below >= 0 and (near[i, j] < 0 or below - i < i - near[i, j]):
                near[i, j] = below


@compiled
def _compare_all(first, last, queries, data, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` [B, Q] with the index into ``data`` [B, N, 3] of the point nearest to each query."""
    xs, ys, zs = (np.empty(BLOCK, data.dtype), np.empty(BLOCK, data.dtype), np.empty(BLOCK, data.dtype))
    least, chosen = np.empty(BLOCK, data.dtype), np.empty(BLOCK, np.int32)
    for cloud in range(first, last):
        for start in range(0, queries.shape[1], BLOCK):
            size = min(BLOCK, queries.shape[1] - start)
            for k in range(size):
                xs[k], ys[k], zs[k] = queries[cloud, start + k]
                least[k], chosen[k] = np.inf, 0
            for n in range(data.shape[1]):
                x, y, z, number = data[cloud, n, 0], data[cloud, n, 1], data[cloud, n, 2], np.int32(n)
                for k in range(size):
                    squared = (xs[k] - x) ** 2 + (ys[k] - y) ** 2 + (zs[k] - z) ** 2
                    nearer = squared < least[k]
                    least[k] = squared if nearer else least[k]
                    chosen[k] = number if nearer else chosen[k]
            for k in range(size):
                out[cloud, start + k] = chosen[k]
