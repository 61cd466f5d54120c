"""Nearest neighbours by the matrix of distances: for some thousand points, without a tree and its import."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Indices = NDArray[np.int64]

# Distances computed at once; bounds memory.
PAIRS_AT_ONCE = 1 << 21


def nearest(queries: Array, data: Array) -> Indices:
    """[Q] index of the point of ``data`` [N, D] nearest to each of the ``queries`` [Q, D], finite all; the first of equals."""
    return np.concatenate([squared.argmin(1) for squared in _shifted_distances(queries, data)])


def nearest_few(queries: Array, data: Array, count: int) -> Indices:
    """[Q, count] indices of the nearest points of ``data``, by increasing distance."""
    chosen = []
    for squared in _shifted_distances(queries, data):
        few = np.arange(len(data))[None].repeat(len(squared), 0)
        if count < len(data):
            few = np.argpartition(squared, count - 1, 1)[:, :count]
        order = np.argsort(np.take_along_axis(squared, few, 1), 1, kind="stable")
        chosen.append(np.take_along_axis(few, order, 1))
    return np.concatenate(chosen)


def _shifted_distances(queries: Array, data: Array):  # type: ignore[no-untyped-def]
    """Chunks [q, N] of the squared distances minus ``|query|^2``: one matrix product, of the same order."""
    # About the middle of the data, where the difference of two large numbers loses fewest digits.
    middle = data.mean(0)
    data = data - middle
    right = np.concatenate([-2.0 * data.T, np.square(data).sum(1)[None]])
    step = max(1, PAIRS_AT_ONCE // len(data))
    for start in range(0, max(len(queries), 1), step):
        part = queries[start : start + step] - middle
        yield np.concatenate([part, np.ones((len(part), 1), part.dtype)], 1) @ right
