"""World -> camera -> pixels -> silhouette: the paper's projection (Eq. 1 to 3), batched over clouds and views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..geometry.camera import NEAR, Camera
from ..kernels.dispatch import use_numba
from ..kernels.splat import splat

# A silhouette blurred by this variance (px^2) changes little from one pixel to the next.
SMOOTH_SIGMA_SQ = 6.4
# Points that `silhouette_of` projects at once; bounds its memory.
POINTS_AT_ONCE = 1 << 16


def default_sigma_sq(width: int, height: int) -> float:
    """The paper's 0.4 px^2 of a 64x64 grid, for an image of another size."""
    return 0.4 * (max(width, height) / 64.0) ** 2


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
    if use_numba(points) and not any(tensor.requires_grad for tensor in (cameras.K, cameras.R, cameras.t)):
        from ..kernels.projection_numba import project as compiled

        batch = (len(points), cameras.K.shape[-3])
        K, R, t = cameras.K.expand(*batch, 3, 3), cameras.R.expand(*batch, 3, 3), cameras.t.expand(*batch, 3)
        return Projected(*compiled(points, K, R, t, near))
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


def silhouette_of(points: NDArray[np.floating], camera: Camera, sigma_sq: float | None = None) -> NDArray[np.float32]:
    """The silhouette [H, W] in [0, 1] of a cloud [N, 3] in world units as the paper's projector draws it (Eq. 2).

    Where the Gaussian spans many pixels, the sums are computed on a coarser grid (variance 6.4 cells^2) and interpolated:
    within 0.04 of the value at each pixel, at a cost that does not grow with the photo. ``sigma_sq`` is in px^2 of the
    camera's image, by default 0.4 (max(W, H) / 64)^2.
    """
    height, width = camera.height, camera.width
    if sigma_sq is None:
        sigma_sq = default_sigma_sq(width, height)
    cloud = np.asarray(points, dtype=np.float64)
    centre = (cloud.min(0) + cloud.max(0)) / 2.0
    scale = float((cloud.max(0) - cloud.min(0)).max()) or 1.0
    coarse, sigma_sq = _coarsened(camera, sigma_sq)
    local = torch.as_tensor(((cloud - centre) / scale)[None], dtype=torch.float32)
    batch = CameraBatch.of([coarse.for_normalised(centre, scale)], local)
    with torch.no_grad():
        sums = local.new_zeros(1, 1, batch.height, batch.width)
        for part in local.split(POINTS_AT_ONCE, 1):
            sums += silhouette_sums(project(part, batch), batch, sigma_sq)
        if (batch.height, batch.width) != (height, width):
            sums = torch.nn.functional.interpolate(sums, (height, width), mode="bilinear", align_corners=False)
        silhouette: NDArray[np.float32] = torch.tanh(sums)[0, 0].numpy()
    return silhouette


def _coarsened(camera: Camera, sigma_sq: float) -> tuple[Camera, float]:
    """The camera on a grid so coarse that ``sigma_sq`` (px^2) is at most about 6.4 there, and its value there."""
    if sigma_sq <= SMOOTH_SIGMA_SQ:
        return camera, sigma_sq
    shrink = math.sqrt(SMOOTH_SIGMA_SQ / sigma_sq)
    coarse = camera.resized(max(1, round(camera.width * shrink)), max(1, round(camera.height * shrink)))
    if (coarse.width, coarse.height) == (camera.width, camera.height):
        return camera, sigma_sq
    return coarse, sigma_sq * (max(coarse.width, coarse.height) / max(camera.width, camera.height)) ** 2
