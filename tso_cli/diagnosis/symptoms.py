"""Symptoms: what a cloud, a mask or a camera looks like when something is wrong with it.

Each function looks at one thing and returns a finding, or None.
"""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array
from ..geometry.view import View, is_grey_inside, object_box
from .cells import Outline, visible_in
from .findings import Finding
from .placement import Placement

# A mask with fewer pixels, in all and along its longer side, is coarse.
FEWEST_PIXELS = 16


class BoundingBox:
    """A mask that fills its bounding box is probably a detector's box, unless the cloud does too.

    The cloud's box is divided into cells, without the outermost points at each side.
    """

    MASK_FILLED = 0.99
    CLOUD_FILLED = 0.92  # of the cells
    CELLS = 10  # along the longer side of the cloud's box
    TAILS = 0.01  # of the points
    FEWEST_POINTS = 512  # fewer show no box, as do fewer pixels than `FEWEST_PIXELS` across


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
    if pixels >= FEWEST_PIXELS and (side >= FEWEST_PIXELS or points <= 2 * pixels):
        return None
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


def bounding_box(outline: Outline, view: View, number: int, points: Array) -> Finding | None:
    """A mask that is a filled rectangle, where the silhouette of ``points`` [N, 3] is not.

    ``view`` is the outline's view as it is meant.
    """
    left, top, right, bottom = object_box(view.inside)
    if outline.may_be_inverted or min(right - left, bottom - top) < FEWEST_PIXELS:
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
