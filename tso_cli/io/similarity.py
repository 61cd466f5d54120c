"""The motion of a whole cloud: a rotation, one factor for all lengths, and a shift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array, as_numbers
from ..geometry.points import longest_side

# How far a matrix of float32 may be from a similarity, as a share of its factor.
_TOLERANCE = 1e-6
# Rounding alone is no turn and no change of size: what only shifts keeps its directions bit for
# bit.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Similarity:
    """A motion that keeps the shape of a cloud: x' = matrix x, for columns x = (x, y, z, 1).

    matrix : [4, 4]. turn : [3, 3], its rotation. size : its factor for all lengths.
    """

    matrix: Array
    turn: Array
    size: float

    @property
    def turns(self) -> bool:
        """Whether directions change."""
        return not np.array_equal(self.turn, np.eye(3))

    def apply(self, points: Array) -> Array:
        """``points`` [N, 3], moved."""
        moved: Array = points @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        return moved

    def turned(self, directions: Array) -> Array:
        """``directions`` [N, 3], turned; their lengths stay."""
        with np.errstate(over="ignore", invalid="ignore"):  # of directions that are not finite
            turned: Array = directions @ self.turn.T
        return turned

    def accounts_for(self, before: Array, after: Array, kinds: Sequence[str]) -> bool:
        """Whether points went from ``before`` to ``after`` [N, 3] by this motion alone.

        What is less than a millionth of their longest side, or than the rounding of coordinates of
        these ``kinds``, is no further motion.
        """
        moved, shift = self.apply(before), self.matrix[:3, 3]
        largest = max(np.abs(part).max() for part in (self.size * before, shift, moved))
        rounding = 8.0 * np.finfo(np.float32 if "f4" in kinds else np.float64).eps * largest
        gap = np.abs(after - moved).max()
        return bool(gap <= 1e-6 * longest_side(moved) + rounding)


def similarity_of(matrix: Array | None) -> Similarity | None:
    """The motion of a matrix [4, 4]; None for None and for the identity, which move nothing.

    Raises InputError if the matrix is not a rotation with one factor for all lengths and a shift.
    """
    if matrix is None:
        return None
    values: Array = as_numbers(matrix, "the matrix of a motion")
    if values.shape != (4, 4):
        raise InputError(f"the matrix of a motion has shape {list(values.shape)}, expected [4, 4]")
    if np.array_equal(values, np.eye(4)):
        return None
    linear = values[:3, :3]
    with np.errstate(all="ignore"):
        size = float(np.sqrt((linear * linear).sum() / 3.0))
        turn: Array = linear / size
        gap = np.abs(turn.T @ turn - np.eye(3)).max()
        mirrored = not np.linalg.det(turn) > 0.0
    affine = np.isfinite(values).all() and np.array_equal(values[3], [0.0, 0.0, 0.0, 1.0])
    if mirrored or not gap <= _TOLERANCE or not affine:
        raise InputError(
            "the matrix of a motion does not keep shapes, expected a rotation with one factor for "
            "all lengths, and a shift"
        )
    if np.abs(turn - np.eye(3)).max() < _ROUNDING:
        turn = np.eye(3)
    return Similarity(values, turn, 1.0 if abs(size - 1.0) < _ROUNDING else size)
