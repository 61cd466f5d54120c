"""Parts of a mask that are not the object's, and of a cloud that its mask does not show.

A hand, a stand, a cast shadow or a second object is in a mask; something in front hides a part of
the object; or a cloud holds a floor. A right cloud fits its masks as soon as they ignore the part.
What a cloud of another shape lacks in its mask, the learned prior judges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..cloud.cloud import ControlledCloud
from ..evaluation.footprint import footprint
from ..geometry.arrays import Array, Bits, Box
from ..geometry.resampling import area_resize, distance_to_nearest
from ..geometry.view import View
from ..optimisation.learned_start import seen_cloud
from ..optimisation.problem import WindowedView, windowed
from ..pose.causes import EXPLAINED_WITHOUT_MOVING, LEFT_WITHOUT_MOVING, SIMILAR
from ..pose.move import Body, Move
from ..pose.placing import missed_in_parts
from ..pose.target import Part
from ..prior import Frame, LearnedPrior, cells_of_maps

# Cells along the side of the square in which silhouette and mask are compared, and the side of the
# square in longer sides of the cloud's box.
CELLS, MARGIN = 96, 1.3
# A part lies this many cells from what the other has, beyond a pixel of the mask.
APART = 2.5
# Smaller parts, in shares of the silhouette, are none.
LEAST_SHARE = 0.01
# Around a part the contour says nothing either, up to this many times `APART`.
AROUND = 2.0
# The parts leave at least this share of the contours around the cloud: less would fit any cloud.
LEAST_KEPT = 0.4
# A cell of the learned prior's maps is foreign if this is its probability. Cells this near to it
# are left out too.
LIKELY, NEXT = 0.5, 1.5
SIGMA_SQ = 1.0  # of a projection that nothing here uses
# Points that are further out than this share, at both ends of both axes, do not count for the box.
TAIL = 0.005


@dataclass(frozen=True, eq=False)
class Parts:
    """What of one view does not belong together.

    box : a square around the cloud. ignored : [H, W], pixels around the parts. in_mask,
    in_cloud : the areas of the parts that the mask has and the cloud lacks, and the other way
    round, in silhouettes of the cloud.
    """

    box: Box
    ignored: Bits
    in_mask: float
    in_cloud: float


def foreign_parts(points: Array, view: View) -> Parts | None:
    """The parts of the mask that a cloud of ``points`` [N, 3] lacks, and of the cloud; or None."""
    box = _box_around(points, view)
    camera = view.camera.cropped(box, CELLS, CELLS)
    silhouette = footprint(points, camera)
    shares = area_resize(view.mask, box, CELLS, CELLS, weights=view.known)
    inside, known = (share > 0.5 for share in shares)
    cells_a_pixel = CELLS / (box[2] - box[0])
    apart = max(APART, cells_a_pixel)
    if not silhouette.any():
        return None
    least = LEAST_SHARE * silhouette.sum()
    in_mask, in_cloud = (
        _large_parts(first & known & ~_dilated(second, apart), least)
        for first, second in ((inside, silhouette), (silhouette, inside))
    )
    around = _dilated(in_mask | in_cloud, AROUND * apart + 1.0)
    ignored, beyond = _in_pixels(around, box, view)
    beyond &= view.inside
    # Foreground beyond the square is far from the cloud.
    area, outside = float(silhouette.sum()), beyond.sum() * cells_a_pixel**2
    of_mask, of_cloud = float(in_mask.sum() + outside) / area, float(in_cloud.sum()) / area
    if of_mask + of_cloud == 0.0:
        return None
    return Parts(box, ignored | beyond, of_mask, of_cloud)


def parts_that_explain(body: Body, views: Sequence[View], move: Move) -> dict[int, Parts]:
    """By number of the view, the parts without which a cloud fits its masks; {} if it does not.

    A cloud of other proportions explains the masks less well. ``move`` : what it misses.
    """
    by_view = [foreign_parts(body.points, view) for view in views]
    counted: list[Part | None] = []
    for view, part in zip(views, by_view, strict=True):
        known = np.ones(view.mask.shape, bool) if view.known is None else view.known
        counted.append((part.box, known & ~part.ignored) if part else None)
        if part and not (view.inside & ~part.ignored).any():
            return {}
    parts = {number: part for number, part in enumerate(by_view) if part}
    if not parts:
        return {}
    missed, share = missed_in_parts(body, views, counted)
    most = min(
        EXPLAINED_WITHOUT_MOVING, LEFT_WITHOUT_MOVING * move.missed, move.stretched - SIMILAR
    )
    return parts if missed < most and share >= LEAST_KEPT else {}


def parts_seen(
    cloud: ControlledCloud, views: Sequence[View], prior: LearnedPrior
) -> dict[int, Parts]:
    """By number of the view, what the ``prior`` takes for something else in the masks."""
    # Depth maps may not be fitted to the cloud yet.
    masks = [replace(view, depth=None) for view in views]
    windows = windowed(masks, cloud, SIGMA_SQ, cloud.control_points)
    frame = Frame.of(cloud.start)
    seen = seen_cloud(cloud.start, windows, [1.0] * len(windows), frame)
    if len(seen.views) < len(windows):  # the cloud is at a camera
        return {}
    parts = {}
    for number, (view, foreign) in enumerate(zip(windows, seen.doubts(prior).foreign, strict=True)):
        if (part := _foreign(view, frame, foreign)) is not None:
            parts[number] = part
    return parts


def _foreign(windowed_view: WindowedView, frame: Frame, probability: Array) -> Parts | None:
    """The part of a mask that is probably foreign, by the cells of the prior's maps; or None."""
    window, foreign = windowed_view.resampled, probability > LIKELY
    cell, inside = cells_of_maps(window.camera, frame), window.target.inside
    around = _dilated(foreign, NEXT)[cell]
    in_mask = inside & foreign[cell]
    if not in_mask.any() or not (inside & ~around).any():
        return None
    ignored, _ = _in_pixels(around, window.box, windowed_view.view)
    return Parts(window.box, ignored, float(in_mask.sum() / (inside & ~in_mask).sum()), 0.0)


