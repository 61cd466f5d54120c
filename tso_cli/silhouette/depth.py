"""Depth loss: points reach the surface of a depth map and leave the space before it empty."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..kernels.dispatch import whole_batches
from ..kernels.nearest import nearest, nearest_in_rows
from .mask_chamfer import REFERENCE_POINTS, REFERENCE_SIDE, robust
from .projection import CameraBatch, Projected, pixels_under

# Tolerance of both terms, pixels of an image of 64 at the surface's depth.
TOLERANCE = 0.7


class DepthTarget(NamedTuple):
    """M depth maps, prepared for the depth loss.

    Attributes
    ----------
    known : [M, H, W] bool, foreground pixels that have a depth.
    surface : [M, H, W, 3] their points in the frame of the cloud.
    front : [M, H, W] least depth of the pixel and its eight neighbours; minus infinity where the pixel has none.
    per_unit : [M, H, W] pixels, of an image of 64, to a unit of length at that depth.
    cameras : [M, 1].
    """

    known: Tensor
    surface: Tensor
    front: Tensor
    per_unit: Tensor
    cameras: CameraBatch

    @classmethod
    def of(cls, depth: Tensor, inside: Tensor, cameras: CameraBatch) -> DepthTarget:
        """``depth`` [M, H, W], NaN where unknown; ``inside`` [M, H, W] bool, the foreground; M perspective cameras [M, 1]."""
        known = inside & torch.isfinite(depth)
        safe = torch.where(known, depth, 1.0)
        height, width = depth.shape[1:]
        rows, columns = (torch.arange(size, dtype=depth.dtype, device=depth.device) for size in (height, width))
        u, v = torch.meshgrid(columns, rows, indexing="xy")
        K, R, t = cameras.K, cameras.R, cameras.t  # [M, 1, 3, 3], [M, 1, 3]
        rays = torch.stack([u, v, torch.ones_like(u)], -1) @ torch.linalg.inv(K).transpose(-1, -2)  # [M, H, W, 3]
        surface = (rays * safe.unsqueeze(-1) - t.unsqueeze(-2)) @ R
        # A point between two pixels may lie before one of them and on the surface all the same.
        least = -torch.nn.functional.max_pool2d(-torch.where(known, depth, torch.inf).unsqueeze(1), 3, 1, 1).squeeze(1)
        focal = (K[..., 0, 0] * K[..., 1, 1]).sqrt().unsqueeze(-1) * (REFERENCE_SIDE / max(height, width))
        return cls(known, surface, torch.where(known, least, -torch.inf), focal / safe, cameras)

    def pixels(self) -> Tensor:
        """[M] pixels that have a depth, of an image of 64."""
        return self.known.flatten(1).sum(1) * (REFERENCE_SIDE / max(self.known.shape[1:])) ** 2


def depth_loss(points: Tensor, projected: Projected, target: DepthTarget, robust_scale: float, counts: Tensor) -> Tensor:
    """Attract points to surfaces that none has reached, and push back points in front of a surface.

    A pixel whose surface is further than 0.7 px from the nearest point, in space, attracts that point; a point that lies more
    than that before the least depth around its pixel is pushed back to it. Lengths are in pixels at the surface's depth, and
    pairs cost what they do in `mask_chamfer_loss`. Points behind a surface are hidden and cost nothing.

    Parameters
    ----------
    points : [M, N, 3]. projected : their pixels. counts : [M] points of each cloud. robust_scale : pixels of an image of 64.

    Returns
    -------
    [M], differentiable in ``points``: sum over pixels of an image of 64, and over points as if a cloud had 1,024.
    """
    pixel_area = (REFERENCE_SIDE / max(target.known.shape[1:])) ** 2
    index = _nearest(target, points, projected.valid)
    image, row, column = torch.nonzero(index >= 0, as_tuple=True)
    offsets = points[image, index[image, row, column]] - target.surface[image, row, column]
    squared = offsets.square().sum(1) * target.per_unit[image, row, column] ** 2
    cost = torch.where(squared.detach() > TOLERANCE**2, robust(squared, robust_scale), 0.0) * pixel_area
    unreached = points.new_zeros(len(points)).index_add(0, image, cost)

    pixel, in_image = pixels_under(*projected, *target.known.shape[1:])
    front, per_unit = (image.flatten(1).gather(1, pixel) for image in (target.front, target.per_unit))
    R, t = target.cameras.R[:, 0], target.cameras.t[:, 0]
    depth = (points * R[:, 2].unsqueeze(1)).sum(-1) + t[:, 2].unsqueeze(1)
    ahead = (front - depth) * per_unit
    before = in_image & (ahead.detach() > TOLERANCE)
    pushed = robust(torch.where(before, ahead, 0.0).square(), robust_scale).sum(1)
    return unreached + pushed * (REFERENCE_POINTS / counts).to(points)


def _nearest(target: DepthTarget, points: Tensor, valid: Tensor) -> Tensor:
    """[M, H, W] index of the point nearest to each surface; -1 where there is none."""
    shape = target.known.shape
    if whole_batches(points):
        return nearest_in_rows(target.surface.flatten(1, 2), points, valid, target.known.flatten(1)).view(shape)
    index = torch.full(shape, -1, dtype=torch.int64)
    for i, (known, surface) in enumerate(zip(target.known, target.surface, strict=True)):
        candidates = torch.nonzero(valid[i]).squeeze(1)
        if len(candidates) and known.any() and bool(torch.isfinite(points[i, candidates].detach()).all()):
            index[i, known] = candidates[nearest(surface[known], points[i, candidates])]
    return index
