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

# Standard deviations by which a given camera may well be off: turn about the cloud, and shift as a share of the distance.
TURN = math.radians(2.0)
SHIFT = 0.01
# Loss of a correction of one standard deviation. The silhouettes of a cloud that is still wrong ask for corrections that the
# camera does not need; this is what keeps them small.
WEIGHT = 30.0
# Of Adam. In 50 steps a camera comes 5 degrees far.
LEARNING_RATE = 2e-3


class CameraMoves:
    """Turns and shifts of V cameras for each of B clouds, held near none by a quadratic penalty.

    A turn goes about the cloud's centre, so that it does not shift the picture, and a shift does not turn it: the two are told
    apart from the first step on. K is held.

    Parameters
    ----------
    cameras : [B][V], each seeing its cloud normalised (centre at the origin, longest side 1).
    like : tensor whose precision and device are used.
    learning_rate : of the Adam that moves ``parameter``, with which cameras move by a rate of their own.

    Attributes
    ----------
    parameter : [B, 2 V, 3], all 0; a turn and a shift of each view by turns, in units that suit the learning rate.
    """

    def __init__(self, cameras: Sequence[Sequence[Camera]], like: Tensor, learning_rate: float = LEARNING_RATE) -> None:
        self._distance = torch.tensor(
            [[distance_of(camera) for camera in own] for own in cameras], dtype=like.dtype, device=like.device
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
    """What a shift is a share of: the depth of the origin; of an orthographic camera, which has none, the unit."""
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
    # The root has no derivative at 0; so near to it sin(a) / a is 1 to rounding.
    angle = vectors.square().sum(-1).clamp_min(1e-16).sqrt()[..., None, None]
    half = torch.sin(angle / 2.0) / (angle / 2.0)
    identity = torch.eye(3, dtype=vectors.dtype, device=vectors.device)
    return identity + torch.sin(angle) / angle * cross + 0.5 * half.square() * (cross @ cross)
