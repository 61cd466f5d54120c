"""World -> camera -> pixels -> silhouette: the paper's projection (Eq. 1 to 3), batched over clouds and views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..geometry.camera import NEAR, Camera
from ..kernels.splat import splat


@dataclass(frozen=True, eq=False)
class CameraBatch:
    """Cameras as tensors. ``K``, ``R`` [..., V, 3, 3], ``t`` [..., V, 3]; a leading axis, if any, is that of the clouds."""

    K: Tensor
    R: Tensor
    t: Tensor
    width: int
    height: int
    model: str = "perspective"

    @classmethod
    def of(cls, cameras: Sequence[Camera], like: Tensor) -> CameraBatch:
        """V cameras of one image size and model, in the precision and on the device of ``like``."""
        first = cameras[0]
        if any((c.width, c.height, c.model) != (first.width, first.height, first.model) for c in cameras):
            raise ValueError("cameras of one batch share image size and model")
        K, R, t = (
            torch.as_tensor(np.stack([getattr(c, name) for c in cameras]), dtype=like.dtype, device=like.device)
            for name in ("K", "R", "t")
        )
        return cls(K, R, t, first.width, first.height, first.model)

    def one_each(self) -> CameraBatch:
        """V cameras as one for each of V clouds: [V, 1, ...]."""
        return replace(self, K=self.K.unsqueeze(1), R=self.R.unsqueeze(1), t=self.t.unsqueeze(1))

    def grouped(self, views: int) -> CameraBatch:
        """One camera for each of B V clouds as V ``views`` of B clouds: [B, V, ...]."""
        K, R, t = (part.flatten(0, 1).unflatten(0, (-1, views)) for part in (self.K, self.R, self.t))
        return replace(self, K=K, R=R, t=t)


class Projected(NamedTuple):
    """Where points fall in every view."""

    points_px: Tensor  # [B, V, N, 2] column, row
    valid: Tensor  # [B, V, N] bool, False for points at or behind the camera


def project(points: Tensor, cameras: CameraBatch, near: float = NEAR) -> Projected:
    """Eq. 1, ``p^ = K (R p + t)``, with the perspective division it implies.

    ``points`` [B, N, 3] are seen by V cameras, the same for all clouds ([V, ...]) or different ones ([B, V, ...]). Under the
    perspective model points with depth <= ``near`` are invalid; their pixel coordinates are finite and get no gradient.
    """
    near = -math.inf if cameras.model == "orthographic" else near
    camera = points.unsqueeze(-3) @ cameras.R.transpose(-1, -2) + cameras.t.unsqueeze(-2)  # [B, V, N, 3]
    plane, depth = camera[..., :2], camera[..., 2]
    if near == -math.inf:
        valid = torch.ones_like(depth, dtype=torch.bool)
    else:
        valid = depth > near
        plane = torch.where(valid.unsqueeze(-1), plane, 0.0) / torch.where(valid, depth, 1.0).unsqueeze(-1)
    linear, centre = cameras.K[..., :2, :2], cameras.K[..., :2, 2]
    return Projected(plane @ linear.transpose(-1, -2) + centre.unsqueeze(-2), valid)


def pixels_under(points_px: Tensor, valid: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """The pixels ``row * width + column`` that points fall on [M, N], 0 outside the image, and whether they fall inside."""
    pixel = points_px.detach().round()
    in_image = valid & (pixel >= 0).all(-1) & (pixel < pixel.new_tensor([width, height])).all(-1)
    column, row = torch.where(in_image.unsqueeze(-1), pixel, 0.0).long().unbind(-1)
    return row * width + column, in_image


def silhouette_sums(projected: Projected, cameras: CameraBatch, sigma_sq: float, kernel: str = "auto") -> Tensor:
    """The sums s [B, V, H, W] whose tanh is the silhouette (Eq. 2); losses take s, which keeps what tanh rounds away."""
    points_px, valid = projected
    sums = splat(points_px.flatten(0, 1), valid.flatten(0, 1), cameras.height, cameras.width, sigma_sq, kernel)
    return sums.view(*points_px.shape[:2], cameras.height, cameras.width)
