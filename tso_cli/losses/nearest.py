"""Nearest neighbours: all distances, or a k-d tree for many points."""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array, Indices

# Distances that are computed at once; it bounds the memory.
PAIRS_AT_ONCE = 1 << 21
# With more pairs a k-d tree, whose import takes a quarter of a second, is faster than the matrix of
# distances.
MOST_PAIRS = 1 << 22


def nearest(queries: Array, data: Array) -> Indices:
    """[Q] index of the point of ``data`` [N, D] nearest to each of the ``queries`` [Q, D].

    All coordinates are finite. Of equally near points the first is taken.
    """
    if len(queries) * len(data) > MOST_PAIRS:
        return _by_tree(queries, data, 1)
    return np.concatenate([squared.argmin(1) for squared in _shifted_distances(queries, data)])


def nearest_few(queries: Array, data: Array, count: int) -> Indices:
    """[Q, count] indices of the nearest points of ``data`` in order of increasing distance.

    ``count`` is a small number, at most N.
    """
    if len(queries) * len(data) > MOST_PAIRS:
        return _by_tree(queries, data, count).reshape(-1, count)
    blocks = []
    for squared in _shifted_distances(queries, data):
        few = np.empty((len(squared), count), np.int64)
        # A few searches for the minimum take a third of the time of a partition.
        for place in range(count):
            few[:, place] = squared.argmin(1)
            squared[np.arange(len(squared)), few[:, place]] = np.inf
        blocks.append(few)
    return np.concatenate(blocks)


def _by_tree(queries: Array, data: Array, count: int) -> Indices:
    from scipy.spatial import cKDTree

    indices: Indices = cKDTree(data, balanced_tree=False, compact_nodes=False).query(
        queries, count
    )[1]
    return indices


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
