"""Chamfer distance from a cloud to its own start: the regulariser d(y, y^) of Eq. 7."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .nearest import nearest, nearest_few

Array = NDArray[np.float64]


class ChamferToStart:
    """Squared distances, mean over points, both directions summed, between a cloud [N, 3] and the same cloud moved.

    A moved point within half the distance from its start to the next one is nearest to its own start: most need no search.
    """

    def __init__(self, initial: Array) -> None:
        self.initial, self._spacing = initial, spacings(initial)

    def __call__(self, points: Array) -> tuple[float, Array]:
        """The distance, and its gradient [N, 3] by ``points`` [N, 3]."""
        initial, own = self.initial, np.arange(len(points))
        shift = np.sqrt(np.square(points - initial).sum(1))
        to_start, to_moved = own.copy(), own.copy()
        # |m_i - s_j| >= |s_i - s_j| - |m_i - s_i|
        far = ~(2.0 * shift <= self._spacing)
        if far.any():
            to_start[far] = nearest(points[far], initial)
        # |s_i - m_j| >= |s_i - s_j| - |m_j - s_j|
        far = ~(shift + shift.max() <= self._spacing)
        if far.any():
            to_moved[far] = nearest(initial[far], points)
        ahead, back = points - initial[to_start], points[to_moved] - initial
        gradient = ahead.copy()
        np.add.at(gradient, to_moved, back)
        value = (np.square(ahead).sum() + np.square(back).sum()) / len(points)
        return float(value), (2.0 / len(points)) * gradient


def spacings(points: Array) -> Array:
    """[N] distance from each point to the nearest other one; infinite for a single point."""
    if len(points) == 1:
        return np.full(1, np.inf)
    two = nearest_few(points, points, 2)
    # Of coinciding points either may come first.
    other = np.where(two[:, 0] == np.arange(len(points)), two[:, 1], two[:, 0])
    spacing: Array = np.sqrt(np.square(points - points[other]).sum(1))
    return spacing
