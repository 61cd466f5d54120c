"""Placements of a cloud that fit its masks, searched in all directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import Array, Indices
from ..geometry.points import farthest_point_sample
from ..geometry.view import View
from .levenberg import Freedom, improve
from .misfit import NearestMisfit
from .placement import Placements
from .search import TELLS_PLACE, Comparison, search_from, some_views
from .starts import closed_iou, distinct, starts
from .target import Target

# Points of a cloud that are scored in the end. Larger clouds are thinned at random before farthest
# points are chosen, to save time.
SCORED_POINTS, THINNED_POINTS = 1024, 4096


@dataclass(frozen=True)
class _Stage:
    """One of the two searches by nearest neighbours: the faster one or the finer one."""

    side: int  # of the square, cells
    points: int  # of the cloud
    kept: int  # most placements that are improved
    degrees: float  # a placement within this angle of a better one is dropped
    steps: int
    robust: float  # scale of distances, cells

    def improved(
        self,
        placements: Placements,
        score: Array,
        points: Array,
        targets: Sequence[Target],
        freedom: Freedom,
    ) -> Placements:
        """The distinct placements of the highest scores [P], drawn to the masks."""
        placements = placements[distinct(placements.R, score, self.degrees, self.kept)]
        misfit = NearestMisfit(points[: self.points], targets, self.robust)
        return improve(placements, misfit, freedom, self.steps)[0]


COARSE = _Stage(side=32, points=256, kept=48, degrees=20.0, steps=12, robust=6.0)
FINE = _Stage(side=64, points=512, kept=16, degrees=10.0, steps=20, robust=4.0)
# Views of the first search, at most: they tell directions apart, and cost time for each.
COARSE_VIEWS = 4
# Other poses of the end are this far apart, degrees.
APART = 20.0
# If none of the placements fits, this number of the best is searched around.
AROUND = 3
# Colours in [0, 1] that differ by this on average are of another side of the object.
REPAINTED = 0.1


@dataclass(frozen=True, eq=False)
class Candidates:
    """Placements that fit, best first, none within 20 degrees of a better one.

    missed : [P], as `Comparison.missed`. iou : [P], `closed_iou`.
    """

    placements: Placements
    missed: Array
    iou: Array

    def __getitem__(self, rows: Indices) -> Candidates:
        return Candidates(self.placements[rows], self.missed[rows], self.iou[rows])


def search_everywhere(
    comparison: Comparison, points: Array, views: Sequence[View], freedom: Freedom
) -> Candidates:
    """The placements that fit ``views``, from starts in all directions.

    1. 2,700 placements are scored by coarse silhouettes.
    2. The best 48 distinct ones are improved by distances between nearest neighbours.
    3. The best 16 of them are improved at twice the resolution, and then by their contours.

    ``comparison`` is of the ``points`` [N, 3] and the views.
    """
    local = spread_points(points)
    coarse = tuple(Target.of(view, COARSE.side) for view in some_views(views, COARSE_VIEWS))
    placements, score = starts(local[: COARSE.points], coarse, freedom)
    placements = COARSE.improved(placements, score, local, coarse, freedom)
    score = closed_iou(local[: FINE.points], placements, coarse, spacing(local[: FINE.points]))
    by_cells = FINE.improved(placements, score, local, comparison.targets, freedom)
    by_cells = comparison.at_depth(by_cells, freedom)
    placements, value = comparison.settled(by_cells, freedom)
    placements = placements[distinct(placements.R, -value, APART, len(placements))]
    if comparison.missed(placements[:1])[0] > TELLS_PLACE:
        placements = _searched_around(comparison, freedom, placements)
        if comparison.missed(placements[:1])[0] > TELLS_PLACE:
            # The contours of another shape do not tell where it is.
            iou = closed_iou(local, by_cells, comparison.targets, spacing(local))
            placements = by_cells[distinct(by_cells.R, iou, APART, len(by_cells))]
    iou = closed_iou(local, placements, comparison.targets, spacing(local))
    return Candidates(placements, comparison.missed(placements), iou)


def _searched_around(
    comparison: Comparison, freedom: Freedom, placements: Placements
) -> Placements:
    """The best placements, searched from many starts around each, and then the rest."""
    few = min(AROUND, len(placements))
    results = [search_from(comparison, freedom, placements[i : i + 1]) for i in range(few)]
    results.sort(key=lambda result: result.missed)
    return Placements.joined([*(result.placement for result in results), placements[few:]])


def spread_indices(points: Array) -> Indices:
    """Indices of at most 1,024 of ``points``; for every k the first k of them are spread evenly."""
    index = np.arange(len(points))
    if len(points) > THINNED_POINTS:
        index = np.random.default_rng(0).permutation(len(points))[:THINNED_POINTS]
    return index[farthest_point_sample(points[index], min(SCORED_POINTS, len(index)))]


def spread_points(points: Array) -> Array:
    """The points of `spread_indices`."""
    return points[spread_indices(points)]


def spacing(points: Array) -> float:
    """Median distance from a point to its nearest neighbour."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(points).query(points, 2)
    return float(np.median(distance[:, 1]))


def unlike_first(points: Array, R: Array, colours: Array | None = None) -> list[int]:
    """Indices of the rotations ``R`` [P, 3, 3] that no symmetry of the cloud makes of the first."""
    gap, others = spacing(points), range(1, len(R))
    return [i for i in others if not same_by_symmetry(points, R[0], R[i], gap, colours)]


def same_by_symmetry(
    points: Array, first: Array, second: Array, spacing: float, colours: Array | None = None
) -> bool:
    """Whether the cloud looks the same to cameras with the rotations ``first`` and ``second``.

    Rotated by the difference of the two rotations it then coincides with itself to within its
    spacing, and so do its ``colours`` [N, 3], in [0, 1].
    """
    from scipy.spatial import cKDTree

    # The axis of a symmetry goes through the mean of the points.
    points = points - points.mean(0)
    turned = points @ (first.T @ second)
    forward, nearest = cKDTree(points).query(turned)
    backward, _ = cKDTree(turned).query(points)
    if colours is not None and np.abs(colours[nearest] - colours).mean() > REPAINTED:
        return False
    return bool(max(np.square(forward).mean(), np.square(backward).mean()) < spacing**2)
