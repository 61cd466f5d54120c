"""The window: the square region of a picture around the object, however large the photo is."""

from __future__ import annotations

import numpy as np

from .camera import NEAR
from .points import longest_side, quantile
from .resampling import Array, Box
from .view import View

# Background on every side of the object, in units of the longer side of its box. Chosen on training and validation shapes:
# with half as much some clouds get worse, with more all improve less.
MARGIN = 1.0 / 8.0
# Part of the points at either end of an axis that does not widen the window: outliers would cost the object resolution.
STRAYS = 0.005


def window_of(view: View, points: Array | None = None) -> Box:
    """The square (left, top, right, bottom) that holds the mask's foreground and the projected points [N, 3], with a margin.

    It depends on the object alone, whatever the size of the photo; a few outliers may lie outside. Close to a border of the
    image it ends there along that axis; the other axis may reach beyond the image.
    """
    low, high = np.array(view.box()).reshape(2, 2)
    border = np.array([view.camera.width, view.camera.height]) - 0.5
    if points is not None:
        pixels, depth = view.camera.project(points)
        front = np.isfinite(pixels).all(1)
        if view.camera.model == "perspective":
            front &= depth > NEAR * longest_side(points)
        if front.any():
            first, last = (quantile(pixels[front], share) for share in (STRAYS, 1.0 - STRAYS))
            low, high = np.minimum(low, first), np.maximum(high, last)
    low, high = np.maximum(low, -0.5), np.minimum(high, border)
    margin = MARGIN * float((high - low).max())
    low, high = np.maximum(low - margin, -0.5), np.minimum(high + margin, border)
    return _squared(low, high)


def window_around(*boxes: Box) -> Box:
    """The square around several windows, a common region to compare them in."""
    edges = np.array(boxes)
    return _squared(edges[:, :2].min(0), edges[:, 2:].max(0))


def _squared(low: Array, high: Array) -> Box:
    half, middle = float((high - low).max()) / 2.0, (low + high) / 2.0
    left, top, right, bottom = (float(edge) for edge in (*(middle - half), *(middle + half)))
    return left, top, right, bottom
