"""What the paper's studies add: other projections to train through, and measures of clouds.

The projections are those that the paper compares with: points rounded to pixels, and the depth maps
of Lin et al. Both fall onto whole pixels, so that their derivative by a point's column and row is
zero wherever it exists.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.points import Array
from tso_cli.silhouette.projection import CameraBatch, Projected, project
from tso_cli.train.batches import Batch
from tso_cli.train.config import TrainConfig
from tso_cli.train.data import TrainingData
from tso_cli.train.losses import mask_loss
from tso_cli.train.step import Objective

from ..study import Record
from .material import INPUT_VIEWS, Predicted

OUTLIER_PX = 1.0
"""A projected point further than this outside the mask of the 64x64 crop is an outlier."""
BODY = (0.08, 0.28)
"""Where, from the nose in lengths, an aeroplane has neither wing nor tail."""
FEWEST = 5
"""Points that show a size."""
ENDS = (5.0, 95.0)
"""Percentiles that a size is measured between."""


def outlier_shares(predicted: list[Predicted], data: TrainingData) -> Record:
    """Mean fraction of outliers in views that the network was not given, by category."""
    fractions: dict[str, list[float]] = {}
    for shape in predicted:
        numbers = range(INPUT_VIEWS, len(data.objects[shape.index].views))
        views = [data.prepared(shape.index, number) for number in numbers]
        for points in shape.points:
            shares = [outliers(view.camera.project(points)[0], view.mask).mean() for view in views]
            fractions.setdefault(shape.category, []).append(float(np.mean(shares)))
    return {"outliers": {category: float(np.mean(means)) for category, means in fractions.items()}}


def outliers(pixels: Array, mask: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which projected points [N, 2] (column, row) are over `OUTLIER_PX` outside the mask [H, W].

    Distances are from the edge of the mask, half a pixel beyond the centres of its pixels (> 0.5).
    A point that is not finite is an outlier.
    """
    finite = np.asarray(np.isfinite(pixels).all(1))
    inside = cKDTree(np.argwhere(mask > 0.5)[:, ::-1])
    distance, _ = inside.query(np.where(finite[:, None], pixels, 0.0))
    return np.asarray(~finite | (distance > OUTLIER_PX + 0.5))


def sizes(predicted: list[Predicted], data: TrainingData) -> Record:
    """Sizes of unseen aeroplanes (medians) and errors of unseen cars (means)."""
    planes, cars = [], []
    for shape in predicted:
        for view, (points, target) in enumerate(zip(shape.points, shape.target, strict=True)):
            if shape.category == "airplane":
                planes.append(aeroplane_sizes(points, target))
            if shape.category == "car":
                turn = data.objects[shape.index].views[view].camera.R.T
                cars.append(depth_errors(points @ turn, target @ turn))
    groups: dict[str, tuple[list[dict[str, float]], Any]]
    groups = {"aeroplanes": (planes, np.nanmedian), "cars": (cars, np.mean)}
    return {
        key: {name: float(average([row[name] for row in rows])) for name in rows[0]}
        for key, (rows, average) in groups.items()
        if rows
    }


def aeroplane_sizes(points: Array, target: Array) -> dict[str, float]:
    """Sizes of a predicted aeroplane [N, 3] over the true sizes [M, 3]: body, span, length.

    y is up. Of x and z, the axis across is the one in which the truth is more symmetric; the nose
    is at its narrower end. Sizes are from the 5th to the 95th percentile; the body's are taken
    between nose and wing. NaN where fewer than 5 points show one.
    """
    flips = {axis: target * (1.0 - 2.0 * np.eye(3)[axis]) for axis in (0, 2)}
    across = min(flips, key=lambda axis: chamfer(flips[axis], target).chamfer)
    along = 2 - across
    low, high = target[:, along].min(), target[:, along].max()
    place = (target[:, along] - low) / (high - low)
    nose_first = np.ptp(target[place < 0.2, across]) <= np.ptp(target[place > 0.8, across])

    def body(cloud: Array) -> Array:
        behind = (cloud[:, along] - low) / (high - low)
        behind = behind if nose_first else 1.0 - behind
        return cloud[(behind > BODY[0]) & (behind < BODY[1])]

    bodies = body(points), body(target)
    of_body = {"body_width": _ratio(*bodies, across), "body_height": _ratio(*bodies, 1)}
    whole = {"span": _ratio(points, target, across), "length": _ratio(points, target, along)}
    return of_body | whole


def depth_errors(points: Array, target: Array) -> dict[str, float]:
    """Errors of a prediction [N, 3] along and across the line of sight, in axes of the camera.

    ``depth`` and ``across`` are mean squares of the components of the vectors to the nearest
    points, both directions added, per axis; ``extent`` is predicted over true depth.
    """
    squares = np.zeros(3)
    for queries, cloud in ((points, target), (target, points)):
        squares += np.square(queries - cloud[cKDTree(cloud).query(queries)[1]]).mean(0)
    errors = {"depth": float(squares[2]), "across": float(squares[:2].mean())}
    return errors | {"extent": _ratio(points, target, 2)}


