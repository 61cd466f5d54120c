"""Sums of Gaussians over a pixel grid in numpy, and their gradient.

Points are sorted by row. Those that are drawn together touch a few rows only, and their sum over
these rows is one product of matrices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .window import window_radius

Array = NDArray[np.float64]

# Points that are drawn together. Fewer touch fewer rows, but are more calls of numpy.
POINTS_AT_ONCE = 256
# Under this exponent a weight stays e^-300: products of smaller ones would be denormal numbers,
# with which arithmetic is ten times slower.
LEAST_EXPONENT = -300.0


@dataclass(frozen=True, eq=False)
class _Band:
    """Points that are drawn together, and the rows that their windows touch."""

    points: NDArray[np.int64]  # [n] their numbers
    rows: slice  # h of them
    dx: Array  # [n, W] column minus point
    dy: Array  # [n, h] row minus point
    across: Array  # [n, W] factor of the Gaussian along x
    down: Array  # [n, h] along y


class Splat:
    """The sum, at every pixel centre, of one un-normalised Gaussian per point.

    Parameters
    ----------
    points_px : [N, 2] column and row, finite.
    sigma_sq : variance of the Gaussian, px^2.

    Attributes
    ----------
    sums : [height, width]. Rows in which a Gaussian is negligible may lack it.
    """

    def __init__(self, points_px: Array, height: int, width: int, sigma_sq: float) -> None:
        self._sigma_sq, self._count = sigma_sq, len(points_px)
        self._bands: list[_Band] = []
        self.sums: Array = np.zeros((height, width))
        radius = window_radius(sigma_sq)
        order = np.argsort(points_px[:, 1], kind="stable")
        columns = np.arange(width)
        for start in range(0, len(order), POINTS_AT_ONCE):
            rows = order[start : start + POINTS_AT_ONCE]
            x, y = points_px[rows].T[:, :, None]
            # Of floats, as the row of a far point may not fit an integer.
            top = int(min(max(np.rint(y[0, 0]) - radius, 0.0), height))
            bottom = int(min(max(np.rint(y[-1, 0]) + radius + 1.0, 0.0), height))
            if top < bottom:
                dx, dy = columns - x, np.arange(top, bottom) - y
                across, down = self._weights(dx), self._weights(dy)
                self.sums[top:bottom] += down.T @ across
                self._bands.append(_Band(rows, slice(top, bottom), dx, dy, across, down))

    def _weights(self, distance: Array) -> Array:
        exponent = np.square(distance)
        exponent *= -0.5 / self._sigma_sq
        np.maximum(exponent, LEAST_EXPONENT, out=exponent)
        return np.exp(exponent, out=exponent)

    def gradient(self, by_sums: Array) -> Array:
        """Derivative [N, 2] by the points, from that by the sums [height, width]."""
        gradient = np.zeros((self._count, 2))
        for band in self._bands:
            rows = by_sums[band.rows]
            taps = band.down @ rows  # [n, W]
            taps *= band.across
            gradient[band.points, 0] = np.einsum("nw,nw->n", taps, band.dx)
            taps = (band.down * band.dy) @ rows
            gradient[band.points, 1] = np.einsum("nw,nw->n", taps, band.across)
        return gradient / self._sigma_sq
