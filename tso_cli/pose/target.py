"""What a placed cloud is compared with: the mask of one view, resampled to a small square."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..geometry.arrays import Array, Bits, Box, Indices
from ..geometry.camera import Camera
from ..geometry.resampling import area_resize, nearest_resize
from ..geometry.view import View
from .placement import (
    ASPECT,
    FOCAL,
    PRINCIPAL,
    SHIFT,
    SIZE,
    STRAINS,
    STRETCH,
    UNKNOWNS,
    Placements,
)

Part = tuple[Box, Bits]
"""The edges of a square of a view, and its pixels [H, W] that are known."""
# Side of the square in longer sides of the mask's box, so that a cloud next to the mask is seen.
MARGIN = 1.3
# A point nearer to the camera than this, in longest sides of the placed cloud, is projected from
# there.
NEAREST = 0.02


def square_around(view: View) -> Box:
    """The edges of a square of the image around the object."""
    left, top, right, bottom = view.box()
    side = max(right - left, bottom - top) * MARGIN
    left, top = (left + right - side) / 2.0, (top + bottom - side) / 2.0
    return left, top, left + side, top + side


@dataclass(frozen=True, eq=False)
class ProjectedCloud:
    """A cloud as one camera sees it at each of P placements."""

    px: Array  # [P, N, 2] column and row
    offset: Array  # [P, N, 2] ``px`` without the principal point
    depth: Array  # [P, N] along the camera's z axis
    inverse: Array  # [P, N] 1 / depth; 1 for an orthographic camera
    turned: Array  # [P, N, 3] the placed cloud about its centre
    target: Target
    placements: Placements

    def jacobian(self, rows: Indices, points: Indices, normals: Array | None = None) -> Array:
        """Derivative of pixels of some points by the unknowns.

        ``rows`` and ``points``, of one shape [...], name placement and point. The result is
        [..., 2, 17], or [..., 17] of the movement along ``normals`` [..., 2].
        """
        inverse, camera = self.inverse[rows, points], self.target.camera
        offset, arm = self.offset[rows, points], self.turned[rows, points]
        focal, aspect = self.placements.focal[rows], self.placements.aspect[rows]
        by_camera = np.zeros((*inverse.shape, 2, 3))
        by_camera[..., :2] = camera.K[:2, :2] * (focal * inverse)[..., None, None]
        by_camera[..., 1, :2] *= aspect[..., None]
        if camera.model == "perspective":
            # A point at the nearest depth is projected from there, however near it is.
            beyond = self.depth[rows, points] * inverse > 1.0 - 1e-12
            by_camera[..., 2] = -offset * (inverse * beyond)[..., None]
        along, vertical, picture = offset, offset * (0.0, 1.0), self.target.picture * np.eye(2)
        if normals is not None:
            by_camera = (normals[..., None, :] @ by_camera)[..., 0, :]
            along, vertical = (normals * offset).sum(-1), (normals * vertical).sum(-1)
            picture = self.target.picture * normals
        J = _by_unknowns(by_camera @ camera.R, arm[..., None, :] if normals is None else arm)
        J[..., FOCAL], J[..., ASPECT], J[..., PRINCIPAL] = along, vertical, picture
        return J

    def depth_jacobian(self, rows: Indices, points: Indices) -> Array:
        """Derivative [..., 17] of depths of some points by the unknowns, as `jacobian`."""
        arm = self.turned[rows, points]
        return _by_unknowns(np.broadcast_to(self.target.camera.R[2], arm.shape), arm)


def _by_unknowns(by_point: Array, arm: Array) -> Array:
    """Derivative [..., 17] of what changes by ``by_point`` [..., 3] for each unit of a point at
    ``arm`` [..., 3] from the cloud's centre; 0 for what is not of the cloud.
    """
    J = np.zeros((*by_point.shape[:-1], UNKNOWNS))
    # A small turn w moves a point at y from the centre by w x y.
    (x, y, z), (u, v, w) = np.moveaxis(arm, -1, 0), np.moveaxis(by_point, -1, 0)
    J[..., 0], J[..., 1], J[..., 2] = y * w - z * v, z * u - x * w, x * v - y * u
    J[..., SHIFT] = by_point
    J[..., SIZE] = (by_point * arm).sum(-1)
    by_pair = (by_point[..., None] * arm[..., None, :]).reshape(*J.shape[:-1], 9)
    J[..., STRETCH] = by_pair @ STRAINS.reshape(-1, 9).T
    return J


@dataclass(frozen=True, eq=False)
class Target:
    """One view in a square of ``side`` cells; its camera is that of the square."""

    mask: Array  # [S, S] in [0, 1]
    known: Bits  # [S, S]
    camera: Camera
    truncated: bool  # the picture cuts off the object, so points outside the picture are no error
    pixel: float  # side of a pixel of the mask, cells
    error: float = 0.0  # how exactly the mask shows where its contour is, cells
    picture: float = 1.0  # longer side of the picture, cells
    depth: Array | None = None  # [S, S] NaN where it is unknown

    @classmethod
    def of(cls, view: View, side: int, part: Part | None = None) -> Target:
        """``view`` around its object, or the ``part`` of it that counts."""
        box, weights = (square_around(view), view.known) if part is None else part
        mask, known = area_resize(view.mask, box, side, side, weights=weights)
        pixel = side / (box[2] - box[0])
        target = cls(
            mask=mask * (known > 0.0),
            known=known > 0.5,
            camera=view.camera.cropped(box, side, side),
            truncated=view.truncated,
            pixel=pixel,
            error=pixel * view.outline_error,
            picture=pixel * max(view.mask.shape),
        )
        if view.depth is None:
            return target
        depth = nearest_resize(view.depth, box, side)
        return replace(target, depth=np.where(target.inside & target.known, depth, np.nan))

    @property
    def side(self) -> int:
        return len(self.mask)

    @cached_property
    def inside(self) -> Bits:
        """[S, S] the object: cells with over half of the largest coverage."""
        return np.asarray(self.mask > 0.5 * self.mask.max())

    @cached_property
    def cells(self) -> Array:
        """[M, 2] column and row of the object's cells."""
        return np.argwhere(self.inside)[:, ::-1].astype(np.float64)

    @cached_property
    def nearest(self) -> Array:
        """[S, S, 2] column and row of the object's nearest cell."""
        number = np.arange(self.side)
        far = 4 * self.side**2
        apart = np.square(number[:, None] - number)
        # The nearest of each row, and then the nearest of all rows.
        in_row = np.where(self.inside[:, None], apart, far)
        column, distance = in_row.argmin(2), in_row.min(2)
        row = (distance[None] + apart[:, :, None]).argmin(1)
        return np.stack([column[row, number], row], -1).astype(np.float64)

    def project(self, points: Array, placements: Placements) -> ProjectedCloud:
        """``points`` [N, 3] at each of the placements."""
        turned, placed = placements.of(points)
        in_camera = placed @ self.camera.R.T + self.camera.t
        inverse = np.ones(in_camera.shape[:2])
        if self.camera.model == "perspective":
            nearest = NEAREST * placements.size[:, None]
            inverse = 1.0 / np.maximum(in_camera[..., 2], nearest)
        plane = in_camera[..., :2] * inverse[..., None] * placements.focal[:, None, None]
        offset = plane @ self.camera.K[:2, :2].T
        offset[..., 1] *= placements.aspect[:, None]
        middle = self.camera.K[:2, 2] + self.picture * placements.centre
        px, depth = offset + middle[:, None], in_camera[..., 2]
        return ProjectedCloud(px, offset, depth, inverse, turned, self, placements)

    def at(self, px: Array) -> tuple[Indices, Indices, Bits]:
        """Row and column of the cells of ``px`` [..., 2], clipped, and which px are within."""
        cell = np.rint(px)
        within = np.asarray(((cell >= 0) & (cell < self.side)).all(-1))
        column, row = np.moveaxis(np.clip(cell, 0, self.side - 1).astype(np.int64), -1, 0)
        return row, column, within
