"""Two projections that the paper compares its own with: points rounded to pixels, and Lin et al.'s depth maps.

Both fall onto whole pixels, so their derivative by a point's column and row is zero wherever it exists.
"""

from __future__ import annotations

import torch
from torch import Tensor

UPSAMPLING = 5
"""U of the paper's comparison."""


def discrete_mask(points_px: Tensor, valid: Tensor, height: int, width: int) -> Tensor:
    """The plain discretised projection: 1 in every pixel that a point is rounded to, 0 elsewhere.

    Parameters
    ----------
    points_px : [M, N, 2] column and row of each point, in pixels (a pixel reaches half a pixel around whole numbers).
    valid : [M, N] bool; points that are False leave no mark.

    Returns
    -------
    [M, height, width], without gradient.
    """
    cell, inside = _cells(points_px, valid, height, width, 1)
    marks = points_px.new_zeros(len(points_px), height * width).scatter_reduce_(1, cell, inside.to(points_px.dtype), "amax")
    return marks.view(-1, height, width)


def discrete_depth(
    points_px: Tensor, depth: Tensor, valid: Tensor, height: int, width: int, upsampling: int = UPSAMPLING
) -> tuple[Tensor, Tensor]:
    """Lin et al.'s projection: depths scattered onto a grid ``upsampling`` times finer, of which each pixel shows the nearest.

    A cell of the finer grid keeps the last of its points, whatever their depths: a finer grid makes such collisions rare.

    Parameters
    ----------
    points_px, valid, height, width : as in `discrete_mask`.
    depth : [M, N], above 0 where valid.

    Returns
    -------
    depth : [M, height, width], 0 where no point falls; differentiable by ``depth``, each pixel by that of the point it shows.
    hit : [M, height, width] bool, whether a point falls there.
    """
    cell, inside = _cells(points_px, valid, height, width, upsampling)
    # Points count from 1; 0 stands for none, at inverse depth 0.
    numbers = torch.arange(1, points_px.shape[1] + 1, device=points_px.device) * inside
    last = numbers.new_zeros(len(cell), height * width * upsampling**2).scatter_reduce_(1, cell, numbers, "amax")
    inverse = torch.where(inside, 1.0 / torch.where(inside, depth, 1.0), 0.0)
    fine = torch.nn.functional.pad(inverse, (1, 0)).gather(1, last).view(-1, 1, height * upsampling, width * upsampling)
    nearest = torch.nn.functional.max_pool2d(fine, upsampling).squeeze(1)
    hit = nearest > 0.0
    return torch.where(hit, 1.0 / torch.where(hit, nearest, 1.0), 0.0), hit


def _cells(points_px: Tensor, valid: Tensor, height: int, width: int, upsampling: int) -> tuple[Tensor, Tensor]:
    """Flat index [M, N] of each point's cell of the finer grid, 0 where there is none, and whether there is one."""
    cell = torch.floor((points_px.detach() + 0.5) * upsampling)
    inside = valid & (cell >= 0.0).all(-1) & (cell < cell.new_tensor([width * upsampling, height * upsampling])).all(-1)
    column, row = torch.where(inside.unsqueeze(-1), cell, 0.0).long().unbind(-1)
    return row * (width * upsampling) + column, inside
