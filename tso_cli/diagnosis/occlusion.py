"""Is something in front of the object? A mask that ends at a straight edge where the cloud goes on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Array
from ..geometry.points import longest_side
from ..geometry.view import View

# Least length of the edge as a share of the mask's longer side; cells along that side, in which silhouettes are compared.
LEAST_EDGE, CELLS = 0.15, 16
# Blocks of pixels stand for those of a mask whose longer side has over twice as many.
SIDE = 256
# Foreground at the edge is this near, px; it is at least this share, along the edge, of that behind (so far, of that side).
WITHIN, LEAST_STRAIGHT, BEHIND = 1.5, 0.7, 0.15
# Least share of the points over so far beyond the edge (of that side); least IoU that is gained without them.
LEAST_BEYOND, BEYOND, GAIN = 0.05, 0.04, 0.1


def occluded(pixels: Array, view: View) -> float | None:
    """IoU of the mask and those of ``pixels`` [N, 2], the projected cloud, that lie behind the edge of an occluder.

    Such an edge is straight, inside the picture, ends the mask, and has part of the cloud beyond it; None where there is none.
    """
    left, top, right, bottom = view.box()
    step = max(1, int(max(right - left, bottom - top)) // SIDE)
    inside, pixels = _blocks(view.inside, step), (pixels - (step - 1) / 2.0) / step
    rows, columns = np.nonzero(inside)
    outline = np.stack([columns, rows], axis=1).astype(np.float64)
    size = longest_side(outline) + 1.0
    if size < 2 * CELLS or not len(pixels):
        return None
    corners = _hull(inside)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = end - start
        length = np.hypot(*along)
        middle = (start + end) / 2.0
        at_border = (middle < WITHIN).any() or (
            middle > np.array(inside.shape[::-1]) - 1.0 - WITHIN
        ).any()
        if length < LEAST_EDGE * size or at_border:
            continue
        along = along / length
        # Corners run so that the mask is on the left, y pointing down.
        behind = (outline - start) @ [-along[1], along[0]]
        strip = behind < BEHIND * size
        place = np.floor((outline[strip] - start) @ along).astype(np.int64)
        at_edge, near = _different(place[behind[strip] < WITHIN]), _different(place)
        beyond = -(pixels - start) @ [-along[1], along[0]]
        if (
            at_edge < max(LEAST_EDGE * size, LEAST_STRAIGHT * near)
            or (beyond > BEYOND * size).mean() < LEAST_BEYOND
        ):
            continue
        without = _iou(outline, pixels[beyond <= 0.0], size)
        if without >= _iou(outline, pixels, size) + GAIN:
            return without
    return None


def _blocks(inside: NDArray[np.bool_], step: int) -> NDArray[np.bool_]:
    """Whether blocks of so many pixels a side hold foreground."""
    for axis in range(2) if step > 1 else ():
        inside = np.logical_or.reduceat(inside, np.arange(0, inside.shape[axis], step), axis)
    return inside


def _different(places: NDArray[np.int64]) -> int:
    """How many different ones there are, without `numpy.unique`, which imports masked arrays."""
    return int(np.count_nonzero(np.bincount(places - places.min()))) if len(places) else 0


def _hull(inside: NDArray[np.bool_]) -> Array:
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


def _iou(outline: Array, pixels: Array, size: float) -> float:
    covered, inside = (
        set(map(tuple, np.floor(places * (CELLS / size)).astype(int).tolist()))
        for places in (pixels, outline)
    )
    return len(covered & inside) / len(covered | inside)