def _ratio(points: Array, target: Array, axis: int) -> float:
    if min(len(points), len(target)) < FEWEST:
        return float("nan")
    size, true = (float(np.diff(np.percentile(c[:, axis], ENDS))[0]) for c in (points, target))
    return size / true if true > 0.0 else float("nan")


# Projections.

UPSAMPLING = 5
"""U of the paper's comparison."""
PLAIN, DEPTH = "plain", "depth"
FILLED = 3.8002
"""The sum s whose tanh is 0.999: a wrong pixel costs -log 0.001, not infinity."""


def discrete_depth(
    points_px: Tensor,
    depth: Tensor,
    valid: Tensor,
    height: int,
    width: int,
    upsampling: int = UPSAMPLING,
) -> tuple[Tensor, Tensor]:
    """Lin et al.'s projection: each pixel shows the nearest depth on an ``upsampling`` finer grid.

    A cell of the finer grid keeps its last point, whatever the depths: a finer grid makes such
    collisions rare.

    points_px : [M, N, 2] column and row of each point; a pixel reaches half a pixel around them.
    valid : [M, N] bool; other points leave no mark. depth : [M, N], above 0 where valid.

    Returns depths [M, height, width], 0 where no point falls, each differentiable by the depth of
    the point that it shows; and whether a point falls there.
    """
    fine_cell = torch.floor((points_px.detach() + 0.5) * upsampling)
    size = fine_cell.new_tensor([width * upsampling, height * upsampling])
    inside = valid & (fine_cell >= 0.0).all(-1) & (fine_cell < size).all(-1)
    column, row = torch.where(inside.unsqueeze(-1), fine_cell, 0.0).long().unbind(-1)
    cell = row * (width * upsampling) + column  # 0 where there is none
    # Points count from 1; 0 stands for none, at inverse depth 0.
    numbers = torch.arange(1, points_px.shape[1] + 1, device=points_px.device) * inside
    empty = numbers.new_zeros(len(cell), height * width * upsampling**2)
    last = empty.scatter_reduce_(1, cell, numbers, "amax")
    inverse = torch.where(inside, 1.0 / torch.where(inside, depth, 1.0), 0.0)
    fine = torch.nn.functional.pad(inverse, (1, 0)).gather(1, last)
    fine = fine.view(-1, 1, height * upsampling, width * upsampling)
    nearest = torch.nn.functional.max_pool2d(fine, upsampling).squeeze(1)
    hit = nearest > 0.0
    return torch.where(hit, 1.0 / torch.where(hit, nearest, 1.0), 0.0), hit


def silhouette_sums(projected: Projected, cameras: CameraBatch) -> Tensor:
    """Sums [B, V, H, W] whose tanh is 1 where a point is rounded to; without gradient."""
    points_px, valid = projected.points_px.detach().flatten(0, 1), projected.valid.flatten(0, 1)
    depth, size = torch.ones_like(points_px[..., 0]), (cameras.height, cameras.width)
    hit = discrete_depth(points_px, depth, valid, *size, upsampling=1)[1]
    return FILLED * hit.to(points_px.dtype).unflatten(0, projected.valid.shape[:2])


def depth_loss(points: Tensor, batch: Batch) -> Tensor:
    """L1 distance of the depth maps of predicted points [B, N, 3] and of the batch's targets.

    The sum over views and over pixels in which both show a point, mean over the batch. A
    difference in depth counts as the pixels that it would span across the picture at that depth,
    so that it compares with the other losses.
    """
    height, width = batch.masks.shape[-2:]
    losses = []
    for b, cloud in enumerate(points):
        K, R, t, target = (
            torch.as_tensor(values[b]).to(points)
            for values in (batch.K, batch.R, batch.t, batch.targets)
        )
        cameras = CameraBatch(K, R, t, width, height)
        depth, hit = depth_map(cloud, cameras)
        true, true_hit = depth_map(target, cameras)
        scale = K[:, 0, 0].view(-1, 1, 1) / torch.where(true_hit, true, 1.0)
        losses.append(((depth - true).abs() * scale * (hit & true_hit)).sum())
    return torch.stack(losses).mean()


def depth_map(points: Tensor, cameras: CameraBatch) -> tuple[Tensor, Tensor]:
    """Lin et al.'s depth map [V, H, W] of one cloud [N, 3], 0 where no point falls; and where."""
    points_px, valid = project(points.unsqueeze(0), cameras)
    depth = (points @ cameras.R.transpose(-1, -2))[..., 2] + cameras.t[:, 2:]  # [V, N]
    return discrete_depth(points_px[0], depth, valid[0], cameras.height, cameras.width)


def projected_objective(config: TrainConfig, projection: str) -> Objective:
    """The loss of training with masks through another projection.

    The affinity loss works on the points themselves.

    projection : "plain", rounded points: BCE has no gradient, only the affinity loss moves points.
        "depth": the L1 loss of depth maps also moves points along the line of sight.
    """

    def objective(points: Tensor, batch: Batch, weight: float) -> tuple[Tensor, float, float]:
        loss, bce, outliers = mask_loss(
            points, batch, config.sigma_sq, weight, config.affinity, silhouette_sums
        )
        return (loss + depth_loss(points, batch) if projection == DEPTH else loss), bce, outliers

    return objective
