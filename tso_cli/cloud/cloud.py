"""A cloud in the units of its file, normalised for the optimisation, and moved."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..diagnosis.placement import place
from ..errors import InputError
from ..geometry.points import as_points, bounding_box_normalisation, bounds, longest_side, quantile
from ..geometry.view import View
from ..optimisation.presets import FIELD_NODES
from .outliers import NEIGHBOUR, to_fourth
from .subset import Subset
from .surface import Surface

Array = NDArray[np.float64]

# A point is an outlier whose fourth neighbour is farther than this part of the size of the middle four fifths of the cloud, and
# than so many times the median of all points.
OUTLIER_SIZE, OUTLIER_SPACINGS = 0.3, 6.0
# With a larger share the cloud is sampled too unevenly to tell.
MOST_OUTLIERS = 0.25
# Without outliers the whole cloud is less than so many times as long as its middle four fifths.
LONGEST = 1.6
# Of groups of points that lie farther apart than 1.5 to 2.3 times the size of the middle half, those are outliers that lie
# beside the largest by half its size. Points are grouped by cubes, so many to the lesser gap. A cloud less than so many times
# as long as its middle half has none.
GAP, CUBES, BESIDE, COMPACT = 1.5, 4, 0.5, 3.5
# Sparser clouds have gaps of their own; cubes beyond so many, either way, are one.
FEWEST_GROUPED, FARTHEST = 64, 1 << 20
# A group of a smaller share of the points is no part of the object that the views would show.
LEAST_PART = 0.05
# With more cubes the cloud is no object with strays.
MOST_CUBES = 2048


class Cloud:
    """A cloud or a mesh, of which some points or surface samples move (`with_moving`), while the rest follows.

    Attributes
    ----------
    given : [V, 3] float64, the points of the cloud, or the vertices of the mesh.
    surface : of a mesh, or None.
    outliers : [V] bool, points of a cloud far from the rest: they stay where they are, and nothing depends on them.
    initial : [N, 3] float64, what moves.
    centre [3], scale : (X - centre) / scale has longest side 1.
    colours : [N, 3] float32 in [0, 1], or None.
    """

    def __init__(
        self,
        points: Any,
        name: str,
        colours: Any = None,
        faces: Any = None,
        predicted: bool = False,
    ) -> None:
        """``predicted`` : by a network, which moves all points; none is an outlier."""
        # In rows: columns would have every loop compiled anew for them.
        self.given: Array = np.ascontiguousarray(as_points(as_numpy(points), name))
        self.name = name
        self.surface = None if faces is None else Surface.of(self.given, as_numpy(faces), name)
        of_none = np.zeros(len(self.given), bool)
        self.outliers = of_none if predicted or self.surface else outliers(self.given)
        self._colours = (
            None if colours is None else _as_colours(as_numpy(colours), len(self.given), name)
        )
        self._move(
            self.surface or Subset(self.given, ~self.outliers, None if predicted else FIELD_NODES)
        )

    def _move(self, moving: Surface | Subset) -> None:
        self._moving, self.initial = moving, moving.samples
        self.centre, self.scale = bounding_box_normalisation(self.initial, self.name)
        self.colours = (
            None
            if self._colours is None
            else moving.at(self._colours.astype(np.float64)).astype(np.float32)
        )

    def with_parts_on(self, views: Sequence[View]) -> Cloud:
        """The same cloud; without outliers if these are many and fall on the object in all ``views``, as a part of it would."""
        far = self.given[self.outliers]
        if len(far) < LEAST_PART * len(self.given) or any(
            2 * place(far, view).inside_mask < len(far) for view in views
        ):
            return self
        changed = copy(self)
        changed.outliers = np.zeros(len(self.given), bool)
        changed._move(Subset(self.given, ~changed.outliers))
        return changed

    def with_moving(self, most: int | None) -> Cloud:
        """The same cloud, of which at most so many points move by themselves, None for all; of a mesh so many samples."""
        moving = self._moving.with_samples(most)
        if moving is self._moving:
            return self
        changed = copy(self)
        changed._move(moving)
        return changed

    @property
    def partial(self) -> bool:
        """Whether only a part moves, and the rest follows."""
        return self._moving.partial

    def normalised(self) -> Array:
        """[N, 3], what moves."""
        return self.normalise(self.initial)

    def normalise(self, points: Array) -> Array:
        """Points [M, 3] in the units of the file, normalised."""
        normalised: Array = (points - self.centre) / self.scale
        return normalised

    def denormalised(self, points: Array) -> Array:
        """Normalised points [N, 3] in the units of the file."""
        restored: Array = self.centre + self.scale * points
        return restored

    def moved(self, displacements: Array) -> MovedCloud:
        """The cloud after ``displacements`` [N, 3] of what moves, in longest sides."""
        of_given = self._moving.followed(displacements)
        # Added to the input, so that unmoved points stay bit-identical.
        points = self.given + self.scale * of_given
        return MovedCloud(points, self._moving.judged(points), self._moving.at(of_given))

    @property
    def judged(self) -> Array:
        """[S, 3], the points that measures are of: those of the cloud but outliers, or many samples of the surface."""
        return self._moving.judged(self.given)


@dataclass(frozen=True, eq=False)
class MovedCloud:
    """A `Cloud` after its displacement."""

    points: Array  # [V, 3], of the cloud or the vertices
    judged: Array  # [S, 3], as `Cloud.judged`
    displacements: Array  # [N, 3] of what moved, in longest sides


def outliers(points: Array) -> NDArray[np.bool_]:
    """[N], which of ``points`` [N, 3] lie far from the object, one by one or in groups, as strays of a scan do.

    One of them at ten times the object's size would leave the object a tenth of the window and of every scale.
    """
    apart = _far_groups(points)
    apart[~apart] = _far_points(points[~apart])
    return apart if apart.mean() <= MOST_OUTLIERS else np.zeros(len(points), bool)


def _far_groups(points: Array) -> NDArray[np.bool_]:
    """[N], points of groups far from the largest; none if they are many."""
    none = np.zeros(len(points), bool)
    size = float((quantile(points, 0.75) - quantile(points, 0.25)).max())
    if len(points) < FEWEST_GROUPED or longest_side(points) <= COMPACT * size or size == 0.0:
        return none
    cubes = (
        np.floor((points - quantile(points, 0.5)) / (GAP / CUBES * size))
        .clip(-FARTHEST, FARTHEST - 1)
        .astype(np.int64)
    )
    # One number for each cube, which is sorted sooner than three.
    numbers = (cubes + FARTHEST) @ [4 * FARTHEST**2, 2 * FARTHEST, 1]
    _, first, cube, counts = np.unique(
        numbers, return_index=True, return_inverse=True, return_counts=True
    )
    if len(first) > MOST_CUBES:
        return none
    group = _connected(cubes[first])
    of_points = group[cube.ravel()]
    low, high = bounds(points[of_points == np.bincount(group, counts).argmax()])
    beside = np.maximum(low - points, points - high).max(1) > BESIDE * (high - low).max()
    far: NDArray[np.bool_] = (np.bincount(of_points, ~beside) == 0)[of_points]
    return far if far.mean() <= MOST_OUTLIERS else none


def _connected(cubes: NDArray[np.int64]) -> NDArray[np.int64]:
    """[C], one number for all of ``cubes`` [C, 3] that a chain of near ones connects. scipy's takes longer to import."""
    near = np.logical_and.reduce(
        [np.abs(np.subtract.outer(axis, axis)) <= CUBES + 1 for axis in cubes.T]
    )
    group = np.arange(len(cubes))
    while (least := np.where(near, group, len(cubes)).min(1)).tolist() != group.tolist():
        group = least[least]
    return group


