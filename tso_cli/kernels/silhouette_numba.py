"""The cross-entropy of the silhouette of one view as compiled loops.

Its reference is `tso_cli.losses.silhouette`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .losses_numba import cross_entropy, pixels_to_points
from .splat_numba import gradient as splat_gradient
from .splat_numba import sums as splat_sums
from .window import NEGLIGIBLE, window_radius


def silhouette_bce(
    points_px: NDArray[np.floating],
    valid: NDArray[np.bool_],
    foreground: NDArray[np.floating],
    background: NDArray[np.floating],
    sigma_sq: float,
) -> tuple[float, NDArray[np.float64]]:
    """Value and gradient [N, 2]. They are computed in float32, whose exponentials are SIMD code."""
    points, covering, freeing = (
        array.astype(np.float32, order="C")[None] for array in (points_px, foreground, background)
    )
    radius = window_radius(sigma_sq)
    height, width = foreground.shape
    sums = splat_sums(points, valid[None], height, width, sigma_sq, radius)
    value, by_sums, waiting = cross_entropy(sums, covering, freeing, NEGLIGIBLE)
    gradient = splat_gradient(by_sums, points, valid[None], sigma_sq, radius)
    if waiting.any():
        by_nearest, gradient_by_nearest = pixels_to_points(
            waiting, covering, points, valid[None], 0.5 / sigma_sq
        )
        value, gradient = value + by_nearest, gradient + gradient_by_nearest
    return float(value[0]), gradient[0].astype(np.float64)
