"""Chamfer distance from a cloud to its own start: the regulariser d(y, y^) of Eq. 7."""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array
from .nearest import nearest, nearest_few


class ChamferToStart:
    """Chamfer distance between a cloud [N, 3] and the same cloud after its points have moved.

    Squared distances, mean over points, summed over both directions. A point that has moved by less
    than half the distance from its start to the next start is nearest to its own start, so most
    points need no search.
    """

    def __init__(self, initial: Array) -> None:
        self.initial = initial
        self._spacing = spacings(initial)

    def __call__(self, points: Array) -> tuple[float, Array]:
        """The distance, and its gradient [N, 3] by ``points`` [N, 3]."""
        initial, spacing, numbers = self.initial, self._spacing, np.arange(len(points))
        shift = np.sqrt(np.square(points - initial).sum(1))
        to_start, to_moved = numbers.copy(), numbers.copy()
        # |m_i - s_j| >= |s_i - s_j| - |m_i - s_i|
        far = ~(2.0 * shift <= spacing)
        if far.any():
            to_start[far] = nearest(points[far], initial)
        # |s_i - m_j| >= |s_i - s_j| - |m_j - s_j|
        far = ~(shift + shift.max() <= spacing)
        if far.any():
            to_moved[far] = nearest(initial[far], points)
        ahead, back = points - initial[to_start], points[to_moved] - initial
        gradient = ahead + np.stack(
            [np.bincount(to_moved, column, len(points)) for column in back.T], 1
        )
        value = (np.square(ahead).sum() + np.square(back).sum()) / len(points)
        return float(value), (2.0 / len(points)) * gradient


def spacings(points: Array) -> Array:
    """[N] distance from each point to the nearest other point; infinite for a single point."""
    if len(points) == 1:
        return np.full(1, np.inf)
    two = nearest_few(points, points, 2)
    # Of two points at the same place either may come first.
    other = np.where(two[:, 0] == np.arange(len(points)), two[:, 1], two[:, 0])
    spacing: Array = np.sqrt(np.square(points - points[other]).sum(1))
    return spacing
