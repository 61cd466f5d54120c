"""The window: the square region around the object in a picture, whatever the picture's size."""

from __future__ import annotations

import numpy as np

from .arrays import Array, Box
from .points import quantile
from .view import View

# Background on every side of the object, in units of the longer side of its box. Chosen on training
# and validation shapes: with half as much some clouds get worse, with more all improve less.
MARGIN = 1.0 / 8.0
# The share of the points at either end of an axis that does not widen the window: if a few outliers
# widened it, the object would fill fewer of its pixels.
TAIL = 0.005


def window_of(view: View, points: Array | None = None) -> Box:
    """The square that holds the mask's foreground and the projected points [N, 3], with a margin.

    The window depends on the object alone, whatever the size of the photo. A few outliers may lie
    outside it. If a border of the image is closer than the margin, the window ends there along
    that axis; along the other axis it may reach beyond the image.
    """
    low, high = np.array(view.box()).reshape(2, 2)
    border = np.array([view.camera.width, view.camera.height]) - 0.5
    if points is not None:
        pixels, _, visible = view.camera.project_visible(points)
        if visible.any():
            first, last = (quantile(pixels[visible], share) for share in (TAIL, 1.0 - TAIL))
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
