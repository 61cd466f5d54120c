"""Mirror planes of clouds: the view of a symmetric object, flipped, is a second view of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..cloud.cloud import Cloud
from ..cloud.outliers import lying_apart
from ..geometry.points import CANDIDATES, as_points, quantile, scattered
from ..geometry.view import View
from ..losses.chamfer import spacings
from ..losses.nearest import nearest, spread_subset
from ..refinement.config import parse_symmetry

Array = NDArray[np.float64]
SymmetryOutcome = Literal["used", "given", "not_asked", "none_found", "contradicted", "unchecked"]

# Points that planes are fitted to in the search, and judged by.
SEARCH_POINTS, JUDGED_POINTS = 256, 1024
SEARCH_UPDATES = 8
# The best plane is then fitted to convergence: a plane that still moves would depend on how this machine rounds.
MOST_UPDATES, CONVERGED = 40, 1e-9
# Squared distances that differ by at most this share are the same but for rounding.
EQUALLY_FAR = 1e-9
# Distances from mirrored points to the cloud, in spacings of its points, at most which the cloud counts as symmetric (another
# sampling of the same surface would lie as far off): their mean, and their 97 % quantile.
MEAN_MISFIT, FAR_MISFIT, FAR_QUANTILE = 0.6, 1.2, 0.97
# Largest ratio of losses, with the flipped views over without, per view, at which a found plane is kept; several masks need it
# less than one.
MOST_LOSS_RATIO, MOST_OF_SEVERAL = 1.15, 1.1


@dataclass(frozen=True, eq=False)
class MirrorPlane:
    """The plane ``normal . x = offset``.

    Attributes
    ----------
    normal : [3], length 1. offset : in the unit of the points.
    misfit : mean distance from mirrored points to the cloud, in spacings of its points; NaN before `judged`.
    far : the 97 % quantile of these distances.
    """

    normal: Array
    offset: float
    misfit: float = float("nan")
    far: float = float("nan")

    @property
    def symmetric(self) -> bool:
        """Whether the cloud it was judged by is its own mirror image, as far as the sampling can tell."""
        return self.misfit <= MEAN_MISFIT and self.far <= FAR_MISFIT

    def judged(self, points: Array) -> MirrorPlane:
        """The same plane with the misfit of a cloud [N, 3]."""
        subset = as_points(points)
        subset = subset[spread_subset(subset, JUDGED_POINTS)]
        return _judged(self, subset, subset, _spacing(subset))

    def reflect(self, points: Array) -> Array:
        reflected: Array = (
            points - 2.0 * ((points @ self.normal) - self.offset)[:, None] * self.normal
        )
        return reflected

    def view(self, view: View) -> View:
        """The flipped view: mask and depth mirrored left to right, and the mirrored camera that sees a symmetric object so."""
        camera = view.camera
        matrix = np.eye(3) - 2.0 * np.outer(self.normal, self.normal)
        flip = np.array([-1.0, 1.0, 1.0])
        K = camera.K.copy()
        K[0, 1], K[0, 2] = -K[0, 1], camera.width - 1.0 - K[0, 2]
        R = flip[:, None] * (camera.R @ matrix)
        t = flip * (camera.t + 2.0 * self.offset * (camera.R @ self.normal))
        known = None if view.known is None else view.known[:, ::-1]
        depth = None if view.depth is None else view.depth[:, ::-1]
        return View(
            view.mask[:, ::-1],
            replace(camera, K=K, R=R, t=t),
            known,
            f"{view.name}, mirrored",
            depth,
        )


def find_mirror_plane(points: Array) -> MirrorPlane:
    """The plane that best maps a cloud [N, 3] onto itself, judged; if it has none, that of the points that do not lie apart.

    Candidates are the coordinate planes and those of the principal axes, through the centroid. Each is improved by
    alternation: mirrored points are paired with their nearest neighbours, then the plane is fitted to the pairs in closed form.
    """
    points = scattered(as_points(points), CANDIDATES)
    plane = _best_plane(points)
    if plane.symmetric:
        return plane
    # Strays have no counterpart, and would hide the plane of the rest.
    apart = lying_apart(points)
    if not apart.any():
        return plane
    without = _best_plane(points[~apart])
    return without if without.symmetric else plane


def _best_plane(points: Array) -> MirrorPlane:
    """As `find_mirror_plane`, of all points alike."""
    judged = points[spread_subset(points, JUDGED_POINTS)]
    if len(judged) < 4:
        return MirrorPlane(np.array([1.0, 0.0, 0.0]), float(points[:, 0].mean()), np.inf, np.inf)
    subset = judged[spread_subset(judged, SEARCH_POINTS)]
    centre = subset.mean(0)
    axes = np.concatenate([np.eye(3), np.linalg.svd(subset - centre, full_matrices=False)[2]])
    spacing = _spacing(judged)
    candidates = [MirrorPlane(axis, float(axis @ centre)) for axis in axes]
    for _ in range(SEARCH_UPDATES):
        before, (candidates, _) = candidates, _improved(candidates, subset)
        if all(map(_same, candidates, before)):
            break
    candidates = [_judged(plane, judged, subset, spacing) for plane in candidates]
    plane = min(candidates, key=lambda candidate: candidate.misfit)
    iterates = []
    for _ in range(MOST_UPDATES):
        (improved,), (misfit,) = _improved([plane], judged)
        iterates.append((misfit, plane))
        # Reflections are compared because the sign of a normal is arbitrary.
        if np.abs(plane.reflect(subset) - improved.reflect(subset)).max() < CONVERGED * spacing:
            break
        # The alternation may end in a cycle; the best plane of a cycle does not depend on where it was entered.
        if any(_same(improved, other) for _, other in iterates):
            break
        plane = improved
    plane = min(iterates, key=lambda iterate: iterate[0])[1]
    return _judged(plane, judged, judged, spacing)


def _same(one: MirrorPlane, other: MirrorPlane) -> bool:
    return one.offset == other.offset and bool((one.normal == other.normal).all())


def _improved(planes: list[MirrorPlane], points: Array) -> tuple[list[MirrorPlane], list[float]]:
    """Planes fitted to pairs of mirrored points and their nearest neighbours, and the given planes' mean squared misfits."""
    images = np.stack([plane.reflect(points) for plane in planes])
    pairs = np.stack([points[nearest(image, points)] for image in images])
    away = images - pairs
    squared = np.einsum("pnc,pnc->pn", away, away)
    # The furthest fifth has no counterpart, and would turn the plane. Two points, each the nearest to the other's mirror
    # image, are equally far but for rounding: both are kept, or neither.
    last = int(0.8 * (len(points) - 1))
    kept = squared <= np.partition(squared, last, 1)[:, last : last + 1] * (1.0 + EQUALLY_FAR)
    weight = kept / kept.sum(1, keepdims=True)
    mean_x, mean_y = weight @ points, (weight[:, None] @ pairs)[:, 0]
    product = ((points - mean_x[:, None]) * weight[:, :, None]).transpose(0, 2, 1) @ (
        pairs - mean_y[:, None]
    )
    normals = np.linalg.eigh(product + product.transpose(0, 2, 1))[1][:, :, 0]
    offsets = (normals * (mean_x + mean_y)).sum(1) / 2.0
    return list(map(MirrorPlane, normals, offsets.tolist())), (weight * squared).sum(1).tolist()


