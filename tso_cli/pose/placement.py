"""Placements: where a cloud is put before its cameras, by eight numbers with names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.rotations import from_vectors, to_vectors

# The unknowns of a placement, and their columns in a derivative: rotation vector about the cloud's
# centre, displacement, logarithm of the size, logarithm of the factor of all focal lengths.
TURN, SHIFT = slice(0, 3), slice(3, 6)
SIZE, FOCAL = 6, 7
UNKNOWNS = 8

Rows = NDArray[np.generic] | slice


@dataclass(frozen=True, eq=False)
class Placements:
    """P placements of one cloud of longest side 1 with its centre at the origin.

    A point X goes to ``size`` R X + t, in the world of the cameras.
    """

    R: Array  # [P, 3, 3]
    t: Array  # [P, 3]
    size: Array  # [P]
    focal: Array  # [P], the factor of the focal lengths of all cameras

    def __len__(self) -> int:
        return len(self.R)

    def __getitem__(self, rows: Rows) -> Placements:
        return Placements(self.R[rows], self.t[rows], self.size[rows], self.focal[rows])

    @classmethod
    def unmoved(cls, count: int = 1) -> Placements:
        """The cloud where it is, ``count`` times."""
        ones = np.ones(count)
        return cls(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), ones, ones)

    @classmethod
    def joined(cls, parts: Sequence[Placements]) -> Placements:
        """The placements of several batches in one."""
        names = (field.name for field in fields(cls))
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def of(self, points: Array) -> tuple[Array, Array]:
        """``points`` [N, 3] as each placement turns and scales them, and as it places them.

        Both are [P, N, 3].
        """
        turned = self.size[:, None, None] * (points @ self.R.transpose(0, 2, 1))
        return turned, turned + self.t[:, None]

    def stepped(self, step: Array) -> Placements:
        """The placements after a ``step`` [P, 8] of the unknowns."""
        return Placements(
            from_vectors(step[:, TURN]) @ self.R,
            self.t + step[:, SHIFT],
            self.size * np.exp(step[:, SIZE]),
            self.focal * np.exp(step[:, FOCAL]),
        )

    def scaled_about(self, position: Array, factor: Array) -> Placements:
        """The placements, scaled about ``position`` [3] by ``factor`` [P]."""
        t = position + factor[:, None] * (self.t - position)
        return replace(self, t=t, size=factor * self.size)

    def since(self, given: Placements) -> Array:
        """[P, 8], the unknowns of each placement, counted from the one placement ``given``."""
        change = np.empty((len(self), UNKNOWNS))
        change[:, TURN] = to_vectors(self.R @ given.R[0].T)
        change[:, SHIFT] = self.t - given.t
        change[:, SIZE] = np.log(self.size / given.size)
        change[:, FOCAL] = np.log(self.focal / given.focal)
        return change

    def replaced(self, rows: Rows, other: Placements) -> Placements:
        """The same with other ``rows``."""
        R, t, size, focal = self.R.copy(), self.t.copy(), self.size.copy(), self.focal.copy()
        R[rows], t[rows], size[rows], focal[rows] = other.R, other.t, other.size, other.focal
        return Placements(R, t, size, focal)
