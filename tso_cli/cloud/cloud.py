"""A cloud or a mesh as it was given, and the same with the control points that move it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..evaluation.footprint import Solid
from ..geometry.arrays import Array, Bits, as_numbers, as_numpy
from ..geometry.points import as_points, bounding_box_normalisation
from ..geometry.view import View
from ..io.paint import Paint
from ..pose.move import Body
from .control_points import CONTROL_POINTS
from .left_out import find_left_out
from .outliers import are_part_of_object, find_outliers
from .subset import Subset
from .surface import Surface, SurfaceSamples


class Cloud:
    """A cloud or a mesh as it was given. Nothing is searched before it is asked for.

    Attributes
    ----------
    points : [V, 3] float64, the points of a cloud, or the vertices of a mesh.
    surface : the surface of a mesh, or None.
    not_a_mesh : why a cloud with faces has no surface, in words; else "".
    colours : [V, 3] float32 in [0, 1], or None.
    paint : the colours of the surface, which come before those of the vertices; or None.
    predicted : whether a network predicted the cloud. All points of a prediction move by
        themselves, and none is an outlier.
    faint : [V] bool, points that cannot be seen, such as splats of low opacity. They follow, and
        nothing depends on them.
    """

    def __init__(
        self,
        points: Any,
        name: str,
        colours: Any = None,
        faces: Any = None,
        predicted: bool = False,
        faint: Bits | None = None,
        paint: Paint | None = None,
    ) -> None:
        # A copy: what the caller does to the points later is no matter of the result. In rows: the
        # order in memory shows in the last digits.
        self.points: Array = np.array(as_points(points, name), order="C")
        self.name = name
        self.predicted = predicted
        self.colours = (
            None if colours is None else _as_colours(as_numpy(colours), len(self.points), name)
        )
        none = np.zeros(len(self.points), bool)
        # A cloud of faint points alone is as good as one without.
        self.faint: Bits = none if faint is None or faint.all() else faint
        self.surface: Surface | None = None
        self.not_a_mesh = ""
        if faces is not None:
            self.surface, self.not_a_mesh = Surface.of(self.points, as_numpy(faces), name)
        self.paint = paint if self.surface else None

    @cached_property
    def outliers(self) -> Bits:
        """[V], points of a cloud far from all others. A mesh has none."""
        if self.predicted or self.surface:
            return np.zeros(len(self.points), bool)
        if not self.faint.any():
            return find_outliers(self.points)
        outliers = np.zeros(len(self.points), bool)
        outliers[~self.faint] = find_outliers(self.points[~self.faint])
        return outliers

    def controlled(
        self, most: int | None = CONTROL_POINTS, views: Sequence[View] = ()
    ) -> ControlledCloud:
        """The cloud with its control points, ``most`` of them at most (None: all points move).

        A mesh has at most 4,096, and 1,024 for None. Outliers that look like a part of the object
        in all ``views`` are not taken for outliers. Points that most of their masks leave out are.
        """
        outliers, left_out = self.outliers, np.zeros(len(self.points), bool)
        distant = self.points[outliers]
        if views and len(distant) and are_part_of_object(distant, len(self.points), views):
            outliers = left_out
        visible = ~outliers & ~self.faint
        decides = self.surface.at(self.points) if self.surface else self.points[visible]
        if views and not self.predicted and (unmasked := find_left_out(decides, views)):
            left_out = unmasked.holds(self.points) & ~outliers
        if self.surface:
            surface, left_out = self.surface.without(left_out)
            samples = SurfaceSamples(surface, most or CONTROL_POINTS)
            return ControlledCloud(self, left_out, samples, left_out)
        outliers = outliers | left_out
        most = None if self.predicted else most
        subset = Subset(self.points, visible & ~outliers, most, self.faint & ~outliers)
        return ControlledCloud(self, outliers, subset, left_out)


class ControlledCloud:
    """A cloud or a mesh with control points, which move by themselves. All other points follow.

    Attributes
    ----------
    source : what was given.
    outliers : [V] bool, points that stay where they are. Nothing depends on them.
    left_out : [V] bool, those of the outliers that most masks leave out.
    control_points : [N, 3] float64, in the unit of the source.
    centre, scale : [3] and a number: (X - centre) / scale of the control points has longest side 1.
    partial : whether some points follow.
    """

    def __init__(
        self, source: Cloud, outliers: Bits, control: Subset | SurfaceSamples, left_out: Bits
    ) -> None:
        self.source, self.outliers, self._control = source, outliers, control
        self.left_out = left_out
        self.control_points, self.partial = control.control_points, control.partial
        self.centre, self.scale = bounding_box_normalisation(self.control_points, source.name)

    @cached_property
    def colours(self) -> NDArray[np.float32] | None:
        """[N, 3] colours of the control points in [0, 1], or None."""
        if self.source.paint is not None and isinstance(self._control, SurfaceSamples):
            return self._control.painted(self.source.paint).astype(np.float32)
        if self.source.colours is None:
            return None
        of_points = self.source.colours.astype(np.float64)
        return self._control.at_control_points(of_points).astype(np.float32)

    @cached_property
    def start(self) -> Array:
        """[N, 3], the control points, normalised: where an optimisation starts."""
        return self.normalise(self.control_points)

    @property
    def measured(self) -> Array:
        """[M, 3], the points that measures are of: all but outliers, or many of the surface."""
        return self._control.measured(self.source.points)

    @property
    def solid(self) -> Solid:
        """What has its silhouette: the points that are measured, or the triangles of a mesh."""
        return self._control.solid(self.source.points)

    @property
    def body(self) -> Body:
        """What of it is compared with masks when it moves as one."""
        return Body(self.measured, self.centre, self.scale)

    def normalise(self, points: Array) -> Array:
        """Points [M, 3] in the unit of the source, normalised."""
        normalised: Array = (points - self.centre) / self.scale
        return normalised

    def denormalise(self, points: Array) -> Array:
        """Normalised points [M, 3] in the unit of the source."""
        restored: Array = self.centre + self.scale * points
        return restored

    def spread(self, shares: Array) -> Array:
        """[V], ``shares`` [N] in [0, 1] of the control points, interpolated as displacements are.

        Those of outliers are 0.
        """
        spread = self._follow(np.repeat(shares[:, None], 3, 1))[:, 0]
        return np.clip(spread, 0.0, 1.0)

    def moved(self, displacements: Array) -> MovedCloud:
        """The cloud after ``displacements`` [N, 3] of the control points, in longest sides."""
        of_points = self._follow(displacements)
        # Added to what was given, so that unmoved points stay the same to the last bit.
        points = self.source.points + self.scale * of_points
        measured, solid = self._control.measured(points), self._control.solid(points)
        return MovedCloud(points, measured, solid, self._control.at_control_points(of_points))

    def _follow(self, displacements: Array) -> Array:
        """[V, 3], of all points, by those of the control points [N, 3]."""
        of_points = self._control.follow(displacements)
        of_points[self.outliers] = 0.0
        return of_points


@dataclass(frozen=True, eq=False)
class MovedCloud:
    """A `ControlledCloud` after its displacement."""

    points: Array  # [V, 3], of the cloud, or the vertices of the mesh
    measured: Array  # [M, 3], as `ControlledCloud.measured`
    solid: Solid  # as `ControlledCloud.solid`
    displacements: Array  # [N, 3] of the control points, in longest sides


def _as_colours(colours: Any, count: int, name: str) -> NDArray[np.float32]:
    as_floats: NDArray[np.float32] = as_numbers(
        colours, f"{name}: what is given as colours", np.float32
    )
    if as_floats.shape != (count, 3):
        raise InputError(
            f"{name}: the colours have shape {list(as_floats.shape)}, expected [{count}, 3]"
        )
    if np.asarray(colours).dtype == np.uint8:
        as_floats = as_floats / np.float32(255.0)
    if not (as_floats.min() >= 0.0 and as_floats.max() <= 1.0):
        span = f"{as_floats.min():g} to {as_floats.max():g}"
        raise InputError(f"{name}: the colours span {span}, expected 0 to 1, or uint8")
    return as_floats
