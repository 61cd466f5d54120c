"""The silhouette of a cloud as the spacing of its points makes it, and how well it agrees with a mask.

Gaps between points are closed with a disc: the projected points are dilated by it, then eroded. Its radius follows the
spacing of the cloud as it is seen, so that neither the size of the photo nor the number of points decides what is a gap.
Both steps are distance transforms on a grid of the window, that count from the points themselves, not from their cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import NEAR, Camera
from ..geometry.view import View
from ..geometry.window import Array, Box, window_of
from .metrics import iou

Bools = NDArray[np.bool_]

# Radius of the disc in spacings: of points that lie evenly, and of those that lie at random and so leave wider gaps.
EVEN, RANDOM = 1.0, 1.4
# How far the outline lies beyond the outermost points, in spacings: samples lie inside the true outline.
RIM = 0.15
# The least of both, in cells: nothing is finer than the grid.
LEAST_REACH, LEAST_RIM = 1.5, 0.25
# The largest disc, as a share of the window's longer side: a few points far from each other have nothing to close.
WIDEST = 1.0 / 8.0
# Cells along the window's longer side where it has more pixels, and the fewest: pixels are divided where they are fewer.
CELLS, FEWEST = 256, 214
# The spacing is told by the distance to so many neighbours, of so many points where the cloud has more.
NEIGHBOURS, ASKED = 8, 128
# Of a cloud that is larger than this only so many points, drawn at random, are neighbours.
MOST = 4096

IOU_MEANS = (
    "intersection over union of the mask (> 0.5) and the cloud's silhouette, its points joined over gaps of up to "
    f"{2.0 * EVEN:g} to {2.0 * RANDOM:g} spacings, over the known pixels of the square around both; mean over views"
)


class Seen(NamedTuple):
    """Silhouette and mask in a window, [H, W] each."""

    silhouette: Bools
    mask: Bools
    known: Bools | None  # False where the mask says nothing, None where every pixel counts


def common_window(stages: Sequence[tuple[Array, View]]) -> Box:
    """Left, top, right, bottom of the window that holds a mask and several clouds [N, 3], each seen by its view's camera."""
    edges = np.array([window_of(view, points) for points, view in stages])
    left, top = edges[:, :2].min(0).tolist()
    right, bottom = edges[:, 2:].max(0).tolist()
    return left, top, right, bottom


def window_iou(points: Array, view: View, box: Box | None = None) -> float:
    """Intersection over union of a cloud's silhouette and the mask (> 0.5), over the known pixels of a window.

    Parameters
    ----------
    points : [N, 3], N >= 1, in the units of the view's camera.
    box : left, top, right, bottom in pixel coordinates of the mask; None for the square around mask and cloud.

    Returns
    -------
    In [0, 1]. It is 0 where the window is so much larger than the object that its cells miss all that is known.
    """
    score = iou(*in_window(points, view, window_of(view, points) if box is None else box))
    return 0.0 if np.isnan(score) else score


def in_window(points: Array, view: View, box: Box) -> Seen:
    """What `window_iou` compares: silhouette and mask in the part of ``box`` that lies in the image.

    A window of fewer than 256 pixels is compared pixel by pixel, of which the silhouette has those that it covers by half. A
    larger one has 256 x 256 cells, and what lies in the middle of each is compared: the time does not grow with the photo.
    """
    camera = view.camera
    first, last = np.array(box).reshape(2, 2)
    step, fine = float((last - first).max()) / CELLS, 1
    if step < 1.0:
        first, last = np.floor(first + 0.5) - 0.5, np.ceil(last + 0.5) - 0.5
        step, fine = 1.0, int(np.ceil(FEWEST / float((last - first).max())))
    size = np.array([camera.width, camera.height])
    first, last = np.maximum(first, -0.5), np.minimum(last, size - 0.5)
    counts = np.maximum(np.rint((last - first) / step), 1.0)
    last = first + step * counts
    (left, top), (right, bottom), (width, height) = first.tolist(), last.tolist(), counts.astype(int).tolist()
    silhouette = footprint(points, camera.cropped((left, top, right, bottom), fine * width, fine * height))
    if fine > 1:
        silhouette = silhouette.reshape(height, fine, width, fine).mean((1, 3)) > 0.5
    columns, rows = (
        np.minimum(np.rint(start + step * (np.arange(count) + 0.5)).astype(int), most - 1)
        for start, count, most in ((left, width, camera.width), (top, height, camera.height))
    )
    known = None if view.known is None else view.known[rows[:, None], columns]
    return Seen(silhouette, view.mask[rows[:, None], columns] > 0.5, known)


