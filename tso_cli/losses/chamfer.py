"""Chamfer distance from a cloud to its own start: the regulariser d(y, y^) of Eq. 7."""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array
from ..geometry.points import quantile
from ..kernels.dispatch import use_compiled
from .nearest import nearest, nearest_few


class ChamferToStart:
    """Chamfer distance between a cloud [N, 3] and the same cloud after its points have moved.

    Squared distances, mean over points, summed over both directions. A point that has moved by less
    than half the distance from its start to the next start is nearest to its own start, so most
    points need no search. The compiled loops search around each point, as far as its neighbour of
    the last call.
    """

    def __init__(self, initial: Array) -> None:
        self.initial = initial
        self._grid = _Grid(initial) if use_compiled() else None
        self._spacing = spacings(initial) if self._grid is None else None

    def __call__(self, points: Array) -> tuple[float, Array]:
        """The distance, and its gradient [N, 3] by ``points`` [N, 3]."""
        if self._grid is not None:
            return self._grid.chamfer(points)
        initial, spacing, own = self.initial, self._spacing, np.arange(len(points))
        shift = np.sqrt(np.square(points - initial).sum(1))
        to_start, to_moved = own.copy(), own.copy()
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


class _Grid:
    """The cells that the points are sorted into, and the points' neighbours of the last call."""

    def __init__(self, initial: Array) -> None:
        from ..kernels.points_numba import sort_into_grid

        # The grid spans 98 % of the points: outliers would make its cells too large for the other
        # points. Points outside the grid belong to its outermost cells.
        low, high = quantile(initial, 0.01), quantile(initial, 0.99)
        extent = np.maximum(high - low, np.max(high - low) * 1e-2 + 1e-30)
        # A surface leaves most cells of a grid empty, so there are four cells for a point.
        edge = float(np.cbrt(extent.prod() / (4.0 * len(initial))))
        sides = np.ceil(extent / edge).astype(np.int64)
        self._cells, self._start = (low, 1.0 / edge, sides), np.ascontiguousarray(initial)
        self._sorted = sort_into_grid(self._start, *self._cells)
        self._to_start, self._to_moved = np.arange(len(initial)), np.arange(len(initial))

    def chamfer(self, points: Array) -> tuple[float, Array]:
        from ..kernels.points_numba import chamfer, nearest_in_grid, sort_into_grid

        points, gradient = np.ascontiguousarray(points), np.empty_like(points)
        nearest_in_grid(points, self._start, self._sorted, *self._cells, self._to_start)
        nearest_in_grid(
            self._start, points, sort_into_grid(points, *self._cells), *self._cells, self._to_moved
        )
        value: float = chamfer(self._start, points, self._to_start, self._to_moved, gradient)
        return value, gradient


def spacings(points: Array) -> Array:
    """[N] distance from each point to the nearest other point; infinite for a single point."""
    if len(points) == 1:
        return np.full(1, np.inf)
    two = nearest_few(points, points, 2)
    # Of two points at the same place either may come first.
    other = np.where(two[:, 0] == np.arange(len(points)), two[:, 1], two[:, 0])
    spacing: Array = np.sqrt(np.square(points - points[other]).sum(1))
    return spacing
