"""Chamfer distance from a cloud to its own start: the regulariser d(y, y^) of Eq. 7."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.points import quantile
from ..kernels.dispatch import use_compiled
from .nearest import Indices, nearest, nearest_few

Array = NDArray[np.float64]
# A surface leaves most cells of the grid empty.
CELLS_PER_POINT = 4.0


class ChamferToStart:
    """Squared distances, mean over points, both directions summed, between a cloud [N, 3] and the same cloud moved."""

    def __init__(self, initial: Array) -> None:
        self.initial = initial
        self._search = _GridSearch(initial) if use_compiled() else _ProvedSearch(initial)

    def __call__(self, points: Array) -> tuple[float, Array]:
        """The distance, and its gradient [N, 3] by ``points`` [N, 3]."""
        to_start, to_moved = self._search(points)
        ahead, back = points - self.initial[to_start], points[to_moved] - self.initial
        gradient = ahead + np.stack([np.bincount(to_moved, column, len(points)) for column in back.T], 1)
        value = (np.square(ahead).sum() + np.square(back).sum()) / len(points)
        return float(value), (2.0 / len(points)) * gradient


class _ProvedSearch:
    """Which point of the start [N] is nearest to each moved one, and the reverse [N].

    A moved point within half the distance from its start to the next one is nearest to its own start: most need no search.
    """

    def __init__(self, initial: Array) -> None:
        self._initial, self._spacing = initial, spacings(initial)

    def __call__(self, points: Array) -> tuple[Indices, Indices]:
        initial, own = self._initial, np.arange(len(points))
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
        return to_start, to_moved


class _GridSearch:
    """As `_ProvedSearch`, compiled: each point looks around itself, no further than to its neighbour of the last call."""

    def __init__(self, initial: Array) -> None:
        self._initial = np.ascontiguousarray(initial)
        # Few strays would make the cells too large for the rest. What lies outside belongs to the outermost cells.
        self._low, high = (quantile(initial, share) for share in (0.01, 0.99))
        extent = np.maximum(high - self._low, np.max(high - self._low) * 1e-2 + 1e-30)
        self._edge = float(np.cbrt(extent.prod() / (CELLS_PER_POINT * len(initial))))
        self._sides = np.ceil(extent / self._edge).astype(np.int64)
        self._to_start, self._to_moved = np.arange(len(initial)), np.arange(len(initial))

    def __call__(self, points: Array) -> tuple[Indices, Indices]:
        from ..kernels.points_numba import nearest_in_grid

        points, grid = np.ascontiguousarray(points), (self._low, self._edge, self._sides)
        nearest_in_grid(points, self._initial, *grid, self._to_start)
        nearest_in_grid(self._initial, points, *grid, self._to_moved)
        return self._to_start, self._to_moved


def spacings(points: Array) -> Array:
    """[N] distance from each point to the nearest other one; infinite for a single point."""
    if len(points) == 1:
        return np.full(1, np.inf)
    two = nearest_few(points, points, 2)
    # Of coinciding points either may come first.
    other = np.where(two[:, 0] == np.arange(len(points)), two[:, 1], two[:, 0])
    spacing: Array = np.sqrt(np.square(points - points[other]).sum(1))
    return spacing
