"""Control points of a cloud: an evenly spread subset that moves by itself; all others follow."""

from __future__ import annotations

import numpy as np

from ..evaluation.footprint import Solid
from ..geometry.arrays import Array, Bits
from ..losses.nearest import nearest_few
from .interpolation import INTERPOLATED_FROM, falling_weights
from .outliers import spread_over_surfaces

# Points that are interpolated at once; bounds memory.
INTERPOLATED_AT_ONCE = 1 << 16


class Subset:
    """At most ``most`` points of a cloud (None: all of them), by farthest-point sampling.

    A mask resolves hardly more of a surface than 1,024 points: with all points the results are
    about as accurate, and take longer.

    Attributes
    ----------
    control_points : [S, 3], in the unit of the cloud.

    Parameters
    ----------
    inliers : [V], points that are measured and may be control points.
    followers : [V], further points, which are not measured and follow the control points.
    """

    def __init__(
        self, points: Array, inliers: Bits, most: int | None, followers: Bits | None = None
    ) -> None:
        self._all_inliers, self._inliers = bool(inliers.all()), inliers
        self._followers = None if followers is None or not followers.any() else followers
        self._all_points = points
        self._points = self.measured(points)
        count = len(self._points) if most is None else min(most, len(self._points))
        self._chosen = (
            spread_over_surfaces(self._points, count) if count < len(self._points) else slice(None)
        )
        self.control_points: Array = self._points[self._chosen]

    @property
    def partial(self) -> bool:
        """Whether there are points that follow control points."""
        return len(self.control_points) < len(self._points)

    def at_control_points(self, values: Array) -> Array:
        """[S, C], the ``values`` [V, C] of the control points."""
        return self.measured(values)[self._chosen]

    def measured(self, values: Array) -> Array:
        """[M, C], the ``values`` [V, C] of all points but outliers."""
        return values if self._all_inliers else values[self._inliers]

    def solid(self, values: Array) -> Solid:
        """The points that are measured, at ``values`` [V, 3]."""
        return Solid(self.measured(values))

    def follow(self, displacements: Array) -> Array:
        """Displacements [V, 3] of all points by those of the control points [S, 3].

        A point takes the weighted mean of its nearest control points, as it would take the mean of
        a field's nodes. Outliers stay.
        """
        of_all = np.zeros((len(self._inliers), 3))
        if not displacements.any():
            return of_all
        of_points = np.empty_like(self._points)
        if self.partial:
            of_points = self._interpolated(self._points, displacements)
        of_points[self._chosen] = displacements
        of_all[self._inliers] = of_points
        if self._followers is not None:
            further = self._all_points[self._followers]
            of_all[self._followers] = self._interpolated(further, displacements)
        return of_all

    def _interpolated(self, points: Array, displacements: Array) -> Array:
        """Displacements of ``points`` [M, 3]: means of the nearest control points'."""
        moved = np.empty_like(points)
        count = min(INTERPOLATED_FROM, len(self.control_points))
        for start in range(0, len(points), INTERPOLATED_AT_ONCE):
            part = slice(start, start + INTERPOLATED_AT_ONCE)
            block = points[part]
            near = nearest_few(block, self.control_points, count)
            squared = np.square(block[:, None] - self.control_points[near]).sum(2)
            weights = falling_weights(np.sqrt(squared))
            moved[part] = (weights[..., None] * displacements[near]).sum(1)
        return moved
