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
# A mask that fills this share of its bounding box is probably a detector's box, unless the cloud
# fills this share of the cells of its own box. That has this number of cells along its longer side,
# and leaves out this share of the points at each side. Fewer points show no box, as do fewer pixels
# across than `FEWEST_PIXELS`.
MASK_FILLED, CLOUD_FILLED = 0.99, 0.92
BOX_CELLS, BOX_TAILS, FEWEST_POINTS = 10, 0.01, 512


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
    if view.inside[top:bottom, left:right].mean() < MASK_FILLED:
        return None
    pixels = view.camera.project(points)[0]
    pixels = pixels[visible_in(view, *pixels.T)]
    if len(pixels) < FEWEST_POINTS:
        return None
    low, high = np.quantile(pixels, [BOX_TAILS, 1.0 - BOX_TAILS], axis=0)
    size = np.maximum(high - low, 1e-9)
    cells = np.ceil(BOX_CELLS * size / size.max())
    places = np.floor((pixels - low) / size * cells)
    inside = places[((places >= 0.0) & (places < cells)).all(1)]
    if len(np.unique(inside, axis=0)) >= CLOUD_FILLED * float(cells.prod()):
        return None
    return Finding("box", (number,))