def _box_around(points: Array, view: View) -> Box:
    """The square around most of the projected points."""
    pixels, _, visible = view.camera.project_visible(points)
    low, high = np.quantile(pixels[visible], [TAIL, 1.0 - TAIL], axis=0)
    middle, half = (low + high) / 2.0, MARGIN * max(float((high - low).max()), 2.0) / 2.0
    (left, top), (right, bottom) = (middle - half).tolist(), (middle + half).tolist()
    return left, top, right, bottom


def _large_parts(cells: Bits, least: float) -> Bits:
    """The connected parts of ``cells`` [C, C] with at least ``least`` cells."""
    # Every cell takes the largest number of its neighbours until all of a part have one number.
    number = np.where(cells, np.arange(1, cells.size + 1).reshape(cells.shape), 0)
    while True:
        # Along rows, then along columns: a tenth of the time of windows of nine.
        padded = np.pad(number, 1)
        rows = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
        largest = np.maximum(np.maximum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:]) * cells
        if (largest == number).all():
            break
        number = largest
    large = np.bincount(number.ravel()) >= least
    large[0] = False
    return np.asarray(large[number])


def _dilated(cells: Bits, radius: float) -> Bits:
    """The cells [C, C] within a ``radius``, in cells, of some of the ``cells``."""
    return np.asarray(distance_to_nearest(cells, int(np.ceil(radius))) <= radius)


def _in_pixels(cells: Bits, box: Box, view: View) -> tuple[Bits, Bits]:
    """[H, W] the pixels in the ``cells`` [C, C] of the ``box``, and those outside the box."""
    places, side = [], len(cells)
    for count, start in zip(view.mask.shape, (box[1], box[0]), strict=True):
        cell = np.rint((np.arange(count) - start) * side / (box[2] - box[0]) - 0.5)
        places.append(cell.astype(np.int64))
    rows, columns = places[0][:, None], places[1]
    within = (rows >= 0) & (rows < side) & (columns >= 0) & (columns < side)
    clipped = (np.clip(index, 0, side - 1) for index in (rows, columns))
    return within & cells[tuple(clipped)], ~within
