"""The measures of a chair. Lengths in metres, floor at y = 0, seat above the origin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .parts import Array


@dataclass(frozen=True)
class Frame:
    """Measures of a chair in metres.

    width, depth, height, thick : of the seat; ``height`` is that of its upper face above the floor.
    back_height : of the back above the seat. lean : its slope, metres backward for each metre up; bend : how much the slope
    grows toward the top. wrap : how far its edges come forward. back_width, flare : width of the back at the seat as a share of
    the seat's, and how much wider it is at the top. square : power of the seat's outline, 2 round to 30 square, see `oval`.
    """

    width: float
    depth: float
    height: float
    thick: float
    back_height: float
    lean: float = 0.1
    bend: float = 0.0
    wrap: float = 0.0
    back_width: float = 1.0
    flare: float = 0.0
    square: float = 30.0

    @property
    def corner(self) -> float:
        """Where the outline's corners lie as a share of half the width and depth: 1 square, 0.71 round."""
        return float(2.0 ** (-1.0 / self.square))

    def back(self, u: Array | float, v: Array | float) -> Array:
        """Points [..., 3] of the back: u from -1 (left) to 1, v from 0 (seat) to 1 (top)."""
        across, up = np.broadcast_arrays(np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64))
        x = across * self.width / 2.0 * self.back_width * min(1.0, 1.12 * self.corner) * (1.0 + self.flare * up)
        behind = (self.lean + self.bend * up) * up * self.back_height
        # The back follows the rear edge of a round seat.
        round_ = (1.0 - self.corner) * self.depth / 2.0
        z = -self.depth / 2.0 + 0.015 - behind + self.wrap * (across**2 - 1.0) + round_ * across**2
        return np.stack([x, self.height + up * self.back_height, z], axis=-1)
