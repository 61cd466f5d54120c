"""The mirror plane of a cloud: searched, given or none."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..cloud.cloud import ControlledCloud
from ..cloud.outliers import find_sparse
from ..errors import InputError
from ..geometry.arrays import Array
from ..geometry.mirror_plane import MirrorPlane
from ..geometry.points import CANDIDATES, as_points, quantile, scattered, spread_subset
from ..losses.chamfer import spacings
from ..losses.nearest import nearest

SymmetryOutcome = Literal["used", "given", "not_asked", "none_found"]


class Search:
    """How the best plane of a cloud is searched."""

    POINTS = 256  # that candidate planes are fitted to
    MEASURED_POINTS = 1024  # that the misfit of a plane is measured at
    UPDATES = 5  # of the candidates, and of the best of them
    EQUALLY_FAR = 1e-9  # squared distances that differ by at most this share differ by rounding
    PAIRED_SHARE = 0.8  # the furthest fifth has no counterpart, and would turn the plane


class Symmetric:
    """A cloud is symmetric if its mirrored points lie near the cloud.

    Distances are in spacings of the points. Another sampling of the same surface lies as far off.
    """

    LARGEST_MEAN = 0.6
    LARGEST_TAIL, TAIL_QUANTILE = 1.0, 0.97


@dataclass(frozen=True, eq=False)
class FittedPlane:
    """A mirror plane of a cloud, and the distances from the mirrored points to the cloud.

    Attributes
    ----------
    mean, tail : of the distances, in spacings of the points: their mean and their 97 % quantile.
    """

    plane: MirrorPlane
    mean: float
    tail: float

    @property
    def symmetric(self) -> bool:
        """Whether the cloud is its own mirror image, as far as the sampling can show it."""
        return self.mean <= Symmetric.LARGEST_MEAN and self.tail <= Symmetric.LARGEST_TAIL


def find_mirror_plane(points: Array) -> FittedPlane:
    """The plane that best maps a cloud [N, 3] onto itself.

    Candidates are the coordinate planes and the planes of the principal axes, through the
    centroid. Each is improved by alternation: mirrored points are paired with their nearest
    neighbours, then the plane is fitted to the pairs in closed form. If the cloud has no mirror
    plane, the plane is searched once more without sparse points: outliers have no counterpart,
    and would hide the plane of the rest.
    """
    points = scattered(as_points(points), CANDIDATES)
    fitted = _best_plane(points)
    if fitted.symmetric:
        return fitted
    sparse = find_sparse(points)
    if not sparse.any():
        return fitted
    without = _best_plane(points[~sparse])
    return without if without.symmetric else fitted


def _best_plane(points: Array) -> FittedPlane:
    """As `find_mirror_plane`, with all points."""
    measured = points[spread_subset(points, Search.MEASURED_POINTS)]
    if len(measured) < 4:
        plane = MirrorPlane(np.array([1.0, 0.0, 0.0]), float(points[:, 0].mean()))
        return FittedPlane(plane, np.inf, np.inf)
    subset = measured[spread_subset(measured, Search.POINTS)]
    centre = subset.mean(0)
    axes = np.concatenate([np.eye(3), np.linalg.svd(subset - centre, full_matrices=False)[2]])
    spacing = _spacing(measured)
    candidates = [_improved(MirrorPlane(axis, float(axis @ centre)), subset) for axis in axes]
    measured_planes = [_measured(plane, measured, subset, spacing) for plane in candidates]
    best = min(measured_planes, key=lambda candidate: candidate.mean).plane
    return _measured(_improved(best, measured), measured, measured, spacing)


def fitted_plane(plane: MirrorPlane, points: Array) -> FittedPlane:
    """``plane`` with its misfit to a cloud [N, 3]."""
    points = as_points(points)
    subset = points[spread_subset(points, Search.MEASURED_POINTS)]
    return _measured(plane, subset, subset, _spacing(subset))


def _improved(plane: MirrorPlane, points: Array) -> MirrorPlane:
    """A plane after some fits to pairs of mirrored points and their nearest neighbours."""
    last = int(Search.PAIRED_SHARE * (len(points) - 1))
    for _ in range(Search.UPDATES):
        image = plane.reflect(points)
        pairs = points[nearest(image, points)]
        squared = np.square(image - pairs).sum(1)
        # Two points, each the nearest to the other's mirror image, are equally far up to rounding.
        # Both are kept, or neither.
        near = squared <= np.partition(squared, last)[last] * (1.0 + Search.EQUALLY_FAR)
        x, y = points[near], pairs[near]
        product = (x - x.mean(0)).T @ (y - y.mean(0))
        normal = np.linalg.eigh(product + product.T)[1][:, 0]
        plane = MirrorPlane(normal, float(normal @ (x.mean(0) + y.mean(0))) / 2.0)
    return plane


def _measured(plane: MirrorPlane, cloud: Array, queries: Array, spacing: float) -> FittedPlane:
    image = plane.reflect(queries)
    distance = np.linalg.norm(image - cloud[nearest(image, cloud)], axis=1)
    if spacing == 0.0:
        # Coinciding points: any distance is infinitely many spacings.
        misfit = np.inf if distance.any() else 0.0
        return FittedPlane(plane, misfit, misfit)
    distance /= spacing
    return FittedPlane(
        plane, float(distance.mean()), float(quantile(distance, Symmetric.TAIL_QUANTILE))
    )


def _spacing(points: Array) -> float:
    """Mean distance from a point to its nearest neighbour."""
    return float(spacings(points).mean())


@dataclass(frozen=True, eq=False)
class SymmetryDecision:
    """Whether a mirror plane is used, and why.

    outcome : "used" (a plane that was found), "given", or without a plane "not_asked" or
        "none_found" (the cloud has none).
    candidate : the plane that was given or found.
    """

    outcome: SymmetryOutcome
    candidate: FittedPlane | None = None

    @property
    def plane(self) -> MirrorPlane | None:
        """The plane that is used, in the frame of the input."""
        has_plane = self.candidate is not None and self.outcome in ("used", "given")
        return self.candidate.plane if has_plane and self.candidate else None

    @property
    def coefficients(self) -> tuple[float, float, float, float] | None:
        """a, b, c, d of the plane ax + by + cz = d that is used, or None."""
        plane = self.plane
        return None if plane is None else (*plane.normal.tolist(), plane.offset)

    @property
    def reason(self) -> str:
        """The measurement that decided, in words."""
        if self.candidate is None:
            return "none asked for"
        fit = (
            f"the mirrored cloud lies {self.candidate.mean:.2f} spacings from the cloud on "
            f"average, {self.candidate.tail:.2f} at its worst"
        )
        if self.outcome == "given":
            return f"given; {fit}"
        limits = f"(at most {Symmetric.LARGEST_MEAN} and {Symmetric.LARGEST_TAIL})"
        if self.outcome == "none_found":
            return f"{fit}, too far {limits}"
        return f"{fit} {limits}"


def decide_symmetry(cloud: ControlledCloud, symmetry: str) -> SymmetryDecision:
    """The plane of a cloud that ``symmetry`` (as in `RefineConfig`) asks for, before the views."""
    parsed = parse_symmetry(symmetry)
    if parsed == "none":
        return SymmetryDecision("not_asked")
    if parsed == "auto":
        # The search is in normalised coordinates and its result is rounded, so that neither unit
        # nor origin of the input changes the result. All points of a cloud are searched: control
        # points need not be symmetric where the cloud is.
        of_mesh = cloud.source.surface is not None
        candidate = find_mirror_plane(cloud.start if of_mesh else cloud.normalise(cloud.measured))
        normal = candidate.plane.normal.round(6)
        normal = normal / np.linalg.norm(normal)
        offset = cloud.scale * round(candidate.plane.offset, 6) + float(normal @ cloud.centre)
        candidate = replace(candidate, plane=MirrorPlane(normal, offset))
        return SymmetryDecision("used" if candidate.symmetric else "none_found", candidate)
    if isinstance(parsed, str):
        normal = np.eye(3)["xyz".index(parsed)]
        plane = MirrorPlane(normal, float(normal @ cloud.centre))
    else:
        length = float(np.linalg.norm(parsed[:3]))
        plane = MirrorPlane(np.array(parsed[:3]) / length, parsed[3] / length)
    return SymmetryDecision("given", fitted_plane(plane, cloud.control_points))


def parse_symmetry(text: str) -> str | tuple[float, float, float, float]:
    """One of auto, none, x, y, z, or the four numbers of a,b,c,d; else InputError."""
    if text in ("auto", "none", "x", "y", "z"):
        return text
    expected = "expected auto, none, x, y, z or four numbers a,b,c,d of the plane ax + by + cz = d"
    try:
        a, b, c, d = (float(part) for part in text.split(","))
    except (ValueError, AttributeError):
        raise InputError(f"symmetry is {text!r}, {expected}") from None
    if not (1e-100 < math.hypot(a, b, c) < 1e100 and abs(d) < 1e100):
        raise InputError(
            f"symmetry is {text!r}, whose normal has no direction or whose numbers are too large; "
            f"{expected}"
        )
    return a, b, c, d
