"""Mirror planes of clouds: the picture of a symmetric object is a second view of it for nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ..geometry.points import as_points, farthest_point_sample, spread_subset
from ..geometry.view import View
from ..kernels.nearest import nearest

Array = NDArray[np.float64]

# Planes are looked for with so many points, and judged with four times as many.
SEARCHED, JUDGED = 256, 1024
UPDATES = 8
# The best of them is then improved until it stays, however long that takes within reason: else it would depend on how this
# machine rounds, and two machines would refine alike clouds differently.
MOST_UPDATES, STILL = 40, 1e-9
# A cloud is taken to be symmetric if its mirror image lies on it as near as another sample of the same surface would:
# distances in units of the spacing of its points, on average and for the points that lie furthest off.
MEAN_MISFIT, FAR_MISFIT, FAR_SHARE = 0.6, 1.2, 0.97


@dataclass(frozen=True, eq=False)
class MirrorPlane:
    """The plane ``normal . x = offset``.

    Attributes
    ----------
    normal : [3], length 1. offset : in the unit of the points.
    misfit : distance from the mirror image of a point to the cloud, mean, in spacings of its points; NaN before it is judged.
    far : the same for the point that 97 % of the others lie nearer than.
    """

    normal: Array
    offset: float
    misfit: float = float("nan")
    far: float = float("nan")

    @property
    def symmetric(self) -> bool:
        """Whether the cloud that it was found in is its own mirror image, as far as its sampling lets one tell."""
        return self.misfit <= MEAN_MISFIT and self.far <= FAR_MISFIT

    def judged(self, points: Array) -> MirrorPlane:
        """The same plane, knowing how far the mirror image of the cloud [N, 3] lies from it."""
        few = as_points(points)
        few = few[spread_subset(few, JUDGED)]
        return _judged(self, few, few, _spacing(few))

    def reflect(self, points: Array) -> Array:
        """The mirror image of ``points`` [N, 3]."""
        reflected: Array = points - 2.0 * ((points @ self.normal) - self.offset)[:, None] * self.normal
        return reflected

    def view(self, view: View) -> View:
        """What the mirror image of a symmetric object shows: the picture flipped, seen by a camera on the other side."""
        camera = view.camera
        matrix = np.eye(3) - 2.0 * np.outer(self.normal, self.normal)
        flip = np.array([-1.0, 1.0, 1.0])
        K = camera.K.copy()
        K[0, 1], K[0, 2] = -K[0, 1], camera.width - 1.0 - K[0, 2]
        R = flip[:, None] * (camera.R @ matrix)
        t = flip * (camera.t + 2.0 * self.offset * (camera.R @ self.normal))
        known = None if view.known is None else view.known[:, ::-1]
        depth = None if view.depth is None else view.depth[:, ::-1]
        return View(view.mask[:, ::-1], replace(camera, K=K, R=R, t=t), known, f"{view.name}, mirrored", depth)


def find_mirror_plane(points: Array) -> MirrorPlane:
    """The plane that maps a cloud [N, 3] best onto itself; it knows whether the cloud is ``symmetric``.

    From the coordinate planes and those of the principal axes, all through the centroid, each plane is improved by turns:
    points of the mirror image are paired with the nearest of the cloud, and the plane that suits the pairs best follows in
    closed form.
    """
    points = as_points(points)
    judged = points[spread_subset(points, JUDGED)]
    if len(judged) < 4:
        return MirrorPlane(np.array([1.0, 0.0, 0.0]), float(points[:, 0].mean()), np.inf, np.inf)
    few = judged[farthest_point_sample(judged, min(SEARCHED, len(judged)))]
    centre = few.mean(0)
    axes = np.concatenate([np.eye(3), np.linalg.svd(few - centre, full_matrices=False)[2]])
    spacing = _spacing(judged)
    found = []
    for axis in axes:
        plane = MirrorPlane(axis, float(axis @ centre))
        for _ in range(UPDATES):
            plane, _ = _improved(plane, few)
        found.append(_judged(plane, judged, few, spacing))
    plane = min(found, key=lambda plane: plane.misfit)
    tried = []
    for _ in range(MOST_UPDATES):
        improved, misfit = _improved(plane, judged)
        tried.append((misfit, plane))
        # A normal's sign means nothing.
        if np.abs(plane.reflect(few) - improved.reflect(few)).max() < STILL * spacing:
            break
        plane = improved
    # Where pairs change to and fro it goes round in a circle, whose best plane is the same wherever it was entered.
    plane = min(tried, key=lambda one: one[0])[1]
    return _judged(plane, judged, judged, spacing)


def _improved(plane: MirrorPlane, points: Array) -> tuple[MirrorPlane, float]:
    """With y the point nearest to the mirror image of x: the plane that makes sum |mirrored x - y|^2 least, and what that sum
    is for the plane given, mean over the pairs that count."""
    image = plane.reflect(points)
    pairs = points[_nearest(image, points)]
    apart = np.linalg.norm(image - pairs, axis=1)
    # What has no counterpart would turn the plane.
    kept = apart <= np.quantile(apart, 0.8)
    x, y = points[kept], pairs[kept]
    mean_x, mean_y = x.mean(0), y.mean(0)
    product = (x - mean_x).T @ (y - mean_y)
    normal = np.linalg.eigh(product + product.T)[1][:, 0]
    return MirrorPlane(normal, float(normal @ (mean_x + mean_y)) / 2.0), float(np.square(apart[kept]).mean())


def _judged(plane: MirrorPlane, cloud: Array, queries: Array, spacing: float) -> MirrorPlane:
    image = plane.reflect(queries)
    apart = np.linalg.norm(image - cloud[_nearest(image, cloud)], axis=1)
    if spacing == 0.0:
        # Points that lie on one another have none: what is not met exactly is infinitely many of them off.
        off = np.inf if apart.any() else 0.0
        return replace(plane, misfit=off, far=off)
    apart /= spacing
    return replace(plane, misfit=float(apart.mean()), far=float(np.quantile(apart, FAR_SHARE)))


def _spacing(points: Array) -> float:
    """Mean distance from a point to its nearest neighbour."""
    matrix = torch.from_numpy(points)
    apart = torch.cdist(matrix, matrix, compute_mode="donot_use_mm_for_euclid_dist").fill_diagonal_(torch.inf)
    return float(apart.amin(1).mean())


def _nearest(queries: Array, data: Array) -> NDArray[np.int64]:
    index: NDArray[np.int64] = nearest(torch.from_numpy(queries), torch.from_numpy(data)).numpy()
    return index
