"""World -> camera -> pixels (Eq. 1), and gradients back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.camera import NEAR, Camera


@dataclass(frozen=True, eq=False)
class Projected:
    """Where a cloud falls in a view.

    Attributes
    ----------
    points_px : [N, 2] column and row; finite for invalid points too.
    valid : [N] bool, False for points at or behind a perspective camera. All points of an
        orthographic camera are valid.
    """

    points_px: Array
    valid: NDArray[np.bool_]
    camera: Camera
    plane: Array  # [N, 2] the points on the plane of depth 1
    inverse_depth: Array  # [N], 0 for invalid points

    def in_camera(self, gradient_px: Array) -> Array:
        """The gradient [N, 3] by points in the camera's frame, from the gradient by ``points_px``.

        It is 0 for invalid points.
        """
        gradient = np.empty((len(gradient_px), 3), gradient_px.dtype)
        on_plane = gradient_px @ self.camera.K[:2, :2]
        gradient[:, :2] = on_plane * self.inverse_depth[:, None]
        gradient[:, 2] = 0.0
        if self.camera.model == "perspective":
            gradient[:, 2] = -(gradient[:, :2] * self.plane).sum(1)
        return gradient

    def pull_back(self, gradient_px: Array) -> Array:
        """The gradient [N, 3] by points in the world, from the gradient [N, 2] by ``points_px``."""
        gradient: Array = self.in_camera(gradient_px) @ self.camera.R
        return gradient


def project_differentiably(points: Array, camera: Camera) -> Projected:
    """Eq. 1, ``p^ = K (R p + t)``, with its perspective division; ``points`` [N, 3]."""
    in_camera = points @ camera.R.T + camera.t
    plane, depth = in_camera[:, :2], in_camera[:, 2]
    if camera.model == "perspective":
        valid = depth > NEAR
        inverse_depth = np.zeros_like(depth)
        np.divide(1.0, depth, out=inverse_depth, where=valid)
        plane = np.where(valid[:, None], plane, 0.0) * inverse_depth[:, None]
    else:
        valid, inverse_depth = np.ones(len(depth), bool), np.ones_like(depth)
    return Projected(
        plane @ camera.K[:2, :2].T + camera.K[:2, 2], valid, camera, plane, inverse_depth
    )


def pixels_under(
    points_px: Array, valid: NDArray[np.bool_], height: int, width: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The pixel ``row * width + column`` of each point, and whether it is in the image: [N] each.

    The pixel of a point outside the image is 0.
    """
    pixel = np.rint(points_px)
    in_image = valid & (pixel >= 0).all(1) & (pixel < (width, height)).all(1)
    column, row = np.where(in_image[:, None], pixel, 0.0).astype(np.int64).T
    return row * width + column, in_image
