"""Chamfer distance between initial clouds and their own moved copies, exact, as compiled loops on the CPU.

Initial and moved points share one order, that of a balanced k-d tree of the initial cloud with leaves of eight points; the same
tree of boxes lies over both. In each step only the boxes are refitted, in one pass. The points of a leaf search together,
outward from the same leaf of the other cloud, starting from the neighbours of the previous step; points whose neighbour the
triangle inequality proves do not search.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .jit import compiled, part
from .simd import keep_nearest

# Points that search together. Fastest from 1,000 to 100,000 points.
LEAF = 8
# Just under the true spacing, so that rounding cannot prove what is false.
SAFE = 1.0 - 1e-9
# Nodes on the stack: at most one a level.
DEPTH = 64


class StaticTree:
    """A cloud [N, 3], ready to be compared with moved copies of it."""

    def __init__(self, start: NDArray[np.float64]) -> None:
        leaves = 1
        while leaves * LEAF < len(start):
            leaves *= 2
        slots = leaves * LEAF
        self._count = len(start)
        self._order = np.arange(slots)
        _sort(start, self._order)
        # In the tree's order, [3, slots]; empty slots lie infinitely far away.
        self._start, self._moved = (np.full((3, slots), np.inf) for _ in range(2))
        self._start_boxes, self._moved_boxes = (np.empty((2 * leaves, 6)) for _ in range(2))
        _fit(start, self._order, self._start, self._start_boxes)
        self._spacing = np.full(slots, np.inf)
        _space(len(start), self._start, self._start_boxes, self._spacing)
        self._shift = np.zeros(slots)
        self._to_start, self._to_moved = np.arange(slots), np.arange(slots)

    def chamfer(self, moved: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Both directions summed, squared distances, mean over points; and the gradient by ``moved`` [N, 3]."""
        _fit(moved, self._order, self._moved, self._moved_boxes)
        largest = _measure(self._count, self._start, self._moved, self._shift)
        _search(self._count, self._start, self._moved, self._start_boxes, self._moved_boxes, self._spacing, self._shift,
                largest, self._to_start, self._to_moved)  # fmt: skip
        gradient = np.zeros_like(moved)
        value: float = _chamfer(self._order, self._start, self._moved, self._to_start, self._to_moved, gradient)
        return value, gradient


@compiled
def _sort(points, order):  # type: ignore[no-untyped-def]
    """Put the numbers of the points into the order of their tree: slots are halved along the longest side of what they hold."""
    stack = np.empty((DEPTH, 2), np.int64)
    stack[0, 0], stack[0, 1] = 0, len(order)
    size = 1
    while size:
        size -= 1
        start, stop = stack[size, 0], stack[size, 1]
        middle, end = (start + stop) // 2, min(stop, len(points))
        if end > middle:
            axis, longest = 0, -1.0
            for k in range(3):
                low, high = np.inf, -np.inf
                for place in range(start, end):
                    low, high = min(low, points[order[place], k]), max(high, points[order[place], k])
                if high - low > longest:
                    axis, longest = k, high - low
            _select(order, points, axis, start, end - 1, middle)
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
def _fit(points, order, ordered, boxes):  # type: ignore[no-untyped-def]
    """Put the coordinates into the tree's order, and fit the boxes [2 L, 6] from the leaves up.

    Node k has the children 2 k and 2 k + 1, node 1 is the root; the box of a node without points is infinitely far away.
    """
    leaves = len(boxes) // 2
    for leaf in range(leaves):
        box = boxes[leaves + leaf]
        for k in range(3):
            box[k], box[k + 3] = np.inf, -np.inf
        for place in range(leaf * LEAF, min((leaf + 1) * LEAF, len(points))):
            for k in range(3):
                value = points[order[place], k]
                ordered[k, place] = value
                box[k], box[k + 3] = min(box[k], value), max(box[k + 3], value)
    for node in range(leaves - 1, 0, -1):
        for k in range(3):
            boxes[node, k] = min(boxes[2 * node, k], boxes[2 * node + 1, k])
            boxes[node, k + 3] = max(boxes[2 * node, k + 3], boxes[2 * node + 1, k + 3])


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
def _space(points, start, boxes, spacing):  # type: ignore[no-untyped-def]
    """Distance from each point to the nearest of the rest of its cloud; infinite for a single point."""
    leaves = len(boxes) // 2
    stack, best, chosen = np.empty(DEPTH, np.int64), np.empty(LEAF), np.empty(LEAF, np.int64)
    for leaf in range(leaves):
        count = min(LEAF, points - leaf * LEAF)
        if count <= 0:
            break
        for q in range(LEAF):
            best[q] = np.inf if q < count else 0.0
        _outward(leaf, start, boxes[leaves + leaf], start, boxes, best, chosen, True, stack)
        for q in range(count):
            spacing[leaf * LEAF + q] = np.sqrt(best[q]) * SAFE


@compiled
def _measure(points, start, moved, shift):  # type: ignore[no-untyped-def]
    """How far each point moved, squared; returns the largest distance."""
    most = 0.0
    for n in range(points):
        shift[n] = _point_distance(moved, n, start, n)
        most = max(most, shift[n])
    return np.sqrt(most)


@compiled
def _search(  # type: ignore[no-untyped-def]
    points, start, moved, start_boxes, moved_boxes, spacing, shift, largest, to_start, to_moved
):
    """Update ``to_start`` and ``to_moved``, the neighbours of the previous step."""
    leaves = len(start_boxes) // 2
    stack, best, chosen = np.empty(DEPTH, np.int64), np.empty(LEAF), np.empty(LEAF, np.int64)
    for leaf in range(leaves):
        at = leaf * LEAF
        count = min(LEAF, points - at)
        if count <= 0:
            break
        best[:] = 0.0
        for q in range(count):
            before = to_start[at + q]
            squared, chosen[q] = _point_distance(moved, at + q, start, before), before
            # |m - s_k| >= |s_j - s_k| - |m - s_j|: no s_k is nearer than s_j within half the spacing of s_j.
            best[q] = squared if 4.0 * squared >= spacing[before] ** 2 else 0.0
        _outward(leaf, moved, moved_boxes[leaves + leaf], start, start_boxes, best, chosen, False, stack)
        for q in range(count):
            to_start[at + q] = chosen[q]
            best[q] = 0.0
            # |s_i - m_k| >= |s_i - s_k| - |m_k - s_k|, and no point moved further than the largest shift.
            if np.sqrt(shift[at + q]) + largest < spacing[at + q]:
                chosen[q] = at + q
            else:
                chosen[q] = to_moved[at + q]
                best[q] = _point_distance(start, at + q, moved, chosen[q])
        _outward(leaf, start, start_boxes[leaves + leaf], moved, moved_boxes, best, chosen, False, stack)
        for q in range(count):
            to_moved[at + q] = chosen[q]


@compiled
def _chamfer(order, start, moved, to_start, to_moved, gradient):  # type: ignore[no-untyped-def]
    """Both directions of the Chamfer distance; fills the derivative by the moved points."""
    mean, value = 1.0 / len(gradient), 0.0
    for n in range(len(gradient)):
        i, j = to_start[n], to_moved[n]
        for k in range(3):
            ahead, back = moved[k, n] - start[k, i], moved[k, j] - start[k, n]
            value += ahead * ahead + back * back
            gradient[order[n], k] += 2.0 * mean * ahead
            gradient[order[j], k] += 2.0 * mean * back
    return mean * value
