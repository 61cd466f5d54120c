"""The window around a point: outside it the Gaussian of the point is negligible."""

from __future__ import annotations

import math

# A Gaussian under this value is negligible. Windows are square, so a sum under this value may come
# from the corner of one window while a nearer point lies beyond the side of its own window.
NEGLIGIBLE = 1e-8


def window_radius(sigma_sq: float) -> int:
    """Radius, px, of the window of a Gaussian of variance ``sigma_sq`` (px^2): 4 at 0.4."""
    return math.ceil(math.sqrt(2.0 * sigma_sq * math.log(1.0 / NEGLIGIBLE)))
