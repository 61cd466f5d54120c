"""Exact nearest neighbours in batches: k-d trees on the CPU, all pairs on a GPU."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .gpu import triton_runs

# Pairs that plain torch compares at once; it bounds the memory at about 400 MB.
PAIRS_PER_CHUNK = 1 << 24


def nearest_in_rows(
    queries: Tensor, data: Tensor, valid: Tensor | None = None, active: Tensor | None = None
) -> Tensor:
    """Nearest neighbours in B clouds at once, on any device.

    Parameters
    ----------
    queries : [B, Q, D], D = 2 or 3. data : [B, N, D].
    valid : [B, N] which points of ``data`` exist; None for all.
    active : [B, Q] which queries are searched for; None for all.

    Returns
    -------
    [B, Q] int64 index into the row of ``data``. It is -1 for a query that is not active, and where
    no point is at a finite distance.
    """
    queries, data = queries.detach(), data.detach()
    if triton_runs(queries):
        from .nearest_triton import nearest_in_rows as on_gpu

        return on_gpu(queries, data, valid, active)
    if queries.device.type == "cpu":
        return _by_trees(queries, data, valid, active)
    return _by_all_pairs(queries, data, valid, active)


def _by_all_pairs(
    queries: Tensor, data: Tensor, valid: Tensor | None, active: Tensor | None
) -> Tensor:
    index = torch.full(queries.shape[:2], -1, dtype=torch.int64, device=queries.device)
    places = torch.nonzero(torch.ones_like(index) if active is None else active)
    for part in (
        places.split(max(1, PAIRS_PER_CHUNK // max(1, data.shape[1]))) if data.shape[1] else ()
    ):
        row, place = part.unbind(1)
        # Coordinates are subtracted; the matrix product of torch.cdist would lose digits.
        differences = [
            queries[row, place, d, None] - data[row, :, d] for d in range(queries.shape[2])
        ]
        squared = torch.stack(differences).square_().sum(0)
        finite = squared < torch.inf if valid is None else (squared < torch.inf) & valid[row]
        least, neighbour = torch.where(finite, squared, torch.inf).min(1)
        index[row, place] = torch.where(least < torch.inf, neighbour, -1)
    return index


def _by_trees(queries: Tensor, data: Tensor, valid: Tensor | None, active: Tensor | None) -> Tensor:
    from scipy.spatial import cKDTree

    index = torch.full(queries.shape[:2], -1, dtype=torch.int64)
    searched, there = queries.isfinite().all(-1), data.isfinite().all(-1)
    searched = searched if active is None else searched & active
    there = there if valid is None else there & valid
    for row, cloud, points, asking, existing in zip(
        index, queries, data, searched, there, strict=True
    ):
        numbers = np.flatnonzero(existing.numpy())
        if len(numbers) and asking.any():
            tree = cKDTree(points[existing].numpy(), balanced_tree=False, compact_nodes=False)
            row[asking] = torch.from_numpy(numbers[tree.query(cloud[asking].numpy())[1]])
    return index


def nearest_both_ways(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Nearest neighbours, both ways, between the clouds ``a`` [B, N, 3] and ``b`` [B, M, 3].

    Returns
    -------
    [B, N] index into ``b`` of the point nearest to each point of ``a``.
    [B, M] index into ``a`` of the point nearest to each point of ``b``.
    """
    # A point with NaN has no neighbour, but needs some index; any index leads to NaN.
    return nearest_in_rows(a, b).clamp_min_(0), nearest_in_rows(b, a).clamp_min_(0)


def nearest_points(pixels: Tensor, points_px: Tensor, valid: Tensor) -> Tensor:
    """Which projected point is nearest to each chosen pixel.

    Returns
    -------
    For ``pixels`` [M, H, W], ``points_px`` [M, N, 2] and ``valid`` [M, N] an index [M, H, W] into
    the image's points; -1 at pixels that are not chosen, and in images without a valid point.
    """
    rows, columns = (
        torch.arange(size, dtype=points_px.dtype, device=pixels.device) for size in pixels.shape[1:]
    )
    grid = torch.stack(torch.meshgrid(columns, rows, indexing="xy"), -1)
    centres = grid.view(1, -1, 2).expand(len(pixels), -1, -1)
    return nearest_in_rows(centres, points_px, valid, pixels.flatten(1)).view(pixels.shape)


def nearest_marked(marked: Tensor) -> tuple[Tensor, Tensor]:
    """Row and column [M, H, W] of the marked pixel nearest to each pixel; -1 if there is none."""
    if marked.device.type != "cpu":
        return _nearest_marked(marked)
    from scipy.ndimage import distance_transform_edt

    places = np.full((len(marked), 2, *marked.shape[1:]), -1)
    for image, place in zip(marked.numpy(), places, strict=True):
        if image.any():
            place[:] = distance_transform_edt(~image, return_distances=False, return_indices=True)
    rows, columns = torch.from_numpy(places).unbind(1)
    return rows, columns


def _nearest_marked(marked: Tensor) -> tuple[Tensor, Tensor]:
    """`nearest_marked` on any device.

    First the nearest marked row in every column is found, then the nearest column in every row:
    O(W) per pixel.
    """
    height, width = marked.shape[1:]
    row = torch.arange(height, device=marked.device).unsqueeze(1)
    column = torch.arange(width, device=marked.device)
    # A distance that is longer than any in the image.
    beyond = height + width
    above = torch.where(marked, row, -beyond).cummax(1).values
    below = torch.where(marked, row, height + beyond).flip(1).cummin(1).values.flip(1)
    near = torch.where(row - above <= below - row, above, below)
    vertical = (near - row).square().flatten(0, 1)
    horizontal = (column.unsqueeze(1) - column).square()
    lines = vertical.split(max(1, PAIRS_PER_CHUNK // width**2))
    nearest_columns = [(line.unsqueeze(1) + horizontal).argmin(2) for line in lines]
    columns = torch.cat(nearest_columns).view(marked.shape)
    exists = marked.flatten(1).any(1).view(-1, 1, 1)
    return torch.where(exists, near.gather(2, columns), -1), torch.where(exists, columns, -1)
