"""Placements: how a cloud is put before its cameras, by seventeen numbers with names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.rotations import from_vectors, to_vectors

# The unknowns of a placement, and their columns in a derivative. Of the cloud: rotation vector
# about its centre, displacement, logarithm of the size, stretch that keeps the volume (`STRAINS`).
# Of all cameras: logarithms of the factor of the focal lengths, and of fy alone; shift of the
# principal point in longer sides of the picture. Of all masks: by how many pixels each has grown.
TURN, SHIFT, STRETCH, PRINCIPAL = slice(0, 3), slice(3, 6), slice(8, 13), slice(14, 16)
SIZE, FOCAL, ASPECT, GROWTH = 6, 7, 13, 16
UNKNOWNS = 17
# The unknowns that are logarithms of lengths.
SCALES = [SIZE, FOCAL, *range(STRETCH.start, STRETCH.stop), ASPECT]
STRAINS = (
    np.array(
        [
            [[1, 0, 0], [0, -1, 0], [0, 0, 0]],
            [[-1, 0, 0], [0, -1, 0], [0, 0, 2]],
            [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
            [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
            [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
        ]
    )
    / np.sqrt([2.0, 6.0, 2.0, 2.0, 2.0])[:, None, None]
)
"""[5, 3, 3], symmetric, without a trace and orthonormal: how a cloud stretches for each unknown."""

Rows = NDArray[np.generic] | slice
Same = TypeVar("Same", bound="OfPlacements")


@dataclass(frozen=True, eq=False)
class OfPlacements:
    """Arrays with a row for each of P placements."""

    def arrays(self) -> dict[str, Array]:
        """By name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __getitem__(self: Same, rows: Rows) -> Same:
        return replace(self, **{name: array[rows] for name, array in self.arrays().items()})

    def replaced(self: Same, rows: Rows, other: Same) -> Same:
        """The same with other ``rows``."""
        copies = {name: array.copy() for name, array in self.arrays().items()}
        for name, array in other.arrays().items():
            copies[name][rows] = array
        return replace(self, **copies)


@dataclass(frozen=True, eq=False)
class Placements(OfPlacements):
    """P placements of one cloud of longest side 1 with its centre at the origin.

    A point X goes to ``size`` exp(``strain``) R X + t, in the world of the cameras.
    """

    R: Array  # [P, 3, 3]
    t: Array  # [P, 3]
    size: Array  # [P]
    focal: Array  # [P], the factor of the focal lengths of all cameras
    strain: Array  # [P, 3, 3], symmetric and without a trace
    aspect: Array  # [P], the factor of fy alone
    centre: Array  # [P, 2], the shift of the principal point, longer sides of the picture
    growth: Array  # [P], pixels by which the masks have grown

    def __len__(self) -> int:
        return len(self.R)

    @classmethod
    def at(cls, R: Array, t: Array, size: Array) -> Placements:
        """Of rotations [P, 3, 3], displacements [P, 3] and sizes [P] alone."""
        ones, none = np.ones(len(R)), np.zeros((len(R), 3, 3))
        return cls(R, t, size, ones, none, ones, np.zeros((len(R), 2)), np.zeros(len(R)))

    @classmethod
    def unmoved(cls, count: int = 1) -> Placements:
        """The cloud where it is, ``count`` times."""
        return cls.at(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), np.ones(count))

    @classmethod
    def joined(cls, parts: Sequence[Placements]) -> Placements:
        """The placements of several batches in one."""
        columns = zip(*(part.arrays().values() for part in parts), strict=True)
        return cls(*map(np.concatenate, columns))

    def of(self, points: Array) -> tuple[Array, Array]:
        """``points`` [N, 3] as each placement turns, stretches and scales them, and places them.

        Both are [P, N, 3].
        """
        linear = self.size[:, None, None] * self.R
        if self.strain.any():
            # The exponential of symmetric matrices.
            values, vectors = np.linalg.eigh(self.strain)
            linear = (vectors * np.exp(values)[:, None]) @ vectors.transpose(0, 2, 1) @ linear
        turned = points @ linear.transpose(0, 2, 1)
        return turned, turned + self.t[:, None]

    def stepped(self, step: Array) -> Placements:
        """The placements after a ``step`` [P, 17] of the unknowns."""
        return Placements(
            from_vectors(step[:, TURN]) @ self.R,
            self.t + step[:, SHIFT],
            self.size * np.exp(step[:, SIZE]),
            self.focal * np.exp(step[:, FOCAL]),
            self.strain + np.einsum("pk,kij->pij", step[:, STRETCH], STRAINS),
            self.aspect * np.exp(step[:, ASPECT]),
            self.centre + step[:, PRINCIPAL],
            self.growth + step[:, GROWTH],
        )

    def scaled_about(self, position: Array, factor: Array) -> Placements:
        """The placements, scaled about ``position`` [3] by ``factor`` [P]."""
        t = position + factor[:, None] * (self.t - position)
        return replace(self, t=t, size=factor * self.size)

    def since(self, given: Placements) -> Array:
        """[P, 17], the unknowns of each placement, counted from the one placement ``given``."""
        change = np.empty((len(self), UNKNOWNS))
        change[:, TURN] = to_vectors(self.R @ given.R[0].T)
        change[:, SHIFT] = self.t - given.t
        change[:, SIZE] = np.log(self.size / given.size)
        change[:, FOCAL] = np.log(self.focal / given.focal)
        change[:, STRETCH] = np.einsum("pij,kij->pk", self.strain - given.strain, STRAINS)
        change[:, ASPECT] = np.log(self.aspect / given.aspect)
        change[:, PRINCIPAL] = self.centre - given.centre
        change[:, GROWTH] = self.growth - given.growth
        return change
