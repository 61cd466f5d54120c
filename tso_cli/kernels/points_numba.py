"""Loops over the points of a cloud: farthest-point sampling, interpolation between nodes."""

from __future__ import annotations

import numpy as np

from .jit import compiled


@compiled
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
