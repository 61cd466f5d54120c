"""Symptoms: what a cloud, a mask or a camera looks like when something is wrong with it.

Each function looks at one thing and returns a finding, or None.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.arrays import Array, Bits
from ..geometry.points import longest_side
from ..geometry.view import View, is_grey_inside, object_box
from .cells import CELLS, FEWEST_CELLS, Outline, dilated, pixels_at, visible_in
from .findings import Finding
from .placement import Placement


class CoarseMask:
    """A mask with few pixels. A short side is no problem if two points fall on a pixel."""

    FEWEST_PIXELS = 16  # of the foreground
    FEWEST_ACROSS = 16  # along its longer side


class BoundingBox:
    """A mask that fills its bounding box is probably a detector's box, unless the cloud does too.

    The cloud's box is divided into cells, without the outermost points at each side.
    """

    MASK_FILLED = 0.99
    CLOUD_FILLED = 0.92  # of the cells
    CELLS = 10  # along the longer side of the cloud's box
    TAILS = 0.01  # of the points
    FEWEST_POINTS, FEWEST_PIXELS = 512, 16  # fewer, along the mask's shorter side, show no box


class Occluder:
    """Something in front of the object, or an object that lacks a part of the cloud?

    Chosen on shapes of training and validation, some of them behind walls and discs that hide 30 %
    of the mask: 50 % of the walls and 33 % of the discs are found, and something is found in 1 of
    1,734 scenes with nothing in front.
    """

    # Of the cloud's cells, at least this share is in one part, and touches no cell of the mask.
    LEAST_SHARE = 0.12
    # Length of the mean of unit vectors from the mask's middle to the cells of the part.
    ONE_SIDED = 0.75
    # Without the part the IoU is at least this, and higher by this.
    LEAST_IOU, LEAST_GAIN = 0.65, 0.1
    # If other views show this share of the part, at least this share of it is on their masks ...
    SEEN_ELSEWHERE = 0.5
    # ... and if fewer views do, the part touches at most this number of cells of the mask, for each
    # of its cells, or the rest agrees so well that the object is hardly another one. A single view
    # may look along the line from the part to the rest.
    FEWEST_OTHERS = 2
    MOST_CONTACT, SAME_IOU = 0.45, 0.85


# A cloud is implausibly near or far at a distance outside this range, in its longest sides.
PLAUSIBLE_DISTANCES = (0.2, 1000.0)


def photo(view: View, number: int) -> Finding | None:
    """A mask that is grey over more than what it shows."""
    known = np.ones(view.mask.shape, bool) if view.known is None else view.known
    return Finding("photo", (number,)) if is_grey_inside(view.mask, view.inside, known) else None


def coarse(view: View, number: int, points: int) -> Finding | None:
    """A mask too coarse for a cloud of ``points`` points."""
    pixels = int(view.inside.sum())
    left, top, right, bottom = view.box()
    side = round(max(right - left, bottom - top))
    # Front and back of the surface both project: with over two points per pixel their spacing is
    # below a pixel.
    if pixels >= CoarseMask.FEWEST_PIXELS and (
        side >= CoarseMask.FEWEST_ACROSS or points <= 2 * pixels
    ):
        return None
    if side == 1:
        return Finding("single-pixel", (number,))
    return Finding("coarse", (number,), values={"pixels": pixels, "side": side})


def specks(view: View, number: int) -> Finding | None:
    """Foreground far from the object, which is left out."""
    return Finding("specks", (number,), values={"pixels": view.specks}) if view.specks else None


def behind(placement: Placement, number: int) -> Finding | None:
    """Some points, but not all, behind the camera."""
    if not 0 < placement.behind < placement.points:
        return None
    values = {"behind": placement.behind, "points": placement.points}
    return Finding("behind", (number,), values=values)


def scale(points: Array, view: View, number: int) -> Finding | None:
    """A cloud [N, 3] implausibly near or far for its size: the camera may be in another unit."""
    camera = view.camera
    size = longest_side(points)
    middle = (points.min(0) + points.max(0)) / 2.0
    distance = float((camera.R @ middle + camera.t)[2])
    nearest, farthest = PLAUSIBLE_DISTANCES
    if camera.model != "perspective" or distance <= 0.0:
        return None
    if nearest < distance / size < farthest:
        return None
    return Finding("scale", (number,), values={"size": size, "distance": distance})


def bounding_box(outline: Outline, view: View, number: int, points: Array) -> Finding | None:
    """A mask that is a filled rectangle, where the silhouette of ``points`` [N, 3] is not.

    ``view`` is the outline's view as it is meant.
    """
    left, top, right, bottom = object_box(view.inside)
    if outline.may_be_inverted or min(right - left, bottom - top) < BoundingBox.FEWEST_PIXELS:
        return None
    if view.inside[top:bottom, left:right].mean() < BoundingBox.MASK_FILLED:
        return None
    pixels = view.camera.project(points)[0]
    pixels = pixels[visible_in(view, *pixels.T)]
    if len(pixels) < BoundingBox.FEWEST_POINTS:
        return None
    low, high = np.quantile(pixels, [BoundingBox.TAILS, 1.0 - BoundingBox.TAILS], axis=0)
    size = np.maximum(high - low, 1e-9)
    cells = np.ceil(BoundingBox.CELLS * size / size.max())
    places = np.floor((pixels - low) / size * cells)
    inside = places[((places >= 0.0) & (places < cells)).all(1)]
    if len(np.unique(inside, axis=0)) >= BoundingBox.CLOUD_FILLED * float(cells.prod()):
        return None
    return Finding("box", (number,))


def occluder(
    view: View, number: int, points: Array, others: Sequence[View] = ()
) -> tuple[Finding, Bits] | None:
    """Something in front of the object, a cloud of ``points`` [N, 3], and the pixels it hides.

    The cloud has a compact part outside the mask, and the rest of the cloud agrees with the mask.
    The ``others`` show whether the object has this part.
    """
    if view.truncated:
        # What of the object the picture shows is not known, and so neither is the share.
        return None
    outline = Outline(view)
    cells = outline.cells[False]
    x, y, _ = outline.project(points, [()])
    visible = visible_in(view, x, y)
    covered = cells.covered(x, y, visible)[0]
    inside = np.pad(cells.inside, CELLS)
    fewest = Occluder.LEAST_SHARE * covered.sum()
    away = covered & ~dilated(inside)
    if cells.count < FEWEST_CELLS or away.sum() <= fewest:
        return None
    from scipy.ndimage import label

    outside = covered & ~inside
    parts = label(outside, np.ones((3, 3)))[0]
    part = parts == np.bincount(parts[outside]).argmax()
    if (part & away).sum() <= fewest:
        return None
    # A cloud that is too large goes on at all sides.
    aside = np.argwhere(part) - np.argwhere(inside).mean(0)
    directions = aside / np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-9)
    if np.linalg.norm(directions.mean(0)) < Occluder.ONE_SIDED:
        return None
    before, rest = (
        float((cloud & inside).sum() / (cloud | inside).sum())
        for cloud in (covered, covered & ~part)
    )
    if rest < max(Occluder.LEAST_IOU, before + Occluder.LEAST_GAIN):
        return None
    hidden = cells.pixels_of(dilated(part), *view.mask.shape) & ~view.inside
    shown = visible[0]
    of_part = hidden[pixels_at(x[0, shown], y[0, shown])]
    shares = _shares_on_masks(points[shown][of_part], others)
    if shares and np.mean(shares) < Occluder.SEEN_ELSEWHERE:
        return None
    contact = (dilated(part) & inside).sum() / part.sum()
    alike = contact <= Occluder.MOST_CONTACT or rest >= Occluder.SAME_IOU
    if len(shares) < Occluder.FEWEST_OTHERS and not alike:
        return None
    share = 100.0 * float(part.sum() / covered.sum())
    return Finding("occluder", (number,), rest, rest - before, values={"share": share}), hidden


def _shares_on_masks(points: Array, views: Sequence[View]) -> list[float]:
    """The share of ``points`` [N, 3] on the mask of each view that shows most of them."""
    shares = []
    for view in views:
        places = view.camera.project(points)[0]
        places = places[visible_in(view, *places.T)]
        if len(places) >= max(1.0, Occluder.SEEN_ELSEWHERE * len(points)):
            shares.append(float(view.inside[pixels_at(*places.T)].mean()))
    return shares