def spacing(points: Array) -> tuple[float, float]:
    """How far apart the points [N, 3] of a surface lie, and the radius of the disc that closes the gaps between them.

    Returns
    -------
    1 / sqrt(points per area), the median over the cloud, and 1 to 1.4 times that, in the units of the points. 0 where all are
    equal.
    """
    unit = float(np.ptp(points, axis=0).max())
    if unit == 0.0:
        return 0.0, 0.0
    cloud = _drawn(points, MOST)
    cloud = (cloud - cloud.mean(0)) / unit
    asked, count = _drawn(cloud, ASKED), min(NEIGHBOURS, len(cloud) - 1)
    squared = asked @ cloud.T
    squared *= -2.0
    squared += np.square(cloud).sum(1)
    # The least is the point itself.
    squared.partition([1, count], axis=1)
    squared = squared[:, [1, count]] + np.square(asked).sum(1)[:, None]
    nearest, farthest = np.sqrt(np.maximum(np.median(squared, axis=0), 0.0)).tolist()
    # A disc of that radius holds so many neighbours.
    apart = farthest * float(np.sqrt(np.pi / count))
    # The nearest neighbour is 0.9 spacings away where points lie evenly, 0.5 where at random.
    reach = min(max(2.0 * apart - 1.1 * nearest, EVEN * apart), RANDOM * apart)
    # Those that were drawn lie farther apart than all.
    unit *= float(np.sqrt(len(cloud) / len(points)))
    return unit * apart, unit * reach


def _drawn(points: Array, most: int) -> Array:
    """So many of the points, drawn at random, the same ones every time; all where there are no more."""
    if len(points) <= most:
        return points
    return points[np.random.default_rng(0).choice(len(points), most, replace=False, shuffle=False)]


def footprint(points: Array, camera: Camera) -> Bools:
    """The silhouette [H, W] of a cloud: what lies in no empty disc of 1 to 1.4 spacings, and a rim of 0.15 spacings about it.

    Points beyond the borders of the image take part in it, those at or behind the camera do not.

    Parameters
    ----------
    points : [N, 3], N >= 1.
    camera : its image is the grid. Time and memory grow with it; some hundred pixels a side are meant.
    """
    size = np.array([camera.width, camera.height])
    widest = WIDEST * float(size.max())
    pixels, depth = camera.project(points)
    # What lies farther outside changes nothing inside. NaN is no less than anything.
    seen = (np.abs(pixels - (size - 1.0) / 2.0) < size / 2.0 + 2.0 * widest).all(1)
    scale = np.full(len(points), np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    if camera.model == "perspective":
        seen &= depth > NEAR * np.ptp(points, axis=0).max()
        scale[seen] /= depth[seen]
    silhouette = np.zeros((camera.height, camera.width), dtype=bool)
    if not seen.any():
        return silhouette
    apart, radius = spacing(points)
    reach = np.clip(radius * scale[seen], LEAST_REACH, widest).astype(np.float32)
    rim = np.clip(RIM * apart * scale[seen], LEAST_RIM, RIM * widest).astype(np.float32)

    # The grid ends where nothing reaches: there is always a cell beyond all discs.
    cell = np.rint(pixels[seen]).astype(int)
    border = int(np.ceil(reach.max())) + 3
    low, high = cell.min(0) - border, cell.max(0) + border + 1
    x, y = (pixels[seen] - low).astype(np.float32).T
    number = np.full((high - low)[::-1], -1)
    number[tuple((cell - low).T[::-1])] = np.arange(len(cell))
    row, column = (np.arange(count, dtype=np.float32) for count in number.shape)
    row = row[:, None]

    point = number.ravel()[_nearest(number >= 0, border)]
    beyond = np.hypot(x[point] - column, y[point] - row) - reach[point]
    # The point of the nearest cell need not be the nearest one: where that matters, those of the cells around are asked too.
    at = np.nonzero((beyond > 0.0) & (beyond < 1.5))
    for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        other = point[at[0] + down, at[1] + right]
        beyond[at] = np.minimum(beyond[at], np.hypot(x[other] - at[1], y[other] - at[0]) - reach[other])
    outside = _nearest(beyond > 0.0, border)
    # From the nearest cell beyond the discs it is so far back to their edge.
    rows, columns = np.divmod(outside, number.shape[1])
    depth_inside = np.hypot(columns - column, rows - row) - beyond.ravel()[outside]
    inside = (beyond <= 0.0) & ((outside < 0) | (depth_inside > (reach - rim)[point]))

    (left, top), (right, bottom) = np.clip([low, high], 0, size)
    silhouette[top:bottom, left:right] = inside[top - low[1] : bottom - low[1], left - low[0] : right - low[0]]
    return silhouette


def _nearest(cells: Bools, within: int) -> NDArray[np.signedinteger]:
    """The number [H, W] of the nearest of ``cells`` [H, W], counted row by row; -1 where none is within as many rows."""
    bits = cells.size.bit_length()
    # Squared distance and number in one integer: the least of them tells both.
    kind = np.int32 if (2 * within**2).bit_length() + bits < 30 else np.int64
    none = np.iinfo(kind).max // 2
    least = np.full(cells.shape, none, dtype=kind)
    least[cells] = np.flatnonzero(cells)
    for _ in range(2):
        least = np.ascontiguousarray(least.T)
        start = least.copy()
        for step in range(1, within + 1):
            farther = start + kind(step * step << bits)
            np.minimum(least[step:], farther[:-step], out=least[step:])
            np.minimum(least[:-step], farther[step:], out=least[:-step])
    return np.where(least < none, least & ((1 << bits) - 1), -1)
