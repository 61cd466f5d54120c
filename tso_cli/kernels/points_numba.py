"""Loops over the points of a cloud: farthest-point sampling, neighbours, interpolation between nodes."""

from __future__ import annotations

import numpy as np

from .jit import compiled, exactly, part


@exactly
def farthest_points(points, chosen):  # type: ignore[no-untyped-def]
    """Fill ``chosen`` [count] as `tso_cli.geometry.points.farthest_point_sample` does, of ``points`` [N, 3]."""
    count = len(points)
    nearest = np.full(count, np.inf)
    index = 0
    for i in range(len(chosen)):
        chosen[i] = index
        x, y, z = points[index]
        farthest, following = -2.0, 0
        # Below every distance: where points coincide, no index is chosen again.
        nearest[index] = -1.0
        for n in range(count):
            dx, dy, dz = points[n, 0] - x, points[n, 1] - y, points[n, 2] - z
            nearest[n] = min(nearest[n], dx * dx + dy * dy + dz * dz)
            if nearest[n] > farthest:
                farthest, following = nearest[n], n
        index = following


@compiled
def nearest_few(queries, data, chosen):  # type: ignore[no-untyped-def]
    """Fill ``chosen`` [Q, k] with the points of ``data`` [N, 3] nearest to each query [Q, 3], by increasing distance."""
    count = chosen.shape[1]
    xs, ys, zs = data[:, 0].copy(), data[:, 1].copy(), data[:, 2].copy()
    squared, best = np.empty(len(data)), np.empty(count)
    for q in range(len(queries)):
        best[:] = np.inf
        x, y, z = queries[q]
        # In a loop of its own, so that it becomes SIMD code.
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
    """Index of the cell, along one axis, that holds ``x``; the outermost cells hold what lies beyond."""
    return int(min(max((x - low) * per_unit, 0.0), side - 1.0))


@compiled
def sort_into_grid(points, low, per_unit, sides):  # type: ignore[no-untyped-def]
    """Sort finite points [N, 3] into cells: ``per_unit`` on a unit of length, ``sides`` [3] in all, from ``low`` [3] on.

    Returns ``begin``, the points of cell c being those from begin[c] to begin[c + 1]; and their numbers and coordinates.
    """
    width, cells = sides[0], np.empty(len(points), np.int32)
    # While points are sorted in, the start of cell c stands at c + 1.
    begin = np.zeros(sides[0] * sides[1] * sides[2] + 2, np.int32)
    order, coordinates = np.empty(len(points), np.int32), np.empty((len(points), 3))
    for n in range(len(points)):
        cells[n] = -1
        if np.isfinite(points[n, 0] + points[n, 1] + points[n, 2]):
            row = _cell(points[n, 2], low[2], per_unit, sides[2]) * sides[1] + _cell(
                points[n, 1], low[1], per_unit, sides[1]
            )
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
    """Make ``chosen`` [Q] the points of ``data`` [N, 3], sorted into ``grid``, that are nearest to each query [Q, 3].

    A query looks into the cells which can hold a point nearer than the one in ``chosen`` before: the better that guess, the
    sooner it is done.
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
        radius = np.sqrt(best) * (1.0 + 1e-9)
        left, right = (
            _cell(x - radius, low[0], per_unit, width),
            _cell(x + radius, low[0], per_unit, width),
        )
        bottom, top = (
            _cell(y - radius, low[1], per_unit, sides[1]),
            _cell(y + radius, low[1], per_unit, sides[1]),
        )
        front, back = (
            _cell(z - radius, low[2], per_unit, sides[2]),
            _cell(z + radius, low[2], per_unit, sides[2]),
        )
        for k in range(front, back + 1):
            for j in range(bottom, top + 1):
                row = (k * sides[1] + j) * width
                for place in range(begin[row + left], begin[row + right + 1]):
                    dx, dy, dz = (
                        coordinates[place, 0] - x,
                        coordinates[place, 1] - y,
                        coordinates[place, 2] - z,
                    )
                    squared = dx * dx + dy * dy + dz * dz
                    if squared < best:
                        best, nearest = squared, order[place]
        chosen[q] = nearest


@compiled
def chamfer(start, moved, to_start, to_moved, gradient):  # type: ignore[no-untyped-def]
    """The Chamfer distance of two clouds [N, 3] by their nearest neighbours; fills its ``gradient`` [N, 3] by ``moved``."""
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


@compiled
def spread(index, weight, values, out):  # type: ignore[no-untyped-def]
    """``out`` [N, C] as the weighted sums of the rows ``index`` [N, k] of ``values`` [M, C]."""
    out[:] = 0.0
    for n in range(len(index)):
        for k in range(index.shape[1]):
            for c in range(values.shape[1]):
                out[n, c] += weight[n, k] * values[index[n, k], c]


@compiled
def gather(index, weight, values, out):  # type: ignore[no-untyped-def]
    """``out`` [M, C] from ``values`` [N, C]: the transpose of `spread`."""
    out[:] = 0.0
    for n in range(len(index)):
        for k in range(index.shape[1]):
            for c in range(values.shape[1]):
                out[index[n, k], c] += weight[n, k] * values[n, c]
