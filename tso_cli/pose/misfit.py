"""How far a placed cloud is from masks and depth maps, in cells, with derivatives.

Three misfits: of distances between nearest neighbours, which draws a cloud from afar; of the gaps
between the edge of the cloud and the contour of the mask, which is exact where the two nearly meet;
and of the distances from the visible side of the cloud to the surface of a depth map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry.arrays import Array, Bits, Indices
from ..geometry.points import scattered
from ..geometry.resampling import blurred
from .levenberg import System
from .placement import GROWTH, UNKNOWNS, Placements
from .target import ProjectedCloud, Target

# Distances under half a cell are inside a cell and count as 0.
TOLERANCE = 0.5
# Cells of the object that attract points; more tell no more.
MOST_CELLS = 400
# Where a contour is that nothing is known of: no point is near.
FAR = 1e6
# Cells across the block whose foremost point is on the visible side. With fewer, points of the far
# side show through the gaps of clouds of 1,000 points.
BLOCK = 3
# Where the surface is this many cells deeper from one cell to the next, it ends there.
STEEPEST = 3.0


@dataclass(frozen=True, eq=False)
class NearestMisfit:
    """Each cell of the object attracts the nearest point, and the nearest cell each point outside.

    ``robust`` : scale in cells; a distance d counts as d^2 / (1 + (d / robust)^2).
    """

    points: Array  # [N, 3]
    targets: Sequence[Target]
    robust: float = 6.0

    def __call__(self, placements: Placements) -> System:
        """Mean squares of both directions, summed over views."""
        systems = (self._of(target, placements) for target in self.targets)
        return sum(systems, System.empty(len(placements)))

    def _of(self, target: Target, placements: Placements) -> System:
        count, system = len(self.points), System.empty(len(placements))
        projected = target.project(self.points, placements)
        rows, px = np.arange(len(placements))[:, None], projected.px
        cells = scattered(target.cells, MOST_CELLS)
        # The nearest point to each cell, [P, M].
        cells32, px32 = cells.astype(np.float32), px.astype(np.float32)
        squared = px32 @ (-2.0 * cells32.T) + np.square(px32).sum(2)[..., None]
        to_point = np.asarray(squared.argmin(1))
        row, column, within = target.at(px)
        known = np.where(within, target.known[row, column], not target.truncated)
        outside = known & ~(target.inside[row, column] & within)
        all_points = np.broadcast_to(np.arange(count), outside.shape)
        pairs = (
            (to_point, cells - px[rows, to_point], 1.0 / len(cells)),
            (all_points, target.nearest[row, column] - px, outside / count),
        )
        for index, offset, weight in pairs:
            distance = np.linalg.norm(offset, axis=2)
            beyond = np.maximum(1.0 - TOLERANCE / np.maximum(distance, TOLERANCE), 0.0)
            excess = distance * beyond
            inlier = 1.0 / (1.0 + np.square(excess / self.robust))
            system.value[:] += (weight * excess**2 * inlier).sum(1)
            root = np.sqrt(weight * (excess > 0.0)) * inlier
            J = projected.jacobian(rows, index) * root[..., None, None]
            J = J.reshape(len(placements), -1, UNKNOWNS)
            residual = (offset * (beyond * root)[..., None]).reshape(len(placements), -1, 1)
            system.normal[:] += J.transpose(0, 2, 1) @ J
            system.gradient[:] += (J.transpose(0, 2, 1) @ residual)[..., 0]
        return system


def share_missed(placement: Indices, gap: Array, J: Array, count: int, pieces: int) -> System:
    """The sum over ``pieces``. A gap ``g`` counts as g^2 / (1 + g^2), a piece without one as 1.

    gap : [G]. placement : [G], ascending, of each gap. J : [G, 17], derivative of what closes it.
    """
    system = System.empty(count)
    inlier = 1.0 / (1.0 + np.square(gap))
    weighted = J * np.square(inlier)[:, None]
    ends = np.searchsorted(placement, np.arange(count + 1))
    for number, rows in enumerate(map(slice, ends[:-1], ends[1:])):
        system.value[number] = (gap[rows] ** 2 * inlier[rows]).sum() + pieces - len(gap[rows])
        system.normal[number] = weighted[rows].T @ J[rows]
        system.gradient[number] = weighted[rows].T @ gap[rows]
    return system


@dataclass(frozen=True, eq=False)
class Contour:
    """The contour of a mask between its cells, cut into pieces."""

    target: Target
    samples: Array  # [C, 2] column and row
    normals: Array  # [C, 2] outward
    piece: Indices  # [C] the piece of each sample
    pieces: int

    # Standard deviation of the blur that smooths the contour, and the length of a piece, in cells.
    BLUR, LENGTH = 0.4, 2.0

    @classmethod
    def of(cls, target: Target) -> Contour:
        smooth = blurred(target.mask, cls.BLUR)
        if not target.known.all():
            # Means over what is known: the object does not end where the knowledge ends.
            share = blurred(np.float64(target.known), cls.BLUR)
            smooth = blurred(target.mask * target.known, cls.BLUR) / np.maximum(share, 1e-9)
        down, right = (np.gradient(smooth, axis=axis) for axis in (0, 1))
        level = 0.5 * target.mask.max()
        samples = []
        # Where the blurred mask crosses half between two cells in a row, and in a column.
        for values, turned in ((smooth, False), (smooth.T, True)):
            first, second = values[:, :-1] - level, values[:, 1:] - level
            row, column = np.nonzero((first > 0.0) != (second > 0.0))
            part = first[row, column] / (first[row, column] - second[row, column])
            place = np.stack([column + part, row], 1)
            samples.append(place[:, ::-1] if turned else place)
        where = np.concatenate(samples)
        row, column, _ = target.at(where)
        known = target.known[row, column]
        where, row, column = where[known], row[known], column[known]
        if not len(where):
            # Nothing is known of the contour: a single piece that no point is near.
            return cls(target, np.full((1, 2), FAR), np.zeros((1, 2)), np.zeros(1, np.int64), 1)
        slope = np.stack([right[row, column], down[row, column]], 1)
        normals = -slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9)
        # The two sides of a thin part are different pieces of one block of cells.
        block = (where / cls.LENGTH).astype(np.int64)
        side = (normals[:, 0] > 0.0) + 2 * (normals[:, 1] > 0.0)
        key = (block[:, 1] * target.side + block[:, 0]) * 4 + side
        names, piece = np.unique(key, return_inverse=True)
        return cls(target, where, normals, piece.ravel(), len(names))

    @cached_property
    def index(self) -> Indices:
        """[S, S], the nearest sample of each cell."""
        shape, where = self.target.mask.shape, self.samples.astype(np.float32)
        grid = np.indices(shape, np.float32)[::-1].reshape(2, -1).T
        nearest = (np.square(where).sum(1) - grid @ (2.0 * where.T)).argmin(1)
        return np.asarray(nearest.reshape(shape))


@dataclass(frozen=True, eq=False)
class ContourMisfit:
    """The gap between each piece of the contours and the outermost point near it.

    A gap e, in cells along the normal of the contour, counts as g^2 / (1 + g^2) with g = e /
    ``robust``, and a piece without a point within ``reach`` cells counts as 1. So the misfit is
    about the share of the contours that the cloud misses.
    """

    points: Array  # [N, 3]
    contours: Sequence[Contour]
    robust: float = 0.6
    reach: float = 4.0

    def __call__(self, placements: Placements) -> System:
        """The mean over all pieces of all views."""
        system = System.empty(len(placements))
        for contour in self.contours:
            projected, pixel = contour.target.project(self.points, placements), contour.target.pixel
            row, point, sample, gap = self._near(contour, projected.px).first()
            gap = (gap - pixel * placements.growth[row]) / self.robust
            J = projected.jacobian(row, point, contour.normals[sample])
            J[:, GROWTH] = pixel
            J /= self.robust
            system = system + share_missed(row, gap, J, len(placements), contour.pieces)
        return 1.0 / sum(contour.pieces for contour in self.contours) * system

    def missed(self, placements: Placements) -> Array:
        """[P], the misfit of a cloud of infinitely many points.

        The edge of few points lies inside that of the object. What it misses falls about as 1 / N,
        so that halves of the points tell what remains.
        """
        missed, half = np.zeros(len(placements)), len(self.points) // 2
        for contour in self.contours:
            px = contour.target.project(self.points, placements).px
            first = self._near(contour, px[:, :half]).outermost
            second = self._near(contour, px[:, half:]).outermost
            grown = contour.target.pixel * placements.growth[:, None]
            for gap, weight in ((np.minimum(first, second), 2.0), (first, -0.5), (second, -0.5)):
                squared = np.square((gap - grown) / self.robust)
                missed += weight * (1.0 - 1.0 / (1.0 + squared)).sum(1)
        share: Array = missed / sum(contour.pieces for contour in self.contours)
        return np.clip(share, 0.0, 1.0)

    def _near(self, contour: Contour, px: Array) -> _Near:
        """The points near a contour, of ``px`` [P, N, 2]."""
        row, column, _ = contour.target.at(px)
        sample = contour.index[row, column]
        inward = contour.samples[sample] - px
        near = np.flatnonzero((np.square(inward).sum(-1) < self.reach**2).ravel())
        sample = sample.ravel()[near]
        gap = (inward.reshape(-1, 2)[near] * contour.normals[sample]).sum(1)
        placement, point = np.divmod(near, px.shape[1])
        piece = placement * contour.pieces + contour.piece[sample]
        outermost = np.full(len(px) * contour.pieces, np.inf)
        np.minimum.at(outermost, piece, gap)
        return _Near(
            placement, point, sample, gap, piece, outermost.reshape(len(px), contour.pieces)
        )


@dataclass(frozen=True, eq=False)
class _Near:
    """The K points near a contour, by placement, and the least gap of each piece.

    gap : [K], along the normal; positive where the point lies inside. piece : [K], counted on
    through all placements. outermost : [P, pieces], infinite where no point is near.
    """

    placement: Indices
    point: Indices
    sample: Indices
    gap: Array
    piece: Indices
    outermost: Array

    def first(self) -> tuple[Indices, Indices, Indices, Array]:
        """Placement, point, sample and gap of the outermost point of each piece, by placement."""
        (first,) = np.nonzero(self.gap == self.outermost.ravel()[self.piece])
        # Of points in one place, one counts.
        first = first[np.unique(self.piece[first], return_index=True)[1]]
        return self.placement[first], self.point[first], self.sample[first], self.gap[first]


@dataclass(frozen=True, eq=False)
class DepthSurface:
    """The depth map of one view where it is smooth."""

    target: Target
    depth: Array  # [S, S]
    slope: Array  # [S, S, 2] its derivative by column and row
    known: Bits  # [S, S]
    blocks: int  # how many blocks have a known cell

    @classmethod
    def of(cls, target: Target) -> DepthSurface:
        assert target.depth is not None
        down, right = np.gradient(target.depth)
        slope = np.stack([right, down], -1)
        cell = target.depth / target.camera.K[0, 0]
        # The comparison is false next to cells without a depth.
        known = np.asarray(np.abs(slope).max(-1) < STEEPEST * cell)
        row, column = np.nonzero(known)
        blocks = len(np.unique(_block(target, row, column)))
        return cls(target, target.depth, slope, known, blocks)

    def farther(self, points: Array, placements: Placements) -> Array:
        """[P], the median of how many times farther the surface is than the placed cloud."""
        projected = self.target.project(points, placements)
        placement, point, row, column = self.foremost(projected)
        times = self.depth[row, column] / projected.depth[placement, point]
        by_placement = [times[placement == number] for number in range(len(placements))]
        return np.array([np.median(ratios) if len(ratios) else 1.0 for ratios in by_placement])

    def foremost(self, projected: ProjectedCloud) -> tuple[Indices, Indices, Indices, Indices]:
        """For each placement and block the foremost point: placement, point, and its cell's row
        and column, by placement.
        """
        row, column, within = self.target.at(projected.px)
        placement, point = np.nonzero(within & self.known[row, column])
        row, column = row[placement, point], column[placement, point]
        key = placement * self.target.side**2 + _block(self.target, row, column)
        order = np.lexsort((projected.depth[placement, point], key))
        first = order[np.flatnonzero(np.diff(key[order], prepend=-1))]
        return placement[first], point[first], row[first], column[first]


def _block(target: Target, row: Indices, column: Indices) -> Indices:
    return (row // BLOCK) * target.side + column // BLOCK


@dataclass(frozen=True, eq=False)
class DepthMisfit:
    """The distance along z from the foremost point of each block to the surface at its cell.

    A distance e, in widths of a cell, counts as g^2 / (1 + g^2) with g = e / ``robust``, and a
    block without a point counts as 1. So the misfit is about the share of the surface that the
    cloud misses.
    """

    points: Array  # [N, 3]
    surfaces: Sequence[DepthSurface]
    robust: float

    def __call__(self, placements: Placements) -> System:
        """The mean over the blocks of all views."""
        system = System.empty(len(placements))
        for surface in self.surfaces:
            projected = surface.target.project(self.points, placements)
            placement, point, row, column = surface.foremost(projected)
            at_cell, slope = surface.depth[row, column], surface.slope[row, column]
            from_cell = projected.px[placement, point] - np.stack([column, row], -1)
            there = at_cell + (slope * from_cell).sum(-1)
            per_unit = surface.target.camera.K[0, 0] / (self.robust * at_cell)
            gap = (there - projected.depth[placement, point]) * per_unit
            # The depth of the surface at a point changes as the point moves across it.
            J = projected.depth_jacobian(placement, point) - projected.jacobian(
                placement, point, slope
            )
            J *= per_unit[:, None]
            system = system + share_missed(placement, gap, J, len(placements), surface.blocks)
        return 1.0 / sum(surface.blocks for surface in self.surfaces) * system
