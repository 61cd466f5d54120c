"""Masks whose outline lies some pixels too far out, or too far in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .arrays import Floats
from .resampling import blurred, distance_to_nearest
from .view import View

# Into how many cells a pixel is divided along each side, and the deviation of the blur that rounds
# the steps between its pixels, in cells.
FINE, BLUR = 4, 1.0
# A smaller change is none: pixels, and shares of the object's longer side. The second is a sixth of
# the cells that the losses compare.
LEAST_PIXELS, LEAST_SHARE = 0.1, 0.003
# At most this share of the depth of a mask is taken away, so that something of it is left.
MOST_SHARE = 0.6


def shrunk(view: View, pixels: float) -> View:
    """The view with its outline ``pixels`` further in; further out where they are negative.

    The outline lies between pixels, so that the mask has soft values. A change that nothing could
    resolve is not made.
    """
    left, top, right, bottom = view.pixels_of_object
    if abs(pixels) < max(LEAST_PIXELS, LEAST_SHARE * max(right - left, bottom - top)):
        return view
    margin = int(np.ceil(max(-pixels, 0.0))) + 2
    rows = slice(max(top - margin, 0), bottom + margin)
    columns = slice(max(left - margin, 0), right + margin)
    part = view.mask[rows, columns]
    # Beyond the border of the picture the object goes on as at the border.
    around = FINE * margin
    inside = np.pad(np.kron(part, np.ones((FINE, FINE))) > 0.5, around, mode="edge")
    reach = int(np.ceil(FINE * (abs(pixels) / MOST_SHARE + 1.0)))
    out, into = (
        np.minimum(distance_to_nearest(region, reach), reach) for region in (inside, ~inside)
    )
    outward = blurred(out - into, BLUR)
    outward = outward[around:-around, around:-around]
    pixels = min(pixels, -MOST_SHARE * float(outward.min()) / FINE)
    fine = np.clip(0.5 - outward - FINE * pixels, 0.0, 1.0)
    mask: Floats = view.mask.copy()
    mask[rows, columns] = fine.reshape(part.shape[0], FINE, part.shape[1], FINE).mean((1, 3))
    known = mask if view.known is None else mask[view.known]
    if not (known > 0.5).any() or (known > 0.5).all():
        return view
    return replace(view, mask=mask)
