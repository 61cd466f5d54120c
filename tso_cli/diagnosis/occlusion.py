"""Is something in front of the object? Its mask ends at a straight edge, and the cloud goes on."""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array, Bits, Indices
from ..geometry.points import longest_side
from ..geometry.view import View
from .cells import CELLS, Cells

# Blocks of pixels stand for the pixels of a mask whose longer side has over twice as many.
SIDE = 256


class Edge:
    """The straight edge of an occluder. Lengths are shares of the mask's longer side."""

    LEAST_LENGTH = 0.15
    # Foreground is at the edge if it is nearer than this, px ...
    AT = 1.5
    # ... and behind the edge if it is nearer than this length. At least a share of the places along
    # the edge that have foreground behind it have foreground at it.
    BEHIND, STRAIGHT_SHARE = 0.15, 0.7
    # At least a share of the points is farther beyond the edge than this length.
    BEYOND, BEYOND_SHARE = 0.04, 0.05
    # The IoU without the points beyond the edge is higher by at least this.
    LEAST_GAIN = 0.1


def occluded(pixels: Array, view: View) -> float | None:
    """IoU of the mask and the part of the projected cloud behind the edge of an occluder.

    Such an edge is straight, lies inside the picture, ends the mask, and has a part of the cloud
    beyond it. None where there is no such edge. ``pixels`` [N, 2] are the projected cloud.
    """
    left, top, right, bottom = view.box()
    step = max(1, int(max(right - left, bottom - top)) // SIDE)
    inside, pixels = _blocks(view.inside, step), (pixels - (step - 1) / 2.0) / step
    rows, columns = np.nonzero(inside)
    outline = np.stack([columns, rows], axis=1).astype(np.float64)
    size = longest_side(outline) + 1.0
    if size < 2 * CELLS or not len(pixels):
        return None
    cells = Cells.around(outline, size / CELLS)
    last = np.array(inside.shape[::-1]) - 1.0
    corners = _hull(inside)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = end - start
        length = np.hypot(*along)
        middle = (start + end) / 2.0
        at_border = (middle < Edge.AT).any() or (middle > last - Edge.AT).any()
        if length < Edge.LEAST_LENGTH * size or at_border:
            continue
        along = along / length
        # Corners run so that the mask is on the left, y pointing down.
        inward = np.array([-along[1], along[0]])
        behind = (outline - start) @ inward
        strip = behind < Edge.BEHIND * size
        place = np.floor((outline[strip] - start) @ along).astype(np.int64)
        at_edge, near = _different(place[behind[strip] < Edge.AT]), _different(place)
        beyond = -(pixels - start) @ inward
        straight = at_edge >= max(Edge.LEAST_LENGTH * size, Edge.STRAIGHT_SHARE * near)
        if not straight or (beyond > Edge.BEYOND * size).mean() < Edge.BEYOND_SHARE:
            continue
        without = cells.iou(pixels[beyond <= 0.0])
        if without >= cells.iou(pixels) + Edge.LEAST_GAIN:
            return without
    return None


def _blocks(inside: Bits, step: int) -> Bits:
    """Whether blocks of ``step`` x ``step`` pixels hold foreground."""
    for axis in range(2) if step > 1 else ():
        inside = np.logical_or.reduceat(inside, np.arange(0, inside.shape[axis], step), axis)
    return inside


def _different(places: Indices) -> int:
    """How many of the places differ. `numpy.unique` would import masked arrays."""
    return int(np.count_nonzero(np.bincount(places - places.min()))) if len(places) else 0


def _hull(inside: Bits) -> Array:
    """[M, 2], x and y of the corners of the convex hull of foreground pixels, in order."""
    rows = np.flatnonzero(inside.any(1))
    first, last = inside[rows].argmax(1), inside.shape[1] - 1 - inside[rows, ::-1].argmax(1)
    corners: list[tuple[int, int]] = []
    for xs, ys in ((last, rows), (first[::-1], rows[::-1])):
        done = len(corners)
        for corner in zip(xs.tolist(), ys.tolist(), strict=True):
            while len(corners) > done + 1 and _turn(corners[-2], corners[-1], corner) <= 0:
                corners.pop()
            corners.append(corner)
    return np.array(corners, dtype=np.float64)


def _turn(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> int:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
