"""Two projections that the paper compares its own with: points rounded to pixels, and Lin et al.'s depth maps.

Both fall onto whole pixels, so neither tells a point where to move across the picture: the derivative by its column and row is
zero wherever it exists. Lin et al.'s carries the depth of the point that shows, and so a derivative by that depth.
"""

from __future__ import annotations

import torch
from torch import Tensor

# The factor U of the paper's comparison.
UPSAMPLING = 5


def discrete_mask(
    points_px: Tensor,  # [M, N, 2]
    valid: Tensor,  # [M, N] bool
    height: int,
    width: int,
) -> Tensor:
    """The plain discretised projection: 1 in every pixel that a point is rounded to, 0 elsewhere.

    Parameters
    ----------
    points_px : [M, N, 2] column and row of each point, in pixels (a pixel reaches half a pixel around whole numbers).
    valid : [M, N] bool; points that are False leave no mark.
    height, width : size of the image.

    Returns
    -------
    [M, height, width], without gradient.
    """
    cell, seen = _cells(points_px, valid, height, width, 1)
    marks = points_px.new_zeros(len(points_px), height * width)
    marks.scatter_reduce_(1, cell, seen.to(marks.dtype), "amax")
    return marks.view(-1, height, width)


def discrete_depth(
    points_px: Tensor,  # [M, N, 2]
    depth: Tensor,  # [M, N]
    valid: Tensor,  # [M, N] bool
    height: int,
    width: int,
    upsampling: int = UPSAMPLING,
) -> tuple[Tensor, Tensor]:
    """Lin et al.'s projection: depths scattered onto a grid ``upsampling`` times finer, of which each pixel shows the nearest.

    Where points fall into one cell of the finer grid, one of them is kept whatever its depth (the last in the cloud); that is
    the collision which the finer grid makes rare. The largest inverse depth among a pixel's cells is what it shows.

    Parameters
    ----------
    points_px, valid, height, width : as in `discrete_mask`.
    depth : [M, N], above 0 where valid.
    upsampling : U, 1 or more.

    Returns
    -------
    depth : [M, height, width], 0 where no point falls; differentiable by ``depth``, each pixel by that of the point it shows.
    hit : [M, height, width] bool, whether a point falls there.
    """
    cell, seen = _cells(points_px, valid, height, width, upsampling)
    order = torch.arange(1, points_px.shape[1] + 1, device=points_px.device).expand_as(cell) * seen
    last = order.new_zeros(len(points_px), height * width * upsampling**2).scatter_reduce_(1, cell, order, "amax")
    inverse = torch.where(seen, 1.0 / torch.where(seen, depth, 1.0), 0.0)
    # Cell 0 of each point list is "no point", of inverse depth 0: infinitely far.
    padded = torch.cat([inverse.new_zeros(len(inverse), 1), inverse], 1)
    fine = padded.gather(1, last).view(-1, 1, height * upsampling, width * upsampling)
    shown = torch.nn.functional.max_pool2d(fine, upsampling).squeeze(1)
    hit = shown > 0.0
    return torch.where(hit, 1.0 / torch.where(hit, shown, 1.0), 0.0), hit


def _cells(points_px: Tensor, valid: Tensor, height: int, width: int, upsampling: int) -> tuple[Tensor, Tensor]:
    """Flat index [M, N] of each point's cell of the finer grid, 0 where there is none, and whether there is one."""
    place = torch.floor((points_px.detach() + 0.5) * upsampling)
    limit = place.new_tensor([width * upsampling, height * upsampling])
    seen = valid & (place >= 0.0).all(-1) & (place < limit).all(-1)
    column, row = torch.where(seen.unsqueeze(-1), place, 0.0).long().unbind(-1)
    return row * (width * upsampling) + column, seen
