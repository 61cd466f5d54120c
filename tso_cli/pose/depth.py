"""How far the visible side of a placed cloud lies from the surface of a depth map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import Array, Bits, Indices
from .levenberg import System
from .misfit import share_missed
from .placement import Placements
from .target import Projected, Target

# Cells across the block whose foremost point is on the visible side. With fewer, points of the far
# side show through the gaps of clouds of 1,000 points.
BLOCK = 3
# Where the surface is this many cells deeper from one cell to the next, it ends there.
STEEPEST = 3.0


@dataclass(frozen=True, eq=False)
class Surface:
    """The depth map of one view where it is smooth."""

    target: Target
    depth: Array  # [S, S]
    slope: Array  # [S, S, 2] its derivative by column and row
    known: Bits  # [S, S]
    blocks: int  # how many blocks have a known cell

    @classmethod
    def of(cls, target: Target) -> Surface:
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
        seen = self.target.project(points, placements)
        placement, point, row, column = self.foremost(seen)
        times = self.depth[row, column] / seen.depth[placement, point]
        of_each = [times[placement == number] for number in range(len(placements))]
        return np.array([np.median(some) if len(some) else 1.0 for some in of_each])

    def foremost(self, seen: Projected) -> tuple[Indices, Indices, Indices, Indices]:
        """For each placement and block the foremost point: placement, point, and its cell's row
        and column, by placement.
        """
        row, column, within = self.target.at(seen.px)
        placement, point = np.nonzero(within & self.known[row, column])
        row, column = row[placement, point], column[placement, point]
        key = placement * self.target.side**2 + _block(self.target, row, column)
        order = np.lexsort((seen.depth[placement, point], key))
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
    surfaces: Sequence[Surface]
    robust: float

    def __call__(self, placements: Placements) -> System:
        """The mean over the blocks of all views."""
        system = System.empty(len(placements))
        for surface in self.surfaces:
            seen = surface.target.project(self.points, placements)
            placement, point, row, column = surface.foremost(seen)
            at_cell, slope = surface.depth[row, column], surface.slope[row, column]
            from_cell = seen.px[placement, point] - np.stack([column, row], -1)
            there = at_cell + (slope * from_cell).sum(-1)
            per_unit = surface.target.camera.K[0, 0] / (self.robust * at_cell)
            gap = (there - seen.depth[placement, point]) * per_unit
            # The depth of the surface at a point changes as the point moves across it.
            J = seen.depth_jacobian(placement, point) - seen.jacobian(placement, point, slope)
            J *= per_unit[:, None]
            system = system + share_missed(placement, gap, J, len(placements), surface.blocks)
        return 1.0 / sum(surface.blocks for surface in self.surfaces) * system
