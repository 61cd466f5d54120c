"""Chamfer distance between initial clouds and their own moved copies, exact, as compiled loops on the CPU.

Initial and moved points share one order, that of a balanced k-d tree of the initial cloud with leaves of eight points; the same
tree of boxes lies over both. In each step only the boxes are refitted, in one pass. The points of a leaf search together,
outward from the same leaf of the other cloud, starting from the neighbours of the previous step; points whose neighbour the
triangle inequality proves do not search.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .jit import PrecomputedGradient, compiled, part, share
from .simd import keep_nearest

# Points that search together. Fastest from 1,000 to 100,000 points.
LEAF = 8
# Basic steps for a leaf to find its neighbours, both ways.
PER_LEAF = 4096
# Just under the true spacing, so that rounding cannot prove what is false.
SAFE = 1.0 - 1e-9
# Nodes on the stack: at most one a level.
DEPTH = 64


class StaticTrees:
    """B initial clouds [B, N, 3], of which ``counts`` [B] points exist, ready to be compared with their moved copies."""

    def __init__(self, start: Tensor, counts: Tensor) -> None:
        clouds, size, _ = start.shape
        self._counts = counts.numpy().astype(np.int64)
        leaves = 1
        while leaves * LEAF < size:
            leaves *= 2
        self._leaves, slots = leaves, leaves * LEAF
        self._order = np.tile(np.arange(slots, dtype=np.int32), (clouds, 1))
        share(clouds, 64 * clouds * size, _sort, start, self._counts, self._order)
        # In the tree's order, [B, 3, slots]; empty slots lie infinitely far away.
        self._start, self._moved = (np.full((clouds, 3, slots), np.inf) for _ in range(2))
        self._start_boxes, self._moved_boxes = (np.empty((clouds, 2 * leaves, 6)) for _ in range(2))
        share(clouds, 16 * clouds * size, _fit, start, self._counts, self._order, self._start, self._start_boxes)
        self._spacing = np.full((clouds, slots), np.inf)
        share(clouds * leaves, PER_LEAF * clouds * leaves, _space, self._counts, self._start, self._start_boxes, self._spacing)
        self._shift, self._largest_shift = np.zeros((clouds, slots)), np.zeros(clouds)
        self._to_start, self._to_moved = (np.tile(np.arange(slots, dtype=np.int32), (clouds, 1)) for _ in range(2))

    def chamfer(self, moved: Tensor) -> Tensor:
        """Both directions summed [B], squared distances, mean over points; differentiable in ``moved`` [B, N, 3]."""
        clouds, size, _ = moved.shape
        share(clouds, 16 * clouds * size, _fit, moved, self._counts, self._order, self._moved, self._moved_boxes)
        share(clouds, 8 * clouds * size, _measure, self._counts, self._start, self._moved, self._shift, self._largest_shift)
        share(clouds * self._leaves, PER_LEAF * clouds * self._leaves, _search, self._counts, self._start, self._moved,
              self._start_boxes, self._moved_boxes, self._spacing, self._shift, self._largest_shift, self._to_start,
              self._to_moved)  # fmt: skip
        total, gradient = moved.new_empty(clouds), torch.zeros_like(moved, memory_format=torch.contiguous_format)
        share(clouds, 16 * moved.numel(), _chamfer, self._counts, self._order, self._start, self._moved, self._to_start,
              self._to_moved, total, gradient)  # fmt: skip
        value: Tensor = PrecomputedGradient.apply(moved, total, gradient)
        return value


@compiled
def _sort(first, last, points, counts, order):  # type: ignore[no-untyped-def]
    """Put the points of each cloud into the order of its tree: slots are halved along the longest side of what they hold."""
    stack = np.empty((DEPTH, 2), np.int64)
    for cloud in range(first, last):
        numbers, coordinates = order[cloud], points[cloud]
        stack[0, 0], stack[0, 1] = 0, len(numbers)
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
                        low, high = min(low, coordinates[numbers[place], k]), max(high, coordinates[numbers[place], k])
                    if high - low > longest:
                        axis, longest = k, high - low
                _select(numbers, coordinates, axis, start, end - 1, middle)
            if middle - start > LEAF:
                stack[size, 0], stack[size, 1] = start, middle
                size += 1
                if middle < end:
                    stack[size, 0], stack[size, 1] = middle, stop
                    size += 1


@part
def _select(numbers, coordinates, axis, low, high, middle):  # type: ignore[no-untyped-def]
    """Quickselect from low to high: nothing before ``middle`` is larger than what comes to stand there."""
    while low < high:
        pivot = coordinates[numbers[(low + high) // 2], axis]
        i, j = low, high
        while i <= j:
            while coordinates[numbers[i], axis] < pivot:
                i += 1
            while coordinates[numbers[j], axis] > pivot:
                j -= 1
            if i <= j:
                numbers[i], numbers[j] = numbers[j], numbers[i]
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
    """Put the coordinates into the tree's order, and fit the boxes [2 L, 6] from the leaves up.

    Node k has the children 2 k and 2 k + 1, node 1 is the root; the box of a node without points is infinitely far away.
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
def _point_distance(a, i, b, j):  # type: ignore[no-untyped-def]
    """Squared distance between two points."""
    dx, dy, dz = a[0, i] - b[0, j], a[1, i] - b[1, j], a[2, i] - b[2, j]
    return dx * dx + dy * dy + dz * dz


@part
def _box_distance(a, b):  # type: ignore[no-untyped-def]
    """Squared distance between two boxes."""
    dx = max(a[0] - b[3], b[0] - a[3], 0.0)
    dy = max(a[1] - b[4], b[1] - a[4], 0.0)
    dz = max(a[2] - b[5], b[2] - a[5], 0.0)
    return dx * dx + dy * dy + dz * dz


