"""What moved as one before the shape is refined, a cloud or its cameras.

What one camera sees of a cloud that turned is what a camera that turned the other way sees of the
cloud as it was. So a `Move` has cameras as the cloud at rest sees them, whichever of the two moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.arrays import Array
from ..geometry.rotations import to_vectors
from ..geometry.view import View
from . import Keep, Moved
from .placement import SHIFT, SIZE, TURN

if TYPE_CHECKING:
    from .causes import Cause

# The default does not turn a cloud further: that is a mistake of another kind.
MOST_DEGREES = 30.0
# A cloud that misses a smaller share of the contours than this fits them: 95 % of exact validation
# clouds do, and 2 % of clouds of another shape.
FITS = 0.2
# All exact validation clouds miss less than this, and some of other proportions do.
FITS_NEARLY = 0.26


@dataclass(frozen=True, eq=False)
class PoseDeviation:
    """Standard deviations of a place, along the axes of the world; 0 for what was kept.

    degrees : [3] of the turn. shift : [3] of the middle of the cloud, in units of the world.
    size : of the logarithm of the factor of its size.
    """

    degrees: Array
    shift: Array
    size: float

    @classmethod
    def of(cls, covariance: Array, unit: float) -> PoseDeviation:
        """``covariance`` [17, 17] of the unknowns, where a shift by 1 is one by ``unit``."""
        deviation = np.sqrt(np.diag(covariance))
        return cls(np.degrees(deviation[TURN]), unit * deviation[SHIFT], float(deviation[SIZE]))


@dataclass(frozen=True, eq=False)
class Move:
    """What moved as one.

    kind : what moved. keep : what stays, where one camera cannot separate the size of a cloud from
        its distance; None where both are found.
    views : the views as the cloud sees them where it was given. matrix : [4, 4], takes the cloud as
        it was given to where it belongs, in its units; the identity if cameras moved.
    missed_before, missed : shares of the contours that the cloud misses; NaN if nobody looked.
    explains : whether the move explains why the cloud did not fit.
    alternatives : other placements that were found, if all directions were searched: what each
        misses, and its matrix. None is a symmetry of the cloud.
    why_unsure : why one of them may be right instead; "" if the place is sure, or if it was only
        searched near where the cloud was given. why_unmoved : why nothing moved; "" else.
    causes : what explains the misfit about equally well, where nothing moves for that reason.
    stretched : share that a cloud of other proportions misses, infinite if nobody looked. growth :
        pixels by which the masks seem to have grown beyond it.
    settled : whether the cloud fits nearly, and a cloud of other proportions hardly fits better.
    exact_to : how exact the place is, if the cloud was placed and fits there.
    """

    kind: Moved
    views: tuple[View, ...]
    matrix: Array
    missed_before: float = np.nan
    missed: float = np.nan
    explains: bool = False
    keep: Keep | None = None
    alternatives: tuple[tuple[float, Array], ...] = ()
    why_unsure: str = ""
    why_unmoved: str = ""
    causes: tuple[Cause, ...] = ()
    stretched: float = np.inf
    growth: float = 0.0
    settled: bool = False
    exact_to: PoseDeviation | None = None

    @property
    def fits(self) -> bool:
        """Whether the cloud fits the contours, after the move."""
        return self.settled or self.missed < FITS

    @property
    def is_far(self) -> bool:
        """Whether the cloud is turned by more than the default would turn it."""
        return self.degrees > MOST_DEGREES

    @property
    def degrees(self) -> float:
        """The angle by which the cloud is turned."""
        return float(np.degrees(np.linalg.norm(to_vectors(self.matrix[:3, :3] / self.size))))

    @property
    def size(self) -> float:
        """The factor of its size."""
        return float(np.cbrt(np.linalg.det(self.matrix[:3, :3])))

    def taken_back(self, why: str) -> Move:
        """Nothing moves in the end; the place that was found is the first alternative."""
        if self.kind == "nothing":
            return self
        place = () if self.kind == "camera" else ((self.missed, self.matrix),)
        return replace(
            self,
            kind="nothing",
            matrix=np.eye(4),
            explains=False,
            exact_to=None,
            alternatives=(*place, *self.alternatives),
            why_unmoved=why,
        )

    def apply(self, points: Array) -> Array:
        """``points`` [N, 3], moved; untouched where nothing or a camera moved."""
        if self.kind in ("nothing", "camera"):
            return points
        return points @ self.matrix[:3, :3].T + self.matrix[:3, 3]


def unmoved(views: Sequence[View], why: str = "", missed: float = np.nan) -> Move:
    """Nothing moves."""
    return Move("nothing", tuple(views), np.eye(4), missed, missed, why_unmoved=why)


@dataclass(frozen=True, eq=False)
class Body:
    """A cloud that moves as one.

    points : [N, 3]; (X - centre) / scale has longest side 1 and its centre at the origin.
    """

    points: Array
    centre: Array
    scale: float

    def normalise(self, points: Array) -> Array:
        """``points`` [N, 3], normalised as those of the cloud."""
        normalised: Array = (points - self.centre) / self.scale
        return normalised
