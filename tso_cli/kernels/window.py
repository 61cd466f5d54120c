"""The window around a point in which its Gaussian counts."""

from __future__ import annotations

import math

# A Gaussian under this is negligible. Windows are square: a sum below it may come from the corner of one while a nearer point
# lies beyond its side.
NEGLIGIBLE = 1e-8


def window_radius(sigma_sq: float) -> int:
    """Radius in pixels beyond which a Gaussian of variance ``sigma_sq`` (px^2) is negligible: 4 at 0.4."""
    return math.ceil(math.sqrt(2.0 * sigma_sq * math.log(1.0 / NEGLIGIBLE)))
