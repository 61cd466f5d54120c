"""Nearest neighbours, and evenly spread subsets, in the form that is fastest for the work.

All distances in numpy, compiled loops, or a k-d tree for many points.
"""

from __future__ import annotations

import numpy as np

from ..geometry import points as plain
from ..geometry.arrays import Array, Indices
from ..kernels.dispatch import use_compiled

# Distances that are computed at once; it bounds the memory.
PAIRS_AT_ONCE = 1 << 21
# With more pairs a k-d tree, whose import takes a quarter of a second, is faster than the matrix of
# distances, and than the compiled loops.
MOST_PAIRS, MOST_COMPILED_PAIRS = 1 << 22, 1 << 25


def nearest(queries: Array, data: Array) -> Indices:
    """[Q] index of the point of ``data`` [N, D] nearest to each of the ``queries`` [Q, D].

    All coordinates are finite. Of equally near points the first is taken.
    """
    if len(queries) * len(data) > MOST_PAIRS:
        return _by_tree(queries, data, 1)
    if use_compiled() and data.shape[1] == 3:
        from ..kernels.nearest_numba import nearest_in_rows

        return nearest_in_rows(queries[None], data[None])[0]
    return np.concatenate([squared.argmin(1) for squared in _shifted_distances(queries, data)])


def nearest_few(queries: Array, data: Array, count: int) -> Indices:
    """[Q, count] indices of the nearest points of ``data`` in order of increasing distance.

    ``count`` is a small number, at most N.
    """
    compiled = use_compiled() and data.shape[1] == 3
    if len(queries) * len(data) > (MOST_COMPILED_PAIRS if compiled else MOST_PAIRS):
        return _by_tree(queries, data, count).reshape(-1, count)
    if compiled:
        from ..kernels import points_numba

        few = np.empty((len(queries), count), np.int64)
        points_numba.nearest_few(queries, data, few)
        return few
    chosen = []
    for squared in _shifted_distances(queries, data):
        few = np.empty((len(squared), count), np.int64)
        # A few searches for the minimum take a third of the time of a partition.
        for place in range(count):
            few[:, place] = squared.argmin(1)
            squared[np.arange(len(squared)), few[:, place]] = np.inf
        chosen.append(few)
    return np.concatenate(chosen)


def _by_tree(queries: Array, data: Array, count: int) -> Indices:
    from scipy.spatial import cKDTree

    indices: Indices = cKDTree(data, balanced_tree=False, compact_nodes=False).query(
        queries, count
    )[1]
    return indices


def fast_spread_subset(points: Array, count: int) -> Indices:
    """`tso_cli.geometry.points.spread_subset` in compiled loops, if they run here."""
    sample = _farthest_points if use_compiled() else plain.farthest_point_sample
    return plain.spread_subset(points, count, sample)


def _farthest_points(points: Array, count: int) -> Indices:
    from ..kernels.points_numba import farthest_points

    chosen = np.empty(count, np.int64)
    farthest_points(points, chosen)
    return chosen


def _shifted_distances(queries: Array, data: Array):  # type: ignore[no-untyped-def]
    """Chunks [q, N] of the squared distances minus ``|query|^2``, which are in the same order.

    Each chunk is one matrix product.
    """
    # Relative to the middle of the data, so that differences of large numbers lose few digits.
    middle = data.mean(0)
    data = data - middle
    right = np.concatenate([-2.0 * data.T, np.square(data).sum(1)[None]])
    step = max(1, PAIRS_AT_ONCE // len(data))
    for start in range(0, max(len(queries), 1), step):
        part = queries[start : start + step] - middle
        yield np.concatenate([part, np.ones((len(part), 1), part.dtype)], 1) @ right
