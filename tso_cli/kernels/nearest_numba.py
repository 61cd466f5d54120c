"""Exact nearest neighbours as compiled loops on the CPU.

They serve points near pixels, mask pixels near a pixel, and batches of small clouds.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .jit import Array, compiled, part, share

# Points in a cell of the grid, on average over the image: a search then reads few cells and points.
POINTS_PER_CELL = 1.0
# Queries that are compared with a point at once. The compiler makes SIMD code of the comparison,
# and this number of queries stays in the first-level cache.
QUERIES_AT_ONCE = 256
# A search radius grows, and a bound on a squared distance shrinks, by this much, so that rounding
# loses no neighbour.
RADIUS_MARGIN, SQUARED_MARGIN = 1.0 + 1e-9, 1.0 - 1e-12


def cell_edge(height: int, width: int, count: int) -> float:
    """Edge in pixels of the cells that ``count`` points of an image are sorted into."""
    return max(1.0, math.sqrt(POINTS_PER_CELL * height * width / max(1, count)))


def nearest_in_rows(queries: Array, data: Array, threads: int = 1) -> NDArray[np.int64]:
    """[B, Q] which of the points [B, N, 3] is nearest to each query [B, Q, 3], by all pairs."""
    index = np.empty(queries.shape[:2], np.int64)
    share(
        len(queries), index.size * data.shape[1] // 8, threads, _compare_all, queries, data, index
    )
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

    Returns the rows and columns of the grid, ``begin``, and the coordinates and numbers of the
    points in sorted order. The points of cell c stand from begin[c] to begin[c + 1].
    """
    count = len(points)
    rows, columns = int(math.ceil(height / edge)), int(math.ceil(width / edge))
    # While points are sorted in, the start of cell c stands at c + 1.
    begin = np.zeros(rows * columns + 2, np.int64)
    xs, ys = np.empty(count, np.float64), np.empty(count, np.float64)
    order, cells = np.empty(count, np.int64), np.empty(count, np.int64)
    for n in range(count):
        x, y = points[n, 0], points[n, 1]
        cells[n] = -1
        # The square of a larger number would be infinite.
        if valid[n] and np.isfinite(x * x + y * y):
            row, column = _cell(x, y, edge, rows, columns)
            cells[n] = row * columns + column
            begin[cells[n] + 2] += 1
    for cell in range(rows * columns):
        begin[cell + 2] += begin[cell + 1]
    for n in range(count):
        if cells[n] >= 0:
            place = begin[cells[n] + 1]
            begin[cells[n] + 1] += 1
            xs[place], ys[place], order[place] = points[n, 0], points[n, 1], n
    return rows, columns, begin, xs, ys, order


@part
def nearest_in_cells(x, y, edge, cells, place, other):  # type: ignore[no-untyped-def]
    """Place among the sorted points of the point nearest to pixel (x, y); of equals the first.

    There is at least one point. ``place`` and ``other`` are two guesses; a near guess makes the
    search short. Pixels are visited row by row, so the results of the last pixel and of the pixel
    above are good guesses.
    """
    rows, columns, begin, xs, ys, order = cells
    best = (xs[place] - x) * (xs[place] - x) + (ys[place] - y) * (ys[place] - y)
    squared = (xs[other] - x) * (xs[other] - x) + (ys[other] - y) * (ys[other] - y)
    if squared < best:
        best, place = squared, other
    radius = math.sqrt(best) * RADIUS_MARGIN
    top, left = _cell(x - radius, y - radius, edge, rows, columns)
    bottom, right = _cell(x + radius, y + radius, edge, rows, columns)
    row, _ = _cell(x, y, edge, rows, columns)
    # The pixel's own row of cells, the rows below, then the rows above, while one can hold a nearer
    # point.
    for k in range(bottom - top + 1):
        is_below = row + k <= bottom
        i = row + k if is_below else bottom - k
        beyond = i * edge - 0.5 - y if is_below else y + 0.5 - (i + 1) * edge
        if beyond > 0.0 and beyond * beyond * SQUARED_MARGIN > best:
            continue
        for n in range(begin[i * columns + left], begin[i * columns + right + 1]):
            squared = (xs[n] - x) * (xs[n] - x) + (ys[n] - y) * (ys[n] - y)
            if squared < best or (squared == best and order[n] < order[place]):
                best, place = squared, n
    return place


@part
def nearest_in_column(marked, near):  # type: ignore[no-untyped-def]
    """Fill ``near`` [H, W] with the row of the marked pixel that is nearest in the same column.

    Of two equally near the upper one is taken; -1 stands in a column without any.
    """
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


@part
def nearest_marked(i, j, nearest_row):  # type: ignore[no-untyped-def]
    """Row and column of the marked pixel nearest to (i, j); of equals the leftmost, -1 if none.

    ``nearest_row`` is what `nearest_in_column` fills.
    """
    height, width = nearest_row.shape
    best, row, column = width * width + height * height, -1, -1
    for offset in range(width):
        # No column further out can hold a nearer pixel.
        if offset * offset > best:
            break
        for k in (j - offset, j + offset):
            if 0 <= k < width and nearest_row[i, k] >= 0:
                squared = offset * offset + (nearest_row[i, k] - i) ** 2
                if squared < best or (squared == best and k < column):
                    best, row, column = squared, nearest_row[i, k], k
    return row, column


@compiled
def _compare_all(first, last, queries, data, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` [B, Q] with the index into ``data`` [B, N, 3] of each query's nearest point."""
    size, kind = QUERIES_AT_ONCE, data.dtype
    xs, ys, zs = np.empty(size, kind), np.empty(size, kind), np.empty(size, kind)
    least, chosen = np.empty(size, kind), np.empty(size, np.int32)
    for cloud in range(first, last):
        for start in range(0, queries.shape[1], QUERIES_AT_ONCE):
            size = min(QUERIES_AT_ONCE, queries.shape[1] - start)
            for k in range(size):
                xs[k], ys[k], zs[k] = queries[cloud, start + k]
                least[k], chosen[k] = np.inf, 0
            for n in range(data.shape[1]):
                x, y, z = data[cloud, n, 0], data[cloud, n, 1], data[cloud, n, 2]
                number = np.int32(n)
                for k in range(size):
                    squared = (xs[k] - x) ** 2 + (ys[k] - y) ** 2 + (zs[k] - z) ** 2
                    nearer = squared < least[k]
                    least[k] = squared if nearer else least[k]
                    chosen[k] = number if nearer else chosen[k]
            for k in range(size):
                out[cloud, start + k] = chosen[k]
