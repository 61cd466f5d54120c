"""Large clouds: some of their points move, and all others follow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..losses.nearest import nearest_few
from ..optimisation.presets import FIELD_NODES
from .outliers import spread_on_surfaces
from .smooth_field import INTERPOLATED_FROM, falling_weights

Array = NDArray[np.float64]

# Points carried at once; bounds memory.
CARRIED_AT_ONCE = 1 << 16


class Subset:
    """At most ``most`` points of a cloud (None: all), by farthest-point sampling; few that lie apart.

    A mask resolves hardly more of a surface: with all points the results are about as accurate, and take longer.

    Attributes
    ----------
    kept : [V] bool, the points that count; the others stay where they are, and nothing depends on them.
    samples : [S, 3], in the unit of the cloud.
    """

    def __init__(
        self, points: Array, kept: NDArray[np.bool_], most: int | None = FIELD_NODES
    ) -> None:
        self._given, self.kept = points, kept
        self._inliers = self.judged(points)
        count = len(self._inliers) if most is None else most
        self._chosen = (
            spread_on_surfaces(self._inliers, count) if count < len(self._inliers) else slice(None)
        )
        self.samples: Array = self._inliers[self._chosen]

    def with_samples(self, most: int | None) -> Subset:
        """The same cloud with at most ``most`` samples, None for all points. Itself if the number stays."""
        count = len(self._inliers) if most is None else min(most, len(self._inliers))
        return self if count == len(self.samples) else Subset(self._given, self.kept, most)

    @property
    def partial(self) -> bool:
        """Whether points follow."""
        return len(self.samples) < len(self._inliers)

    def at(self, values: Array) -> Array:
        """[S, C], values [V, C] of the samples."""
        return self.judged(values)[self._chosen]

    def judged(self, values: Array) -> Array:
        """[J, C], values [V, C] of all points that count."""
        return values if self.kept.all() else values[self.kept]

    def followed(self, displacements: Array) -> Array:
        """Displacements [V, 3] of all points from those of the samples [S, 3].

        A point between samples takes the weighted mean of the nearest of them, as it would of a field's nodes.
        """
        of_inliers = np.empty_like(self._inliers)
        if self.partial:
            count = min(INTERPOLATED_FROM, len(self.samples))
            for start in range(0, len(of_inliers), CARRIED_AT_ONCE):
                part = slice(start, start + CARRIED_AT_ONCE)
                points = self._inliers[part]
                near = nearest_few(points, self.samples, count)
                weights = falling_weights(
                    np.sqrt(np.square(points[:, None] - self.samples[near]).sum(2))
                )
                of_inliers[part] = (weights[..., None] * displacements[near]).sum(1)
        of_inliers[self._chosen] = displacements
        of_all = np.zeros((len(self.kept), 3))
        of_all[self.kept] = of_inliers
        return of_all
