"""World -> camera -> pixels -> silhouette: the paper's projection (Eq. 1 to 3).

It is batched over clouds and views.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ..geometry.camera import NEAR
from ..kernels.splat import splat


@dataclass(frozen=True, eq=False)
class CameraBatch:
    """Perspective cameras: ``K`` and ``R`` [..., V, 3, 3], ``t`` [..., V, 3].

    A leading axis, if there is one, is the axis of the clouds.
    """

    K: Tensor
    R: Tensor
    t: Tensor
    width: int
    height: int


class Projected(NamedTuple):
    """Where points fall in every view."""

    points_px: Tensor  # [B, V, N, 2] column, row
    valid: Tensor  # [B, V, N] bool, False for points at or behind the camera


def project(points: Tensor, cameras: CameraBatch) -> Projected:
    """Eq. 1, ``p^ = K (R p + t)``, with its perspective division.

    V cameras see ``points`` [B, N, 3]: the same cameras for all clouds ([V, ...]), or different
    ones ([B, V, ...]). Points at or behind a camera are invalid; their pixel coordinates are finite
    and get no gradient.
    """
    # [B, V, N, 3]
    camera = points.unsqueeze(-3) @ cameras.R.transpose(-1, -2) + cameras.t.unsqueeze(-2)
    plane, depth = camera[..., :2], camera[..., 2:]
    valid = depth > NEAR
    plane = torch.where(valid, plane, 0.0) / torch.where(valid, depth, 1.0)
    linear, centre = cameras.K[..., :2, :2], cameras.K[..., :2, 2]
    return Projected(plane @ linear.transpose(-1, -2) + centre.unsqueeze(-2), valid[..., 0])


def pixels_under(
    points_px: Tensor, valid: Tensor, height: int, width: int
) -> tuple[Tensor, Tensor]:
    """The pixel ``row * width + column`` of each point, and whether it is in the image: [M, N].

    The pixel of a point outside the image is 0.
    """
    pixel = points_px.detach().round()
    in_image = valid & (pixel >= 0).all(-1) & (pixel < pixel.new_tensor([width, height])).all(-1)
    column, row = torch.where(in_image.unsqueeze(-1), pixel, 0.0).long().unbind(-1)
    return row * width + column, in_image


def silhouette_sums(projected: Projected, cameras: CameraBatch, sigma_sq: float) -> Tensor:
    """The sums s [B, V, H, W] whose tanh is the silhouette (Eq. 2).

    Losses take s, because tanh rounds large sums to 1.
    """
    points_px, valid = projected
    sums = splat(
        points_px.flatten(0, 1), valid.flatten(0, 1), cameras.height, cameras.width, sigma_sq
    )
    return sums.view(*points_px.shape[:2], cameras.height, cameras.width)
