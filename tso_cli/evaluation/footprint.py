"""The silhouette of a cloud or mesh, and its IoU with a mask.

The silhouette of a mesh is that of its triangles. Of a cloud, a disc closes the gaps between the
projected points: they are dilated by the disc, then eroded by a little less, with distance
transforms on a grid of the window. The radius of the disc depends on the spacing of the points
alone, so that neither the size of the photo nor the number of points decides what is a gap.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..geometry.arrays import Array, Bits, Box, Indices
from ..geometry.camera import Camera
from ..geometry.points import longest_side, quantile
from ..geometry.raster import ACROSS, mostly_covered
from ..geometry.resampling import nearest_cell
from ..geometry.view import View
from ..geometry.window import window_of
from .metrics import iou

# Radius of the disc in spacings, for evenly spaced points and for random points, whose gaps are
# wider.
EVEN, RANDOM = 1.0, 1.4
# The outline lies this many spacings outside the outermost points, because samples of a surface lie
# inside its true outline.
RIM = 0.15
# Cells along the longer side of a window that has more pixels. The pixels of a smaller window are
# divided into cells, so that there are at least the second number.
MOST_CELLS, LEAST_CELLS = 256, 214

IOU_MEANS = (
    "intersection over union of the mask (> 0.5) and the silhouette, points of a cloud joined "
    f"over gaps of up to {2.0 * EVEN:g} to {2.0 * RANDOM:g} spacings, over the known pixels of the "
    "square around both; mean over views"
)


class Solid(NamedTuple):
    """What has a silhouette: the ``points`` [N, 3] of a cloud, or vertices and ``faces`` [F, 3]."""

    points: Array
    faces: Indices | None = None

    def silhouette(self, camera: Camera) -> Bits:
        """The silhouette [H, W] in the image of ``camera``."""
        if self.faces is None:
            return footprint(self.points, camera)
        edges = -0.5, -0.5, camera.width - 0.5, camera.height - 0.5
        fine = camera.cropped(edges, ACROSS * camera.width, ACROSS * camera.height)
        pixels, _, visible = fine.project_visible(self.points)
        triangles = pixels[self.faces[visible[self.faces].all(1)]]
        return mostly_covered(triangles, camera.height, camera.width)


class WindowGrid(NamedTuple):
    """The cells by which a window is compared: ``width`` x ``height`` of them in the ``edges``.

    ``fine`` : into how many a cell is divided along each side for the silhouette.
    """

    edges: Box
    width: int
    height: int
    step: float
    fine: int


class WindowImages(NamedTuple):
    """Images [H, W] of a window; ``known`` is None if all pixels are known."""

    silhouette: Bits
    mask: Bits
    known: Bits | None


def common_window(stages: Sequence[tuple[Solid, View]]) -> Box:
    """Left, top, right, bottom of the window that holds a mask and several solids.

    Each is projected by the camera of its own view.
    """
    edges = np.array([window_of(view, solid.points) for solid, view in stages])
    left, top = edges[:, :2].min(0).tolist()
    right, bottom = edges[:, 2:].max(0).tolist()
    return left, top, right, bottom


def window_iou(solid: Solid, view: View, box: Box | None = None) -> float:
    """IoU of the silhouette of ``solid`` and the mask (> 0.5) in the window ``box``.

    Only known pixels count. The default window is the square around mask and solid. The IoU is 0 if
    the window is so large that its cells miss all known pixels.
    """
    score = iou(*in_window(solid, view, box or window_of(view, solid.points)))
    return 0.0 if np.isnan(score) else score


def in_window(solid: Solid, view: View, box: Box) -> WindowImages:
    """Silhouette and mask, as `window_iou` compares them, in the part of ``box`` in the image.

    A window of fewer than 256 pixels is compared pixel by pixel; a pixel is in the silhouette if
    more than half of it is covered. A larger window is sampled at the centres of 256 x 256 cells,
    so that the time does not grow with the photo.
    """
    camera = view.camera
    edges, width, height, step, fine = grid_of(camera, box)
    left, top, _, _ = edges
    if solid.faces is not None:
        fine = 1  # triangles are drawn with several samples in a cell
    part = camera.cropped(edges, fine * width, fine * height)
    silhouette = solid.silhouette(part)
    if fine > 1:
        silhouette = silhouette.reshape(height, fine, width, fine).mean((1, 3)) > 0.5
    columns, rows = (
        np.minimum(np.rint(start + step * (np.arange(count) + 0.5)).astype(int), most - 1)
        for start, count, most in ((left, width, camera.width), (top, height, camera.height))
    )
    known = None if view.known is None else view.known[rows[:, None], columns]
    return WindowImages(silhouette, view.mask[rows[:, None], columns] > 0.5, known)


def grid_of(camera: Camera, box: Box) -> WindowGrid:
    """The cells of the part of ``box`` in the image of ``camera`` (`in_window`)."""
    first, last = np.array(box).reshape(2, 2)
    step, fine = float((last - first).max()) / MOST_CELLS, 1
    if step <= 1.0:
        first, last = np.floor(first + 0.5) - 0.5, np.ceil(last + 0.5) - 0.5
        step, fine = 1.0, int(np.ceil(LEAST_CELLS / float((last - first).max())))
    size = np.array([camera.width, camera.height])
    first, last = np.maximum(first, -0.5), np.minimum(last, size - 0.5)
    counts = np.maximum(np.rint((last - first) / step), 1.0)
    last = first + step * counts
    (left, top), (right, bottom) = first.tolist(), last.tolist()
    width, height = counts.astype(int).tolist()
    return WindowGrid((left, top, right, bottom), width, height, step, fine)


def spacing(points: Array) -> tuple[float, float]:
    """Spacing of the points [N, 3] of a surface, and radius of the disc that closes their gaps.

    The spacing is 1 / sqrt(points per area), the median over the cloud. It is estimated from the
    eighth neighbours of at most 128 points, among at most 4,096 points of the cloud. The radius is
    1 to 1.4 spacings. Both are 0 if all points are equal.
    """
    unit = longest_side(points)
    if unit == 0.0:
        return 0.0, 0.0
    cloud = _subset(points, most=4096)
    cloud = (cloud - cloud.mean(0)) / unit
    queries, count = _subset(cloud, most=128), min(8, len(cloud) - 1)
    squared = queries @ cloud.T
    squared *= -2.0
    squared += np.square(cloud).sum(1)
    squared.partition(count, axis=1)
    squared = np.sort(squared[:, : count + 1], axis=1)
    # The smallest distance is the distance of a point to itself.
    squared = squared[:, [1, count]] + np.square(queries).sum(1)[:, None]
    nearest, farthest = np.sqrt(np.maximum(quantile(squared, 0.5), 0.0)).tolist()
    # A disc of radius ``farthest`` holds ``count`` points.
    spaced = farthest * float(np.sqrt(np.pi / count))
    # The nearest neighbour is at 0.9 spacings among evenly spaced points, and at 0.5 among random
    # points: the formula gives 1 and 1.4 spacings.
    radius = min(max(2.0 * spaced - 1.1 * nearest, EVEN * spaced), RANDOM * spaced)
    # A subset has a larger spacing than the cloud.
    unit *= float(np.sqrt(len(cloud) / len(points)))
    return unit * spaced, unit * radius


def _subset(points: Array, most: int) -> Array:
    if len(points) <= most:
        return points
    return points[np.random.default_rng(0).choice(len(points), most, replace=False, shuffle=False)]


def footprint(points: Array, camera: Camera) -> Bits:
    """The silhouette [H, W] of a cloud [N, 3] on the grid of the camera's image.

    The projected points are closed by a disc of 1 to 1.4 spacings, and get a rim of 0.15 spacings.
    Points outside the image count; points at or behind the camera do not.
    """
    size = np.array([camera.width, camera.height])
    # Points far apart form no surface.
    widest = 1.0 / 8.0 * float(size.max())
    pixels, depth, visible = camera.project_visible(points)
    # Points further outside change nothing in the image; NaN compares false.
    visible &= (np.abs(pixels - (size - 1.0) / 2.0) < size / 2.0 + 2.0 * widest).all(1)
    scale = np.full(len(points), np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    if camera.model == "perspective":
        scale[visible] /= depth[visible]
    silhouette = np.zeros((camera.height, camera.width), dtype=bool)
    if not visible.any():
        return silhouette
    spaced, closing = spacing(points)
    # A radius under 1.5 cells, or a rim under a quarter, would be lost between cells.
    radius = np.clip(closing * scale[visible], 1.5, widest).astype(np.float32)
    rim = np.clip(RIM * spaced * scale[visible], 0.25, RIM * widest).astype(np.float32)

    # The grid has a border of cells beyond all discs.
    cell = np.rint(pixels[visible]).astype(int)
    border = int(np.ceil(radius.max())) + 3
    low, high = cell.min(0) - border, cell.max(0) + border + 1
    x, y = (pixels[visible] - low).astype(np.float32).T
    number = np.full((high - low)[::-1], -1)
    number[tuple((cell - low).T[::-1])] = np.arange(len(cell))
    row, column = (np.arange(count, dtype=np.float32) for count in number.shape)
    row = row[:, None]

    point = number.ravel()[nearest_cell(number >= 0, border)]
    beyond = np.hypot(x[point] - column, y[point] - row) - radius[point]
    # The point in the nearest cell may not be the nearest point. Near the edge the points found by
    # the adjacent cells are tried too.
    edge = np.nonzero((beyond > 0.0) & (beyond < 1.5))
    for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        adjacent = point[edge[0] + down, edge[1] + right]
        beyond[edge] = np.minimum(
            beyond[edge], np.hypot(x[adjacent] - edge[1], y[adjacent] - edge[0]) - radius[adjacent]
        )
    outside = nearest_cell(beyond > 0.0, border)
    # The nearest cell outside lies ``beyond`` the edge of the discs.
    rows, columns = np.divmod(outside, number.shape[1])
    depth_inside = np.hypot(columns - column, rows - row) - beyond.ravel()[outside]
    inside = (beyond <= 0.0) & ((outside < 0) | (depth_inside > (radius - rim)[point]))

    (left, top), (right, bottom) = np.clip([low, high], 0, size)
    silhouette[top:bottom, left:right] = inside[
        top - low[1] : bottom - low[1], left - low[0] : right - low[0]
    ]
    return silhouette
