"""Training with the projections of `discretised` in place of the paper's."""

from __future__ import annotations

import torch
from torch import Tensor

from ...silhouette.projection import CameraBatch, Projected, project
from ...train import TrainConfig, start
from ...train.batches import Batch
from ...train.data import TrainingData
from ...train.losses import Silhouette, mask_loss
from ...train.processes import Processes
from ...train.step import Objective, draw_step, images_of
from .discretised import discrete_depth, discrete_mask

GAUSSIAN, PLAIN, DEPTH = "gaussian", "plain", "depth"
PROJECTIONS = (PLAIN, DEPTH)
# The sum s whose tanh is 0.999: a wrong pixel costs -log 0.001, not infinity.
FILLED = 3.8002


def silhouette_sums(projected: Projected, cameras: CameraBatch) -> Tensor:
    """Sums [B, V, H, W] whose tanh is the plain discretised projection; without gradient."""
    points_px, valid = projected
    marks = discrete_mask(points_px.flatten(0, 1), valid.flatten(0, 1), cameras.height, cameras.width)
    return FILLED * marks.unflatten(0, points_px.shape[:2])


def depth_loss(points: Tensor, batch: Batch) -> Tensor:
    """L1 distance of Lin et al.'s depth maps of predicted points [B, N, 3] and of the batch's targets.

    The sum over views and over pixels in which both show a point, mean over the batch. A difference in depth counts as the
    pixels that it would span across the picture at that depth, so that it compares with the other losses.
    """
    height, width = batch.masks.shape[-2:]
    losses = []
    for b, cloud in enumerate(points):
        K, R, t, target = (
            torch.as_tensor(values[b], dtype=points.dtype, device=points.device)
            for values in (batch.K, batch.R, batch.t, batch.targets)
        )
        cameras = CameraBatch(K, R, t, width, height)
        depth, hit = depth_map(cloud, cameras)
        true, true_hit = depth_map(target, cameras)
        both = hit & true_hit
        scale = K[:, 0, 0].view(-1, 1, 1) / torch.where(true_hit, true, 1.0)
        losses.append(((depth - true).abs() * scale * both).sum())
    return torch.stack(losses).mean()


def depth_map(points: Tensor, cameras: CameraBatch) -> tuple[Tensor, Tensor]:
    """Lin et al.'s depth map [V, H, W] of one cloud [N, 3], 0 where it shows no point, and where it shows one."""
    points_px, valid = project(points.unsqueeze(0), cameras)
    depth = (points @ cameras.R.transpose(-1, -2))[..., 2] + cameras.t[:, 2:]  # [V, N]
    return discrete_depth(points_px[0], depth, valid[0], cameras.height, cameras.width)


def projected_objective(config: TrainConfig, projection: str, bounded: bool = True) -> Objective:
    """The loss of training with masks through another projection; the affinity loss works on the points themselves.

    Parameters
    ----------
    projection : "plain", the discretised one: BCE has no gradient, only the affinity loss moves points. "depth", Lin et al.'s:
        the L1 loss of depth maps, made of the targets, also moves points along the line of sight. "gaussian", the paper's.
    bounded : see `mask_loss`.
    """
    silhouette = None if projection == GAUSSIAN else silhouette_sums

    def objective(points: Tensor, batch: Batch, weight: float) -> tuple[Tensor, float, float]:
        loss, bce, outliers = mask_loss(points, batch, config.sigma_sq, weight, config.affinity, silhouette, bounded)
        return (loss + depth_loss(points, batch) if projection == DEPTH else loss), bce, outliers

    return objective


def bce_gradient(points: Tensor, batch: Batch, sigma_sq: float, silhouette: Silhouette | None) -> float:
    """Root mean square over points [B, N, 3] of the derivative of BCE by a point; 0 where the projection has none."""
    leaf = points.detach().requires_grad_(True)
    loss = mask_loss(leaf, batch, sigma_sq, 0.0, "points", silhouette)[0]
    if not loss.requires_grad:
        return 0.0
    (gradient,) = torch.autograd.grad(loss, leaf)
    return float(gradient.square().sum(-1).mean().sqrt())


def first_gradients(data: TrainingData, config: TrainConfig) -> dict[str, float]:
    """`bce_gradient` at the first step of a training: "own", of a discrete projection, and "gaussian", of the paper's."""
    network = start(data, config).network
    batch = draw_step(data, None, config, Processes(), 0)[0]
    with torch.no_grad():
        points = network(images_of(batch, next(network.parameters()).device))
    return {
        "own": bce_gradient(points, batch, config.sigma_sq, silhouette_sums),
        GAUSSIAN: bce_gradient(points, batch, config.sigma_sq, None),
    }