def _far_points(points: Array) -> NDArray[np.bool_]:
    """[N], points far from the rest; none if they are many."""
    size = float((quantile(points, 0.9) - quantile(points, 0.1)).max())
    if len(points) <= NEIGHBOUR or longest_side(points) <= LONGEST * size:
        return np.zeros(len(points), bool)
    # Invalid points of a scan may all lie in one place.
    places, place = np.unique(points, axis=0, return_inverse=True)
    distance = to_fourth(places, places)
    least = max(OUTLIER_SIZE * size, OUTLIER_SPACINGS * float(quantile(distance, 0.5)))
    far: NDArray[np.bool_] = (distance > least)[place.ravel()]
    return far if far.mean() <= MOST_OUTLIERS else np.zeros(len(points), bool)


def outlier_warnings(count: int) -> list[str]:
    """The warning of so many outliers; empty without any."""
    points = "1 point lies" if count == 1 else f"{count:,} points lie"
    return (
        [f"{points} far from the rest: left where found, and out of all measures"] if count else []
    )


def as_numpy(values: Any) -> Any:
    # A tensor, known without importing torch.
    return values.detach().cpu().numpy() if hasattr(values, "detach") else values


def _as_colours(colours: Any, count: int, name: str) -> NDArray[np.float32]:
    try:
        array = np.asarray(colours)
        as_floats: NDArray[np.float32] = array.astype(np.float32)
    except (TypeError, ValueError):
        raise InputError(
            f"{name}: the colours are no array of numbers, expected [{count}, 3]"
        ) from None
    if as_floats.shape != (count, 3):
        raise InputError(
            f"{name}: the colours have shape {list(as_floats.shape)}, expected [{count}, 3]"
        )
    if array.dtype == np.uint8:
        as_floats = as_floats / np.float32(255.0)
    if not (as_floats.min() >= 0.0 and as_floats.max() <= 1.0):
        raise InputError(
            f"{name}: the colours span {as_floats.min():g} to {as_floats.max():g}, expected 0 to 1, or uint8"
        )
    return as_floats
