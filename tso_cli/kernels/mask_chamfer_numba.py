"""The pull of masks as one compiled loop on the CPU; its twin in plain torch is in `tso_cli.silhouette.mask_chamfer`."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .jit import compiled, share
from .losses_numba import WithSlope
from .nearest_numba import cell_edge, nearest_in_cells, sort_into_cells


def mask_chamfer_loss(
    points_px: Tensor,
    valid: Tensor,
    asked: Tensor,
    counted: Tensor,
    inside: Tensor,
    outside: Tensor,
    rows: Tensor,
    columns: Tensor,
    bounds: Tensor,
    grain: Tensor,
    scale: float,
    covered: float,
    reach: float,
    weight: Tensor,
) -> Tensor:
    """As `mask_chamfer_loss`; ``asked`` [M, N] which points the masks tell something of, ``weight`` [M]
    times ``counted`` [M, N] what a stray point counts, ``scale`` pixels of 64 to
    one of the image."""
    total, slope = points_px.new_empty(len(points_px)), torch.zeros_like(points_px, memory_format=torch.contiguous_format)
    edge = cell_edge(inside.shape[1], inside.shape[2], points_px.shape[1])
    steps = 16 * inside.numel() + 16 * valid.numel()
    arguments = (
        points_px,
        valid,
        asked,
        counted,
        inside,
        outside,
        rows,
        columns,
        bounds.contiguous(),
        edge,
        scale,
        covered * grain,
        reach**2,
        weight,
        total,
        slope,
    )
    share(len(inside), steps, _pull, *arguments)
    return WithSlope.apply(points_px, total, slope)


@compiled
def _pull(  # type: ignore[no-untyped-def]
    first,
    last,
    points,
    valid,
    asked,
    counted,
    inside,
    outside,
    rows,
    columns,
    bounds,
    edge,
    scale,
    within,
    reach,
    weight,
    sums,
    slope,
):
    height, width = inside.shape[1:]
    area = scale * scale
    for image in range(first, last):
        loss, covered = 0.0, within[image] * within[image] * area
        cells = sort_into_cells(points[image], valid[image], height, width, edge)
        for i in range(height):
            for j in range(width):
                n = nearest_in_cells(float(j), float(i), edge, cells) if inside[image, i, j] else -1
                if n < 0 or not asked[image, n]:
                    continue
                by_x, by_y = points[image, n, 0] - j, points[image, n, 1] - i
                squared = (by_x * by_x + by_y * by_y) * area
                if squared > covered:
                    kept = reach / (reach + squared)
                    loss += squared * kept * area
                    slope[image, n, 0] += 2.0 * area * area * kept * kept * by_x
                    slope[image, n, 1] += 2.0 * area * area * kept * kept * by_y
        for n in range(points.shape[1]):
            x, y = points[image, n, 0], points[image, n, 1]
            # What lies outside the image is unknown, not background.
            left, top, right, bottom = bounds[image, 0], bounds[image, 1], bounds[image, 2], bounds[image, 3]
            if not (counted[image, n] > 0.0 and x >= left and x <= right and y >= top and y <= bottom):
                continue
            # Beside the mask's part of the image it is background like that part's rim.
            i, j = int(np.rint(min(max(y, 0.0), height - 1.0))), int(np.rint(min(max(x, 0.0), width - 1.0)))
            if not outside[image, i, j] or rows[image, i, j] < 0:
                continue
            by_x, by_y = points[image, n, 0] - columns[image, i, j], points[image, n, 1] - rows[image, i, j]
            squared = (by_x * by_x + by_y * by_y) * area
            kept = reach / (reach + squared)
            share = weight[image] * counted[image, n]
            loss += share * squared * kept
            slope[image, n, 0] += 2.0 * share * area * kept * kept * by_x
            slope[image, n, 1] += 2.0 * share * area * kept * kept * by_y
        sums[image] = loss