@part
def _compare(queries, at, data, place, best, chosen, distinct):  # type: ignore[no-untyped-def]
    """Compare a leaf of queries with one of ``data``; if ``distinct``, no query with the point of its own number."""
    if not distinct or at != place:
        keep_nearest(queries, at, data, place, best, chosen)
        return
    for q in range(LEAF):
        for k in range(LEAF):
            squared = _point_distance(queries, at + q, data, place + k)
            if squared < best[q] and q != k:
                best[q], chosen[q] = squared, place + k


@part
def _largest(values):  # type: ignore[no-untyped-def]
    most = values[0]
    for q in range(1, LEAF):
        most = max(most, values[q])
    return most


@part
def _outward(leaf, queries, box, data, boxes, best, chosen, distinct, stack):  # type: ignore[no-untyped-def]
    """Put into ``chosen`` what is nearer to the queries of a leaf than the squared distances ``best``.

    The same leaf of the data comes first, then its sibling, then the sibling of both, and so on.
    """
    leaves = boxes.shape[0] // 2
    bound = _largest(best)
    if bound <= 0.0:
        return
    _compare(queries, leaf * LEAF, data, leaf * LEAF, best, chosen, distinct)
    bound = _largest(best)
    above = leaves + leaf
    while above > 1 and bound > 0.0:
        stack[0] = above ^ 1
        size = 1
        while size:
            size -= 1
            node = stack[size]
            # The bound may have shrunk since the node was put on the stack.
            if _box_distance(box, boxes[node]) >= bound:
                continue
            if node >= leaves:
                _compare(queries, leaf * LEAF, data, (node - leaves) * LEAF, best, chosen, distinct)
                bound = _largest(best)
                continue
            near = 2 * node
            if _box_distance(box, boxes[near + 1]) < _box_distance(box, boxes[near]):
                near += 1
            stack[size], stack[size + 1] = near ^ 1, near
            size += 2
        above >>= 1


@compiled
def _space(first, last, counts, start, boxes, spacing):  # type: ignore[no-untyped-def]
    """Distance from each point to the nearest of the rest of its cloud; infinite for a single point."""
    leaves = boxes.shape[1] // 2
    stack, best, chosen = np.empty(DEPTH, np.int64), np.empty(LEAF), np.empty(LEAF, np.int64)
    for task in range(first, last):
        cloud, leaf = task // leaves, task % leaves
        count = min(LEAF, counts[cloud] - leaf * LEAF)
        if count <= 0:
            continue
        for q in range(LEAF):
            best[q] = np.inf if q < count else 0.0
        points = start[cloud]
        _outward(leaf, points, boxes[cloud, leaves + leaf], points, boxes[cloud], best, chosen, True, stack)
        for q in range(count):
            spacing[cloud, leaf * LEAF + q] = np.sqrt(best[q]) * SAFE


@compiled
def _measure(first, last, counts, start, moved, shift, largest):  # type: ignore[no-untyped-def]
    """How far each point moved, squared, and the largest distance of each cloud."""
    for cloud in range(first, last):
        most = 0.0
        for n in range(counts[cloud]):
            shift[cloud, n] = _point_distance(moved[cloud], n, start[cloud], n)
            most = max(most, shift[cloud, n])
        largest[cloud] = np.sqrt(most)


@compiled
def _search(  # type: ignore[no-untyped-def]
    first, last, counts, start, moved, start_boxes, moved_boxes, spacing, shift, largest, to_start, to_moved
):
    """Update ``to_start`` and ``to_moved``, the neighbours of the previous step."""
    leaves = start_boxes.shape[1] // 2
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
            squared, chosen[q] = _point_distance(moved[cloud], at + q, start[cloud], before), before
            # |m - s_k| >= |s_j - s_k| - |m - s_j|: no s_k is nearer than s_j within half the spacing of s_j.
            best[q] = squared if 4.0 * squared >= spacing[cloud, before] ** 2 else 0.0
        box, boxes = moved_boxes[cloud, leaves + leaf], start_boxes[cloud]
        _outward(leaf, moved[cloud], box, start[cloud], boxes, best, chosen, False, stack)
        for q in range(count):
            to_start[cloud, at + q] = chosen[q]
            best[q] = 0.0
            # |s_i - m_k| >= |s_i - s_k| - |m_k - s_k|, and no point moved further than the largest shift.
            if np.sqrt(shift[cloud, at + q]) + largest[cloud] < spacing[cloud, at + q]:
                chosen[q] = at + q
            else:
                chosen[q] = to_moved[cloud, at + q]
                best[q] = _point_distance(start[cloud], at + q, moved[cloud], chosen[q])
        box, boxes = start_boxes[cloud, leaves + leaf], moved_boxes[cloud]
        _outward(leaf, start[cloud], box, moved[cloud], boxes, best, chosen, False, stack)
        for q in range(count):
            to_moved[cloud, at + q] = chosen[q]


@compiled
def _chamfer(first, last, counts, order, start, moved, to_start, to_moved, total, gradient):  # type: ignore[no-untyped-def]
    """Both directions of the Chamfer distance of each cloud, and the derivative by its moved points."""
    for cloud in range(first, last):
        mean, value = 1.0 / counts[cloud], 0.0
        for n in range(counts[cloud]):
            i, j = to_start[cloud, n], to_moved[cloud, n]
            here, there = order[cloud, n], order[cloud, j]
            for k in range(3):
                ahead, back = moved[cloud, k, n] - start[cloud, k, i], moved[cloud, k, j] - start[cloud, k, n]
                value += ahead * ahead + back * back
                gradient[cloud, here, k] += 2.0 * mean * ahead
                gradient[cloud, there, k] += 2.0 * mean * back
        total[cloud] = mean * value
