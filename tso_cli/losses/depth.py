"""Depth loss: points reach the surface of a depth map and leave the space before it empty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.camera import Camera
from .mask_chamfer import REFERENCE_POINTS, REFERENCE_SIDE
from .nearest import nearest
from .projection import Projected, pixels_under

# Distance up to which both terms cost nothing, px of an image of 64 at the surface's depth. It is
# half the diagonal of a pixel, as `COVERED_WITHIN` of the mask Chamfer loss.
TOLERANCE = 0.7
# A pair that is many times this far apart, px of an image of 64, is a wrong depth or another part,
# and has almost no gradient.
ROBUST_SCALE = 3.0


@dataclass(frozen=True, eq=False)
class DepthTarget:
    """A depth map, prepared for the depth loss.

    Attributes
    ----------
    surface : [P, 3] the points of the foreground pixels that have a depth, in the cloud's frame.
    per_unit : [P] pixels of an image of 64 in a unit of length at each of these points.
    front : [H, W] least depth of the pixel and its eight neighbours; minus infinity where the pixel
        has no depth.
    front_per_unit : [H, W] ``per_unit`` of the pixel.
    """

    surface: Array
    per_unit: Array
    front: Array
    front_per_unit: Array
    camera: Camera

    @classmethod
    def of(cls, depth: Array, inside: NDArray[np.bool_], camera: Camera) -> DepthTarget:
        """From ``depth`` [H, W], NaN where unknown, and ``inside`` [H, W] bool, the foreground.

        The camera is a perspective one.
        """
        known = inside & np.isfinite(depth)
        rows, columns = np.nonzero(known)
        rays = np.stack([columns, rows, np.ones(len(rows))], 1) @ np.linalg.inv(camera.K).T
        surface = (rays * depth[known][:, None] - camera.t) @ camera.R
        padded = np.pad(np.where(known, depth, np.inf), 1, constant_values=np.inf)
        # A point between two pixels can lie in front of one of them and still be on the surface.
        least = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).min((2, 3))
        focal = np.sqrt(camera.K[0, 0] * camera.K[1, 1]) * (REFERENCE_SIDE / max(depth.shape))
        per_unit = focal / np.where(known, depth, 1.0)
        return cls(surface, per_unit[known], np.where(known, least, -np.inf), per_unit, camera)

    @property
    def pixel_area(self) -> float:
        return float((REFERENCE_SIDE / max(self.front.shape)) ** 2)

    @property
    def pixels(self) -> float:
        """Pixels that have a depth, of an image of 64."""
        return len(self.surface) * self.pixel_area


def depth_loss(points: Array, projected: Projected, target: DepthTarget) -> tuple[float, Array]:
    """Attract points to surfaces without a point, and push back points in front of a surface.

    1. A pixel attracts the point nearest to its surface, in space, if this point is further away
       than 0.7 px.
    2. A point is pushed back to the least depth around its pixel if it lies more than 0.7 px in
       front of it.
    3. A point behind a surface is hidden and costs nothing.

    Lengths are in pixels at the surface's depth. The cost of a distance is `robust`.

    Parameters
    ----------
    points : [N, 3]. projected : their pixels.

    Returns
    -------
    The sum over pixels of an image of 64 and over points, as if the cloud had 1,024 points. Its
    gradient [N, 3].
    """
    value, gradient = 0.0, np.zeros_like(points)
    (candidates,) = np.nonzero(projected.valid)
    if len(candidates):
        owner = candidates[nearest(target.surface, points[candidates])]
        offsets = points[owner] - target.surface
        squared = np.square(offsets).sum(1) * np.square(target.per_unit)
        cost, slope = robust(squared, ROBUST_SCALE)
        unreached = squared > TOLERANCE**2
        value += float(cost[unreached].sum()) * target.pixel_area
        by_offset = np.where(
            unreached, 2.0 * target.pixel_area * slope * np.square(target.per_unit), 0.0
        )
        for axis in range(3):
            gradient[:, axis] += np.bincount(owner, by_offset * offsets[:, axis], len(points))

    pixel, in_image = pixels_under(projected.points_px, projected.valid, *target.front.shape)
    direction = target.camera.R[2]
    per_unit = target.front_per_unit.ravel()[pixel]
    ahead = (target.front.ravel()[pixel] - (points @ direction + target.camera.t[2])) * per_unit
    before = in_image & (ahead > TOLERANCE)
    cost, slope = robust(np.square(np.where(before, ahead, 0.0)), ROBUST_SCALE)
    weight = REFERENCE_POINTS / len(points)
    by_depth = np.where(before, -2.0 * weight * slope * ahead * per_unit, 0.0)
    return value + weight * float(cost.sum()), gradient + by_depth[:, None] * direction


def robust(squared: Array, robust_scale: float) -> tuple[Array, Array]:
    """The cost ``rho`` (Geman and McClure) of squared distances, and its derivative by them.

    A small distance costs its square; no distance costs more than ``robust_scale`` squared.
    """
    inlier = robust_scale**2 / (robust_scale**2 + squared)
    return squared * inlier, np.square(inlier)
