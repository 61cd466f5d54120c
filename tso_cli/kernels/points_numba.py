"""Compiled loops over the points of a cloud.

Farthest-point sampling, nearest neighbours, the Chamfer distance.
"""

from __future__ import annotations

import numpy as np

from .jit import compiled, exactly, part
from .nearest_numba import RADIUS_MARGIN


@exactly
def farthest_points(points, chosen):  # type: ignore[no-untyped-def]
    """Fill ``chosen`` [count] with the indices of points spread over ``points`` [N, 3].

    The result is the same as from `tso_cli.geometry.points.farthest_point_sample`.
    """
    count = len(points)
    nearest = np.full(count, np.inf)
    index = 0
    for i in range(len(chosen)):
        chosen[i] = index
        x, y, z = points[index]
        farthest, following = -2.0, 0
        # Less than every distance, so that no index is chosen twice where points coincide.
        nearest[index] = -1.0
        for n in range(count):
            dx, dy, dz = points[n, 0] - x, points[n, 1] - y, points[n, 2] - z
            nearest[n] = min(nearest[n], dx * dx + dy * dy + dz * dz)
            if nearest[n] > farthest:
                farthest, following = nearest[n], n
        index = following


@compiled
def nearest_few(queries, data, chosen):  # type: ignore[no-untyped-def]
    """Fill ``chosen`` [Q, k] with the points of ``data`` [N, 3] nearest to each query [Q, 3].

    They are in order of increasing distance.
    """
    count = chosen.shape[1]
    xs, ys, zs = data[:, 0].copy(), data[:, 1].copy(), data[:, 2].copy()
    squared, best = np.empty(len(data)), np.empty(count)
    for q in range(len(queries)):
        best[:] = np.inf
        x, y, z = queries[q]
        # A loop of its own, so that the compiler makes SIMD code of it.
        for n in range(len(data)):
            squared[n] = (
                (xs[n] - x) * (xs[n] - x) + (ys[n] - y) * (ys[n] - y) + (zs[n] - z) * (zs[n] - z)
            )
        for n in range(len(data)):
            if squared[n] < best[count - 1]:
                place = count - 1
                while place > 0 and squared[n] < best[place - 1]:
                    best[place], chosen[q, place] = best[place - 1], chosen[q, place - 1]
                    place -= 1
                best[place], chosen[q, place] = squared[n], n


@part
def _cell(x, low, per_unit, side):  # type: ignore[no-untyped-def]
    """Index, along one axis, of the cell of ``x``; the outermost cells hold all beyond them."""
    return int(min(max((x - low) * per_unit, 0.0), side - 1.0))


@compiled
def sort_into_grid(points, low, per_unit, sides):  # type: ignore[no-untyped-def]
    """Sort the finite ones of ``points`` [N, 3] into a grid of ``sides`` [3] cells.

    The grid begins at ``low`` [3] and has ``per_unit`` cells in a unit of length. Returns
    ``begin``, and the numbers and coordinates of the points in sorted order. The points of cell c
    stand from begin[c] to begin[c + 1].
    """
    width, cells = sides[0], np.empty(len(points), np.int32)
    # While points are sorted in, the start of cell c stands at c + 1.
    begin = np.zeros(sides[0] * sides[1] * sides[2] + 2, np.int32)
    order, coordinates = np.empty(len(points), np.int32), np.empty((len(points), 3))
    for n in range(len(points)):
        cells[n] = -1
        if np.isfinite(points[n, 0] + points[n, 1] + points[n, 2]):
            layer = _cell(points[n, 2], low[2], per_unit, sides[2])
            row = layer * sides[1] + _cell(points[n, 1], low[1], per_unit, sides[1])
            cells[n] = row * width + _cell(points[n, 0], low[0], per_unit, width)
            begin[cells[n] + 2] += 1
    for cell in range(len(begin) - 2):
        begin[cell + 2] += begin[cell + 1]
    for n in range(len(points)):
        if cells[n] >= 0:
            place = begin[cells[n] + 1]
            begin[cells[n] + 1] += 1
            order[place] = n
            for c in range(3):
                coordinates[place, c] = points[n, c]
    return begin, order, coordinates


@compiled
def nearest_in_grid(queries, data, grid, low, per_unit, sides, chosen):  # type: ignore[no-untyped-def]
    """Fill ``chosen`` [Q] with the point of ``data`` [N, 3] that is nearest to each query [Q, 3].

    ``grid`` holds the points of ``data`` as `sort_into_grid` returns them. Before the call
    ``chosen`` holds a guess for each query; a near guess leaves few cells to search.
    """
    begin, order, coordinates = grid
    width = sides[0]
    for q in range(len(queries)):
        x, y, z = queries[q, 0], queries[q, 1], queries[q, 2]
        nearest = chosen[q]
        best = (
            (data[nearest, 0] - x) ** 2 + (data[nearest, 1] - y) ** 2 + (data[nearest, 2] - z) ** 2
        )
        if not best < np.inf:
            continue
        radius = np.sqrt(best) * RADIUS_MARGIN
        left = _cell(x - radius, low[0], per_unit, width)
        right = _cell(x + radius, low[0], per_unit, width)
        bottom = _cell(y - radius, low[1], per_unit, sides[1])
        top = _cell(y + radius, low[1], per_unit, sides[1])
        front = _cell(z - radius, low[2], per_unit, sides[2])
        back = _cell(z + radius, low[2], per_unit, sides[2])
        for k in range(front, back + 1):
            for j in range(bottom, top + 1):
                row = (k * sides[1] + j) * width
                for place in range(begin[row + left], begin[row + right + 1]):
                    dx = coordinates[place, 0] - x
                    dy = coordinates[place, 1] - y
                    dz = coordinates[place, 2] - z
                    squared = dx * dx + dy * dy + dz * dz
                    if squared < best:
                        best, nearest = squared, order[place]
        chosen[q] = nearest


@compiled
def chamfer(start, moved, to_start, to_moved, gradient):  # type: ignore[no-untyped-def]
    """The Chamfer distance between the clouds ``start`` and ``moved`` [N, 3], squared, both ways.

    ``to_start`` and ``to_moved`` [N] are the nearest neighbours. Fills ``gradient`` [N, 3] with the
    gradient by ``moved``.
    """
    total, scale = 0.0, 2.0 / len(start)
    for n in range(len(start)):
        for c in range(3):
            ahead = moved[n, c] - start[to_start[n], c]
            total += ahead * ahead
            gradient[n, c] = scale * ahead
    for n in range(len(start)):
        for c in range(3):
            back = moved[to_moved[n], c] - start[n, c]
            total += back * back
            gradient[to_moved[n], c] += scale * back
    return total / len(start)
