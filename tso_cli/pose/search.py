"""The placement of a cloud that fits its masks best, searched from a given one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from ..geometry.arrays import Array
from ..geometry.points import scattered
from ..geometry.rotations import lattice
from ..geometry.view import View
from .levenberg import Freedom, Misfit, improve
from .misfit import Contour, ContourMisfit, DepthMisfit, DepthSurface, NearestMisfit
from .placement import GROWTH, SIZE, TURN, UNKNOWNS, Placements
from .target import Part, Target

# Side of the square in which cloud and mask are compared, in cells.
SIDE = 64
# Points that approach a mask from afar, and points whose edge is compared with its contour.
COARSE_POINTS, FINE_POINTS = 512, 4096
# Steps of one descent: more find no more of the clouds that were turned by 6 to 40 degrees.
STEPS = 8
# Scales of gaps, in cells, from which contours draw a cloud: from afar, then nearer and nearer.
FROM_AFAR, NEARER, EXACT = 4.0, 1.5, 0.6
# How exactly a sparse cloud shows its edge, in cells, up to `NEARER`: this times the cells of the
# object a point. Of exact clouds with 700 points 90 of 100 then fit their masks, and 50 without it.
OF_SPARSE = 0.7
# The least scale of distances to a depth map, in cells. Depth maps are less exact than masks.
LEAST_OF_DEPTH = 1.0
# A point this many cells from a contour, in such scales, belongs to no piece of it.
REACH = 3.5
LEAST_REACH = 4.0

# A placement that misses less than this share of the contours fits them, as that of the right shape
# does. On validation shapes 95 % of exact clouds miss less at last, and 3 % of other shapes.
EXPLAINED = 0.2
# A move explains the misfit if it also leaves less than this share of what the given placement
# misses.
LEFT = 0.3
# The contours of a cloud that misses more than this do not tell where it is.
TELLS_PLACE = 0.3
# Of several placements, the best is sure if it explains the misfit, and every other one misses more
# by at least this share of the contours.
SURE_GAP = 0.1
# A gain of the posterior (minus twice its logarithm) that chance does not make. On validation
# shapes 95 % of exact clouds in their right place gain less, and of those turned by 3 degrees more.
SIGNIFICANT = 7.0
# Starts around a given pose: rotations by this angle about axes in all directions. Those that fit
# best from afar are followed.
NEAR_TURNS, NEAR_DEGREES, NEAR_STARTS = 6, 12.0, 5

# The deviation of an angle that nothing determines, radians.
NOTHING_KNOWN = np.pi / np.sqrt(3.0)

Item = TypeVar("Item")


def some_views(views: Sequence[Item], most: int) -> Sequence[Item]:
    """At most ``most`` of the views, evenly chosen."""
    return views[:: -(-len(views) // most)]


@dataclass(frozen=True, eq=False)
class Comparison:
    """A cloud and the views that it is placed before.

    points : [N, 3] of a cloud of longest side 1 with its centre at the origin, in random order.
    """

    points: Array
    targets: tuple[Target, ...]
    contours: tuple[Contour, ...]
    surfaces: tuple[DepthSurface, ...]  # of the views with a depth map

    @cached_property
    def outline(self) -> float:
        """How exactly masks and cloud show where their contours are, in cells."""
        cells = max(len(target.cells) for target in self.targets)
        of_cloud = min(OF_SPARSE * cells / len(self.points), NEARER)
        return max(EXACT, of_cloud, *(target.error for target in self.targets))

    @classmethod
    def of(
        cls, points: Array, views: Sequence[View], parts: Sequence[Part | None] = ()
    ) -> Comparison:
        """``parts`` : what of each view counts; all of it by default."""
        pairs = zip(views, parts or [None] * len(views), strict=True)
        targets = tuple(Target.of(view, SIDE, part) for view, part in pairs)
        surfaces = [DepthSurface.of(target) for target in targets if target.depth is not None]
        smooth = tuple(surface for surface in surfaces if surface.blocks)
        return cls(_mixed(points), targets, tuple(map(Contour.of, targets)), smooth)

    def of_cloud(self, points: Array) -> Comparison:
        """Of other ``points`` [N, 3] before the same views."""
        return replace(self, points=_mixed(points))

    @property
    def cells(self) -> NearestMisfit:
        """Of a cloud whose shape may be wrong: distances between points and all cells."""
        return NearestMisfit(self.points[:COARSE_POINTS], self.targets)

    def contour(self, scale: float) -> ContourMisfit:
        """Of the edge of the cloud and the contours."""
        return ContourMisfit(self.points, self.contours, scale, max(REACH * scale, LEAST_REACH))

    def exact(self, scale: float) -> Misfit:
        """Of the edge of the cloud and the contours, and of its visible side and depth maps."""
        contour = self.contour(scale)
        if not self.surfaces:
            return contour
        depth = DepthMisfit(self.points, self.surfaces, max(scale, LEAST_OF_DEPTH))
        return lambda placements: contour(placements) + depth(placements)

    def settled(
        self, placements: Placements, freedom: Freedom, from_afar: bool = False
    ) -> tuple[Placements, Array]:
        """The placements as the contours and depth maps draw them, and their posteriors [P]."""
        scales = max(NEARER, self.outline), self.outline
        for scale in (FROM_AFAR, *scales) if from_afar else scales:
            placements, value = improve(placements, self.exact(scale), freedom, STEPS)
        return placements, value

    def covariance(self, placement: Placements, freedom: Freedom) -> Array:
        """[17, 17], of the unknowns that are free at the one ``placement``, whatever was given.

        Each contour and each depth map has `levenberg.INDEPENDENT` residuals of one variance, and
        the contours may lie as far out as masks and cloud leave open.
        """
        parts = len(self.contours) + len(self.surfaces)
        unprejudiced = replace(freedom, deviation=np.full(UNKNOWNS, np.inf))
        normal = parts * unprejudiced.posterior(self.exact(self.outline))(placement).normal[0]
        pixel = float(np.mean([target.pixel for target in self.targets]))
        normal[GROWTH, GROWTH] += (pixel / self.outline) ** 2
        basis = np.column_stack([freedom.basis, np.eye(UNKNOWNS)[:, GROWTH]])
        least = np.eye(basis.shape[1]) / NOTHING_KNOWN**2
        covariance: Array = basis @ np.linalg.inv(basis.T @ normal @ basis + least) @ basis.T
        return covariance

    def at_depth(self, placements: Placements, freedom: Freedom) -> Placements:
        """The placements, scaled about the camera to the distance that its depth map shows.

        The silhouette in this camera stays. Nothing changes without a depth map, or if the size is
        not free.
        """
        if not self.surfaces or not freedom.basis[SIZE].any():
            return placements
        factor = self.surfaces[0].farther(self.points, placements)
        return placements.scaled_about(self.surfaces[0].target.camera.position, factor)

    def by_cells(self, placements: Placements, freedom: Freedom) -> Placements:
        """The placements as all cells of the masks draw them."""
        return improve(placements, self.cells, freedom, STEPS)[0]

    def missed(self, placements: Placements) -> Array:
        """[P] the share of the contours that a cloud of infinitely many points would miss."""
        return self.contour(self.outline).missed(placements)

    @cached_property
    def missed_unmoved(self) -> float:
        """The share that the cloud misses where it is."""
        return float(self.missed(Placements.unmoved())[0])


def _mixed(points: Array) -> Array:
    """Some of the ``points`` [N, 3], in random order."""
    points = scattered(points, FINE_POINTS)
    return points[np.random.default_rng(0).permutation(len(points))]


@dataclass(frozen=True, eq=False)
class SearchResult:
    """One placement.

    missed_before, missed : the share of the contours that the cloud misses where it was given, and
        here.
    """

    placement: Placements
    missed_before: float
    missed: float

    @property
    def fits(self) -> bool:
        """Whether a cloud of this shape is right here."""
        return self.missed < TELLS_PLACE

    @property
    def explains(self) -> bool:
        """Whether the placement explains why the cloud did not fit."""
        return self.missed < min(EXPLAINED, LEFT * self.missed_before)


def search_from(
    comparison: Comparison,
    freedom: Freedom,
    start: Placements | None = None,
    by_cells: Placements | None = None,
) -> SearchResult:
    """The placement near ``start`` of the best posterior.

    ``start`` is the given one by default, which the prior and ``missed_before`` are of in any case.
    ``by_cells`` : the start as the cells draw it.
    """
    start = freedom.given if start is None else start
    by_cells = comparison.by_cells(start, freedom) if by_cells is None else by_cells
    step = np.zeros((1 + NEAR_TURNS, UNKNOWNS))
    step[1:, TURN] = np.radians(NEAR_DEGREES) * lattice(NEAR_TURNS)
    turned = start[np.zeros(len(step), np.int64)].stepped(step)
    from_afar, values = improve(turned, comparison.exact(FROM_AFAR), freedom, STEPS)
    starts = [start, from_afar[np.argsort(values)[:NEAR_STARTS]], by_cells]
    if comparison.surfaces:
        starts.append(comparison.at_depth(by_cells, freedom))
    placements, values = comparison.settled(Placements.joined(starts), freedom)
    best = placements[np.array([values.argmin()])]
    before, after = comparison.missed(Placements.joined([freedom.given, best]))
    return SearchResult(best, float(before), float(after))


def place_from(comparison: Comparison, freedom: Freedom) -> SearchResult:
    """The placement near the given one where a cloud of any shape belongs.

    A cloud that fits where it was given stays there, unless the posterior gains enough. Contours
    place a cloud of the right shape exactly, and one of a wrong shape anywhere. So a cloud that
    does not fit in the end stands where all cells of the masks would have it.
    """
    by_cells = comparison.by_cells(freedom.given, freedom)
    result = search_from(comparison, freedom, by_cells=by_cells)
    before = result.missed_before
    if before < TELLS_PLACE:
        posterior = freedom.posterior(comparison.exact(comparison.outline))
        if posterior(freedom.given).value - posterior(result.placement).value < SIGNIFICANT:
            return SearchResult(freedom.given, before, before)
    if result.fits:
        return result
    return SearchResult(by_cells, before, float(comparison.missed(by_cells)[0]))
