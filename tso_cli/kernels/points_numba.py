"""Loops over the points of a cloud: farthest-point sampling, neighbours, interpolation between nodes."""

from __future__ import annotations

import numpy as np

from .jit import compiled, exactly


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
    best = np.empty(count)
    for q in range(len(queries)):
        best[:] = np.inf
        x, y, z = queries[q]
        for n in range(len(data)):
            dx, dy, dz = data[n, 0] - x, data[n, 1] - y, data[n, 2] - z
            squared = dx * dx + dy * dy + dz * dz
            if squared < best[count - 1]:
                place = count - 1
                while place > 0 and squared < best[place - 1]:
                    best[place], chosen[q, place] = best[place - 1], chosen[q, place - 1]
                    place -= 1
                best[place], chosen[q, place] = squared, n


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
