"""The mask Chamfer loss as one compiled loop on the CPU; its reference is in `tso_cli.silhouette.mask_chamfer`."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .jit import PrecomputedGradient, compiled, share
from .nearest_numba import cell_edge, nearest_in_cells, sort_into_cells


def mask_chamfer_loss(
    points_px: Tensor,
    valid: Tensor,
    observed: Tensor,
    weights: Tensor,
    masks: tuple[Tensor, ...],
    within: Tensor,
    scale: float,
    robust_scale: float,
) -> Tensor:
    """As `tso_cli.silhouette.mask_chamfer.mask_chamfer_loss`.

    ``observed`` [M, N] points may be attracted by pixels; ``weights`` [M, N] are of points on background; ``masks`` are
    `MaskTarget`'s inside, outside, nearest_rows, nearest_columns and bounds; points cover pixels ``within`` [M] px.
    """
    total, gradient = points_px.new_empty(len(points_px)), torch.zeros_like(points_px, memory_format=torch.contiguous_format)
    height, width = masks[0].shape[1:]
    steps = 16 * masks[0].numel() + 16 * valid.numel()
    share(len(valid), steps, _mask_chamfer, points_px, valid, observed, weights, *masks, within,
          cell_edge(height, width, points_px.shape[1]), scale, robust_scale**2, total, gradient)  # fmt: skip
    return PrecomputedGradient.apply(points_px, total, gradient)


@compiled
def _mask_chamfer(  # type: ignore[no-untyped-def]
    first, last, points, valid, observed, weights, inside, outside, rows, columns, bounds, within,
    edge, scale, robust, total, gradient,
):  # fmt: skip
    height, width = inside.shape[1:]
    area = scale * scale
    for image in range(first, last):
        loss, covered = 0.0, within[image] * within[image] * area
        cells = sort_into_cells(points[image], valid[image], height, width, edge)
        for i in range(height):
            for j in range(width):
                n = nearest_in_cells(float(j), float(i), edge, cells) if inside[image, i, j] else -1
                if n < 0 or not observed[image, n]:
                    continue
                by_x, by_y = points[image, n, 0] - j, points[image, n, 1] - i
                squared = (by_x * by_x + by_y * by_y) * area
                if squared > covered:
                    inlier = robust / (robust + squared)
                    loss += squared * inlier * area
                    gradient[image, n, 0] += 2.0 * area * area * inlier * inlier * by_x
                    gradient[image, n, 1] += 2.0 * area * area * inlier * inlier * by_y
        left, top, right, bottom = bounds[image, 0], bounds[image, 1], bounds[image, 2], bounds[image, 3]
        for n in range(points.shape[1]):
            x, y, weight = points[image, n, 0], points[image, n, 1], weights[image, n]
            # What lies outside the image is unknown, not background.
            if not (weight > 0.0 and x >= left and x <= right and y >= top and y <= bottom):
                continue
            # Beside the mask's part of the image it is background like that part's rim.
            i, j = int(np.rint(min(max(y, 0.0), height - 1.0))), int(np.rint(min(max(x, 0.0), width - 1.0)))
            if not outside[image, i, j] or rows[image, i, j] < 0:
                continue
            by_x, by_y = x - columns[image, i, j], y - rows[image, i, j]
            squared = (by_x * by_x + by_y * by_y) * area
            inlier = robust / (robust + squared)
            loss += weight * squared * inlier
            gradient[image, n, 0] += 2.0 * weight * area * inlier * inlier * by_x
            gradient[image, n, 1] += 2.0 * weight * area * inlier * inlier * by_y
        total[image] = loss
