"""Small corrections of cameras that are optimised with the points (torch)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..geometry.camera import Camera
from ..silhouette.projection import CameraBatch

# Prior standard deviations of a given camera's error: rotation about the cloud, and shift in distances to it.
TURN = math.radians(2.0)
SHIFT = 0.01
# Loss of a correction of one standard deviation: a wrong cloud asks for corrections that its camera does not need.
WEIGHT = 30.0
# Of Adam: 50 steps rotate a camera by at most 5 degrees.
LEARNING_RATE = 2e-3


class CameraMoves:
    """Rotations and shifts of V cameras for each of B clouds, held near 0 by a quadratic penalty; K stays.

    Rotations are about the cloud's centre, which separates them from shifts. Each of the ``cameras`` [B][V] sees its cloud
    normalised. ``learning_rate`` is that of the Adam that moves ``parameter``; cameras move by `LEARNING_RATE` all the same.

    Attributes
    ----------
    parameter : [B, 2 V, 3], 0 at first; rotation and shift of view 0, of view 1, ..., in units that suit the learning rate.
    """

    def __init__(self, cameras: Sequence[Sequence[Camera]], like: Tensor, learning_rate: float = LEARNING_RATE) -> None:
        self._distance = torch.tensor(
            [[distance_of(camera) for camera in row] for row in cameras], dtype=like.dtype, device=like.device
        )
        self._unit = LEARNING_RATE / learning_rate
        batch, views = self._distance.shape
        self.parameter = like.new_zeros(batch, 2 * views, 3).requires_grad_()

    def values_of(self, parameter: Tensor) -> Tensor:
        """[B, V, 6] rotation vectors (radians, camera axes) and shifts (in distances to the cloud's centre)."""
        return self._unit * parameter.unflatten(1, (-1, 2)).flatten(2)

    def apply(self, cameras: CameraBatch, view: int) -> CameraBatch:
        """The cameras [B, 1, ...] of the view of that number, moved; differentiable in ``parameter``."""
        values = self.values_of(self.parameter)[:, view : view + 1]
        turned = _rotations(values[..., :3]) @ cameras.R
        shifted = cameras.t + values[..., 3:] * self._distance[:, view : view + 1, None]
        return replace(cameras, R=turned, t=shifted)

    def penalty(self) -> Tensor:
        """[B]: the squares of the corrections in standard deviations, summed over the views."""
        values = self.values_of(self.parameter)
        turn, shift = values[..., :3] / TURN, values[..., 3:] / SHIFT
        return WEIGHT * (turn.square() + shift.square()).sum((1, 2))


def distance_of(camera: Camera) -> float:
    """Depth of the origin, the unit of shifts; 1 for an orthographic camera."""
    return 1.0 if camera.model == "orthographic" else abs(float(camera.t[2]))


def moved_camera(camera: Camera, values: NDArray[np.floating], centre: NDArray[np.float64], scale: float) -> Camera:
    """``camera``, in the units of a file, after the correction [6] found for the cloud normalised by (X - centre) / scale."""
    turn, shift = np.asarray(values, dtype=np.float64).reshape(2, 3)
    if not (turn.any() or shift.any()):
        return camera
    local = camera.for_normalised(centre, scale)
    from ..geometry.rotations import from_vectors

    R = from_vectors(turn) @ camera.R
    t = (local.t + shift * distance_of(local)) * scale - R @ centre
    return replace(camera, R=R, t=t)


def _rotations(vectors: Tensor) -> Tensor:
    """Rotations [..., 3, 3] by rotation vectors [..., 3] (Rodrigues), with the right derivative at 0."""
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).view(*vectors.shape, 3)
    # The root has no derivative at 0; below the clamp, sin(a) / a rounds to 1.
    angle = vectors.square().sum(-1).clamp_min(1e-16).sqrt()[..., None, None]
    half = torch.sin(angle / 2.0) / (angle / 2.0)
    identity = torch.eye(3, dtype=vectors.dtype, device=vectors.device)
    return identity + torch.sin(angle) / angle * cross + 0.5 * half.square() * (cross @ cross)
