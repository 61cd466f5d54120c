"""Chamfer distance between clouds that stay and their own moved copies, exact, as compiled loops on the CPU.

Start and copy of a cloud are kept in one order, that of a balanced k-d tree of the start, in leaves of eight points; over
both lies the same tree of boxes. While points move only the boxes are made anew, in one pass. The points of a leaf search
together, outward from the same leaf of the other cloud, beginning with the neighbours of the step before; those for which
the triangle inequality proves the neighbour do not search at all.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .jit import compiled, part, share
from .losses_numba import WithSlope
from .simd import keep_nearest

# Points that search together. Fastest from 1,000 to 100,000 points.
LEAF = 8
# Basic steps for a leaf to find its neighbours, both ways.
PER_LEAF = 4096
# A hair less than the true spacing, so that rounding cannot prove what is not so.
SAFE = 1.0 - 1e-9
# Nodes put aside at once: at most one a level.
DEPTH = 64


class StaticTrees:
    """B clouds that stay, ready to be compared with their moved copies.

    Parameters
    ----------
    start : [B, N, 3] float32 or float64.
    counts : [B], how many points of each row are there; None for all. What lies behind them is not looked at.
    """

    def __init__(self, start: Tensor, counts: Tensor | None = None) -> None:
        clouds, size, _ = start.shape
        self.counts = np.full(clouds, size) if counts is None else counts.numpy().astype(np.int64)
        leaves = 1
        while leaves * LEAF < size:
            leaves *= 2
        self._leaves, slots = leaves, leaves * LEAF
        self._order = np.tile(np.arange(slots, dtype=np.int32), (clouds, 1))
        share(clouds, 64 * clouds * size, _sort, start, self.counts, self._order)
        # In the tree's order, [B, 3, slots]; what is no point lies infinitely far away.
        self._start, self._moved = (np.full((clouds, 3, slots), np.inf) for _ in range(2))
        self._still, self._moving = (np.empty((clouds, 2 * leaves, 6)) for _ in range(2))
        share(clouds, 16 * clouds * size, _fit, start, self.counts, self._order, self._start, self._still)
        self._spacing = np.full((clouds, slots), np.inf)
        share(clouds * leaves, PER_LEAF * clouds * leaves, _space, self.counts, self._start, self._still, self._spacing)
        self._own, self._furthest = np.zeros((clouds, slots)), np.zeros(clouds)
        self._to_start, self._to_moved = (np.tile(np.arange(slots, dtype=np.int32), (clouds, 1)) for _ in range(2))

    def nearest(self, moved: Tensor) -> tuple[Tensor, Tensor]:
        """Index of the nearest moved point for each start [B, N], and of the nearest start for each moved point [B, N]."""
        self._search(moved)
        to_moved, to_start = (torch.full(moved.shape[:2], -1, dtype=torch.int64) for _ in range(2))
        for found, out in ((self._to_moved, to_moved), (self._to_start, to_start)):
            share(len(found), 4 * found.size, _unsort, self.counts, self._order, found, out)
        return to_moved, to_start

    def chamfer(self, moved: Tensor) -> Tensor:
        """Both directions summed [B], squared distances, mean over points; differentiable in ``moved`` [B, N, 3]."""
        self._search(moved)
        total, slope = moved.new_empty(len(moved)), torch.zeros_like(moved, memory_format=torch.contiguous_format)
        share(len(moved), 16 * moved.numel(), _chamfer, self.counts, self._order, self._start, self._moved, self._to_start,
              self._to_moved, total, slope)  # fmt: skip
        value: Tensor = WithSlope.apply(moved, total, slope)
        return value

    def _search(self, moved: Tensor) -> None:
        clouds, size, _ = moved.shape
        share(clouds, 16 * clouds * size, _fit, moved, self.counts, self._order, self._moved, self._moving)
        share(clouds, 8 * clouds * size, _measure, self.counts, self._start, self._moved, self._own, self._furthest)
        share(clouds * self._leaves, PER_LEAF * clouds * self._leaves, _search, self.counts, self._start, self._moved,
              self._still, self._moving, self._spacing, self._own, self._furthest, self._to_start, self._to_moved)  # fmt: skip


@compiled
def _sort(first, last, points, counts, order):  # type: ignore[no-untyped-def]
    """Put the points of each cloud into the order of its tree: slots are halved along the longest side of what they hold."""
    stack = np.empty((DEPTH, 2), np.int64)
    for cloud in range(first, last):
        own, coordinates = order[cloud], points[cloud]
        stack[0, 0], stack[0, 1] = 0, len(own)
        size = 1
        while size:
            size -= 1
            start, stop = stack[size, 0], stack[size, 1]
            middle, end = (start + stop) // 2, min(stop, counts[cloud])
            if end > middle:
                axis, longest = 0, -1.0
                for k in range(3):
                    low, high = np.inf, -np.inf
                    for place in range(start, end):
                        low, high = min(low, coordinates[own[place], k]), max(high, coordinates[own[place], k])
                    if high - low > longest:
                        axis, longest = k, high - low
                _select(own, coordinates, axis, start, end - 1, middle)
            if middle - start > LEAF:
                stack[size, 0], stack[size, 1] = start, middle
                size += 1
                if middle < end:
                    stack[size, 0], stack[size, 1] = middle, stop
                    size += 1


@part
def _select(own, coordinates, axis, low, high, middle):  # type: ignore[no-untyped-def]
    """Reorder ``own`` from low to high: nothing above what comes to stand at ``middle`` stays before it."""
    while low < high:
        pivot = coordinates[own[(low + high) // 2], axis]
        i, j = low, high
        while i <= j:
            while coordinates[own[i], axis] < pivot:
                i += 1
            while coordinates[own[j], axis] > pivot:
                j -= 1
            if i <= j:
                own[i], own[j] = own[j], own[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@compiled
def _fit(first, last, points, counts, order, ordered, boxes):  # type: ignore[no-untyped-def]
    """Put the coordinates into the tree's order, and make the boxes [2 L, 6] from the last level up.

    Node k has the children 2 k and 2 k + 1, node 1 holds all; a node without points is a box that nothing comes near.
    """
    leaves = boxes.shape[1] // 2
    for cloud in range(first, last):
        for leaf in range(leaves):
            box = boxes[cloud, leaves + leaf]
            for k in range(3):
                box[k], box[k + 3] = np.inf, -np.inf
            for place in range(leaf * LEAF, min((leaf + 1) * LEAF, counts[cloud])):
                for k in range(3):
                    value = float(points[cloud, order[cloud, place], k])
                    ordered[cloud, k, place] = value
                    box[k], box[k + 3] = min(box[k], value), max(box[k + 3], value)
        for node in range(leaves - 1, 0, -1):
            for k in range(3):
                boxes[cloud, node, k] = min(boxes[cloud, 2 * node, k], boxes[cloud, 2 * node + 1, k])
                boxes[cloud, node, k + 3] = max(boxes[cloud, 2 * node, k + 3], boxes[cloud, 2 * node + 1, k + 3])


@part
def _between(one, i, other, j):  # type: ignore[no-untyped-def]
    """Squared distance between two points."""
    dx, dy, dz = one[0, i] - other[0, j], one[1, i] - other[1, j], one[2, i] - other[2, j]
    return dx * dx + dy * dy + dz * dz


@part
def _apart(one, other):  # type: ignore[no-untyped-def]
    """Squared distance between two boxes."""
    dx = max(one[0] - other[3], other[0] - one[3], 0.0)
    dy = max(one[1] - other[4], other[1] - one[4], 0.0)
    dz = max(one[2] - other[5], other[2] - one[5], 0.0)
    return dx * dx + dy * dy + dz * dz


@part
def _compare(queries, at, data, place, best, chosen, alone):  # type: ignore[no-untyped-def]
    """Hold a leaf of ``data`` against a leaf of queries; no query against its own number if they are to be ``alone``."""
    if not alone or at != place:
        keep_nearest(queries, at, data, place, best, chosen)
        return
    for q in range(LEAF):
        for k in range(LEAF):
            squared = _between(queries, at + q, data, place + k)
            if squared < best[q] and q != k:
                best[q], chosen[q] = squared, place + k


@part
def _largest(values):  # type: ignore[no-untyped-def]
    most = values[0]
    for q in range(1, LEAF):
        most = max(most, values[q])
    return most


@part
def _outward(leaf, queries, box, data, boxes, best, chosen, alone, stack):  # type: ignore[no-untyped-def]
    """Find what is nearer to the queries of a leaf than the squared distances ``best``, and put it into ``chosen``.

    The same leaf of the data comes first, then its sibling, then the sibling of both, and so on.
    """
    leaves = boxes.shape[0] // 2
    bound = _largest(best)
    if bound <= 0.0:
        return
    _compare(queries, leaf * LEAF, data, leaf * LEAF, best, chosen, alone)
    bound = _largest(best)
    above = leaves + leaf
    while above > 1 and bound > 0.0:
        stack[0] = above ^ 1
        size = 1
        while size:
            size -= 1
            node = stack[size]
            # What was put aside may lie too far by the time it is taken up.
            if _apart(box, boxes[node]) >= bound:
                continue
            if node >= leaves:
                _compare(queries, leaf * LEAF, data, (node - leaves) * LEAF, best, chosen, alone)
                bound = _largest(best)
                continue
            near = 2 * node
            if _apart(box, boxes[near + 1]) < _apart(box, boxes[near]):
                near += 1
            stack[size], stack[size + 1] = near ^ 1, near
            size += 2
        above >>= 1


@compiled
def _space(first, last, counts, start, boxes, spacing):  # type: ignore[no-untyped-def]
    """Distance from each point to the nearest other of its cloud; infinite where there is no other."""
    leaves = boxes.shape[1] // 2
    stack, best, chosen = np.empty(DEPTH, np.int64), np.empty(LEAF), np.empty(LEAF, np.int64)
    for task in range(first, last):
        cloud, leaf = task // leaves, task % leaves
        count = min(LEAF, counts[cloud] - leaf * LEAF)
        if count <= 0:
            continue
        for q in range(LEAF):
            best[q] = np.inf if q < count else 0.0
        own = start[cloud]
        _outward(leaf, own, boxes[cloud, leaves + leaf], own, boxes[cloud], best, chosen, True, stack)
        for q in range(count):
            spacing[cloud, leaf * LEAF + q] = np.sqrt(best[q]) * SAFE


@compiled
def _measure(first, last, counts, start, moved, own, furthest):  # type: ignore[no-untyped-def]
    """How far each point moved, squared, and the furthest of each cloud."""
    for cloud in range(first, last):
        most = 0.0
        for n in range(counts[cloud]):
            own[cloud, n] = _between(moved[cloud], n, start[cloud], n)
            most = max(most, own[cloud, n])
        furthest[cloud] = np.sqrt(most)


@compiled
def _search(first, last, counts, start, moved, still, moving, spacing, own, furthest, to_start, to_moved):  # type: ignore[no-untyped-def]
    """Bring ``to_start`` and ``to_moved``, the neighbours of the step before, up to date."""
    leaves = still.shape[1] // 2
    stack, best, chosen = np.empty(DEPTH, np.int64), np.empty(LEAF), np.empty(LEAF, np.int64)
    for task in range(first, last):
        cloud, leaf = task // leaves, task % leaves
        at = leaf * LEAF
        count = min(LEAF, counts[cloud] - at)
        if count <= 0:
            continue
        best[:] = 0.0
        for q in range(count):
            before = to_start[cloud, at + q]
            squared, chosen[q] = _between(moved[cloud], at + q, start[cloud], before), before
            # |m - s_k| >= |s_j - s_k| - |m - s_j|: no s_k is nearer than s_j within half the spacing of s_j.
            best[q] = squared if 4.0 * squared >= spacing[cloud, before] ** 2 else 0.0
        _outward(leaf, moved[cloud], moving[cloud, leaves + leaf], start[cloud], still[cloud], best, chosen, False, stack)
        for q in range(count):
            to_start[cloud, at + q] = chosen[q]
            best[q] = 0.0
            # |s_i - m_k| >= |s_i - s_k| - |m_k - s_k|, and no point moved further than the furthest.
            if np.sqrt(own[cloud, at + q]) + furthest[cloud] < spacing[cloud, at + q]:
                chosen[q] = at + q
            else:
                chosen[q] = to_moved[cloud, at + q]
                best[q] = _between(start[cloud], at + q, moved[cloud], chosen[q])
        _outward(leaf, start[cloud], still[cloud, leaves + leaf], moved[cloud], moving[cloud], best, chosen, False, stack)
        for q in range(count):
            to_moved[cloud, at + q] = chosen[q]


@compiled
def _unsort(first, last, counts, order, found, out):  # type: ignore[no-untyped-def]
    """From places in the tree's order to places in the cloud."""
    for cloud in range(first, last):
        for n in range(counts[cloud]):
            out[cloud, order[cloud, n]] = order[cloud, found[cloud, n]]


@compiled
def _chamfer(first, last, counts, order, start, moved, to_start, to_moved, total, slope):  # type: ignore[no-untyped-def]
    """Both directions of the Chamfer distance of each cloud, and the derivative by its moved points."""
    for cloud in range(first, last):
        share, value = 1.0 / counts[cloud], 0.0
        for n in range(counts[cloud]):
            i, j = to_start[cloud, n], to_moved[cloud, n]
            here, there = order[cloud, n], order[cloud, j]
            for k in range(3):
                ahead, back = moved[cloud, k, n] - start[cloud, k, i], moved[cloud, k, j] - start[cloud, k, n]
                value += ahead * ahead + back * back
                slope[cloud, here, k] += 2.0 * share * ahead
                slope[cloud, there, k] += 2.0 * share * back
        total[cloud] = share * value
