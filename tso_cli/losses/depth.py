"""Depth loss: points reach the surface of a depth map and leave the space before it empty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Camera
from .mask_chamfer import REFERENCE_POINTS, REFERENCE_SIDE, robust
from .nearest import nearest
from .projection import Projected, pixels_under

Array = NDArray[np.float64]

# Tolerance of both terms, pixels of an image of 64 at the surface's depth.
TOLERANCE = 0.7


@dataclass(frozen=True, eq=False)
class DepthTarget:
    """A depth map, prepared for the depth loss.

    Attributes
    ----------
    surface : [P, 3] the points of the foreground pixels that have a depth, in the frame of the cloud.
    per_unit : [P] pixels, of an image of 64, to a unit of length at each of them.
    front : [H, W] least depth of the pixel and its eight neighbours; minus infinity where the pixel has none.
    front_per_unit : [H, W] ``per_unit`` of the pixel.
    """

    surface: Array
    per_unit: Array
    front: Array
    front_per_unit: Array
    camera: Camera

    @classmethod
    def of(cls, depth: Array, inside: NDArray[np.bool_], camera: Camera) -> DepthTarget:
        """``depth`` [H, W], NaN where unknown; ``inside`` [H, W] bool, the foreground; a perspective camera."""
        known = inside & np.isfinite(depth)
        rows, columns = np.nonzero(known)
        rays = np.stack([columns, rows, np.ones(len(rows))], 1) @ np.linalg.inv(camera.K).T
        surface = (rays * depth[known][:, None] - camera.t) @ camera.R
        padded = np.pad(np.where(known, depth, np.inf), 1, constant_values=np.inf)
        # A point between two pixels may lie before one of them and on the surface all the same.
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


def depth_loss(
    points: Array, projected: Projected, target: DepthTarget, robust_scale: float
) -> tuple[float, Array]:
    """Attract points to surfaces that none has reached, and push back points in front of a surface.

    A pixel whose surface is further than 0.7 px from the nearest point, in space, attracts that point; a point that lies more
    than that before the least depth around its pixel is pushed back to it. Lengths are in pixels at the surface's depth, and
    pairs cost what they do in `mask_chamfer`. Points behind a surface are hidden and cost nothing.

    Parameters
    ----------
    points : [N, 3]. projected : their pixels. robust_scale : pixels of an image of 64.

    Returns
    -------
    The sum over pixels of an image of 64, and over points as if the cloud had 1,024; its gradient [N, 3].
    """
    value, gradient = 0.0, np.zeros_like(points)
    (candidates,) = np.nonzero(projected.valid)
    if len(candidates):
        owner = candidates[nearest(target.surface, points[candidates])]
        offsets = points[owner] - target.surface
        squared = np.square(offsets).sum(1) * np.square(target.per_unit)
        cost, slope = robust(squared, robust_scale)
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
    cost, slope = robust(np.square(np.where(before, ahead, 0.0)), robust_scale)
    weight = REFERENCE_POINTS / len(points)
    by_depth = np.where(before, -2.0 * weight * slope * ahead * per_unit, 0.0)
    return value + weight * float(cost.sum()), gradient + by_depth[:, None] * direction
