"""Lens distortion, and pictures without it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .arrays import Array, Bits

# Radii at which a lens is looked at, in focal lengths: up to 84 degrees from the axis.
FARTHEST, STEPS = 10.0, 4001
ROWS_AT_ONCE = 256
"""Rows of a picture that are resampled at once; it bounds the memory."""


@dataclass(frozen=True)
class Distortion:
    """A lens that displaces the points of the picture.

    model : "radial-tangential" is OpenCV's: k1, k2, p1, p2, k3, k4, k5, k6 (missing ones are 0).
        "equidistant" is its fisheye model: k1, k2, k3, k4.
    """

    model: Literal["radial-tangential", "equidistant"]
    coefficients: tuple[float, ...]

    @property
    def none(self) -> bool:
        """Whether this is a lens without distortion; a fisheye always distorts."""
        return self.model == "radial-tangential" and not any(self.coefficients)

    def reach(self) -> float:
        """The radius up to which a larger radius is shown farther out.

        Beyond it the polynomial turns back, and would show the middle of the picture a second time.
        """
        radius = np.linspace(0.0, FARTHEST, STEPS)
        radial = Distortion(self.model, self._radial())
        distorted_radius, _ = radial.distorted(radius, np.zeros_like(radius))
        turns = np.flatnonzero(~(np.diff(distorted_radius) > 0.0))
        return float(radius[turns[0]]) if len(turns) else np.inf

    def _radial(self) -> tuple[float, ...]:
        """The coefficients without tangential ones."""
        if self.model == "equidistant":
            return self.coefficients
        k1, k2, _, _, *rest = (*self.coefficients, *[0.0] * 8)[:8]
        return (k1, k2, 0.0, 0.0, *rest)

    def distorted(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Where the lens shows the points (x, y) = (X / Z, Y / Z)."""
        squared = x * x + y * y
        if self.model == "equidistant":
            k1, k2, k3, k4 = (*self.coefficients, 0.0, 0.0, 0.0, 0.0)[:4]
            radius = np.sqrt(squared)
            theta = np.arctan(radius)
            s = theta * theta
            bent = theta * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
            scale = np.where(radius > 1e-12, bent / np.maximum(radius, 1e-12), 1.0)
            return x * scale, y * scale
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.coefficients, *[0.0] * 8)[:8]
        radial = 1.0 + squared * (k1 + squared * (k2 + squared * k3))
        radial = radial / (1.0 + squared * (k4 + squared * (k5 + squared * k6)))
        return (
            x * radial + 2.0 * p1 * x * y + p2 * (squared + 2.0 * x * x),
            y * radial + p1 * (squared + 2.0 * y * y) + 2.0 * p2 * x * y,
        )


def undistorted(
    picture: NDArray[np.generic], K: Array, distortion: Distortion, nearest: bool = False
) -> tuple[NDArray[np.generic], Bits]:
    """The ``picture`` [H, W] or [H, W, C] that a camera with ``K`` and no distortion would show.

    The size stays. Values are interpolated bilinearly, or taken from the ``nearest`` pixel. The
    second result [H, W] is False where the distorted picture shows nothing.
    """
    height, width = picture.shape[:2]
    channels = picture.reshape(height, width, -1)
    out = np.zeros_like(channels, dtype=picture.dtype if nearest else np.float64)
    inside = np.zeros((height, width), dtype=bool)
    columns = np.arange(width, dtype=np.float64)
    reach = distortion.reach()
    for start in range(0, height, ROWS_AT_ONCE):
        rows = np.arange(start, min(start + ROWS_AT_ONCE, height))
        v = np.broadcast_to(rows[:, None].astype(np.float64), (len(rows), width))
        y = (v - K[1, 2]) / K[1, 1]
        x = (columns - K[0, 2] - K[0, 1] * y) / K[0, 0]
        x, y = distortion.distorted(x, y)
        u = K[0, 0] * x + K[0, 1] * y + K[0, 2]
        v = K[1, 1] * y + K[1, 2]
        in_picture = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
        x, y = (columns - K[0, 2]) / K[0, 0], (rows[:, None] - K[1, 2]) / K[1, 1]
        in_picture &= np.hypot(x, y) < reach
        inside[rows] = in_picture
        out[rows] = _sampled(
            channels, np.where(in_picture, u, 0.0), np.where(in_picture, v, 0.0), nearest
        )
    return out.reshape(picture.shape), inside


def _sampled(
    channels: NDArray[np.generic], u: Array, v: Array, nearest: bool
) -> NDArray[np.generic]:
    """``channels`` [H, W, C] at columns ``u`` and rows ``v`` [h, W]."""
    height, width = channels.shape[:2]
    if nearest:
        return channels[np.rint(v).astype(int), np.rint(u).astype(int)]
    u, v = u.clip(0.0, width - 1.0), v.clip(0.0, height - 1.0)
    left, top = (np.floor(value).astype(int) for value in (u, v))
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    across, down = (u - left)[..., None], (v - top)[..., None]
    upper = channels[top, left] * (1.0 - across) + channels[top, right] * across
    lower = channels[below, left] * (1.0 - across) + channels[below, right] * across
    mixed: NDArray[np.generic] = upper * (1.0 - down) + lower * down
    return mixed