def _judged(plane: MirrorPlane, cloud: Array, queries: Array, spacing: float) -> MirrorPlane:
    image = plane.reflect(queries)
    distance = np.linalg.norm(image - cloud[nearest(image, cloud)], axis=1)
    if spacing == 0.0:
        # Coinciding points: any distance is infinitely many spacings.
        misfit = np.inf if distance.any() else 0.0
        return replace(plane, misfit=misfit, far=misfit)
    distance /= spacing
    return replace(
        plane, misfit=float(distance.mean()), far=float(quantile(distance, FAR_QUANTILE))
    )


def _spacing(points: Array) -> float:
    """Mean distance from a point to its nearest neighbour."""
    return float(spacings(points).mean())


@dataclass(frozen=True, eq=False)
class SymmetryDecision:
    """Whether a mirror plane is used, and why."""

    outcome: SymmetryOutcome  # as in `RefineResult`
    candidate: MirrorPlane | None = None  # the plane that was given or found
    loss_ratio: float | None = None  # of the symmetry check (`verified_symmetry`)
    most: float = MOST_LOSS_RATIO  # of it

    @property
    def plane(self) -> MirrorPlane | None:
        return self.candidate if self.outcome in ("used", "given") else None

    @property
    def reason(self) -> str:
        """The measurement that decided, in words."""
        if self.candidate is None:
            return "none asked for"
        fit = (
            f"the mirrored cloud lies {self.candidate.misfit:.2f} spacings from the cloud on average, "
            f"{self.candidate.far:.2f} at its worst"
        )
        if self.outcome == "given":
            return f"given; {fit}"
        limits = f"(at most {MEAN_MISFIT} and {FAR_MISFIT})"
        if self.outcome == "none_found":
            return f"{fit}, too far {limits}"
        if self.outcome == "unchecked":
            return f"{fit} {limits}; the budget leaves no time for the symmetry check"
        if self.loss_ratio is None:
            return f"{fit} {limits}"
        limit = f"{'at most' if self.outcome == 'used' else 'over'} {self.most}"
        ratio = f"the final loss per view is {self.loss_ratio:.2f} times that without ({limit})"
        return f"{fit} {limits}; with the flipped view {ratio}"


def decide_symmetry(cloud: Cloud, symmetry: str) -> SymmetryDecision:
    """The plane that ``symmetry`` (as in `RefineConfig`) stands for, of a cloud; views are not asked here."""
    parsed = parse_symmetry(symmetry)
    if parsed == "none":
        return SymmetryDecision("not_asked")
    if parsed == "auto":
        # Searched in normalised coordinates and rounded, so that neither unit nor origin of the input changes the result.
        # All points of a cloud: the few that move need not be symmetric where it is.
        plane = find_mirror_plane(
            cloud.normalised() if cloud.surface else cloud.normalise(cloud.judged)
        )
        normal = plane.normal.round(6) / np.linalg.norm(plane.normal.round(6))
        offset = cloud.scale * round(plane.offset, 6) + float(normal @ cloud.centre)
        plane = replace(plane, normal=normal, offset=offset)
        return SymmetryDecision("used" if plane.symmetric else "none_found", plane)
    if isinstance(parsed, str):
        normal = np.eye(3)["xyz".index(parsed)]
        plane = MirrorPlane(normal, float(normal @ cloud.centre))
    else:
        length = float(np.linalg.norm(parsed[:3]))
        plane = MirrorPlane(np.array(parsed[:3]) / length, parsed[3] / length)
    return SymmetryDecision("given", plane.judged(cloud.initial))
