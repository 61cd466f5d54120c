"""Training with the projections of `kernels.discrete` in place of the paper's."""

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
from .discretised import UPSAMPLING, discrete_depth, discrete_mask

GAUSSIAN, PLAIN, DEPTH = "gaussian", "plain", "depth"
PROJECTIONS = (PLAIN, DEPTH)
# The sum s whose tanh is 0.999: a pixel that is wrong costs -log 0.001, not infinity.
FILLED = 3.8002


def silhouette_sums(projected: Projected, cameras: CameraBatch) -> Tensor:
    """Sums [B, V, H, W] whose tanh is the plain discretised projection; without gradient."""
    points_px, valid = projected
    marks = discrete_mask(points_px.flatten(0, 1), valid.flatten(0, 1), cameras.height, cameras.width)
    return FILLED * marks.view(*points_px.shape[:2], cameras.height, cameras.width)


def depth_loss(points: Tensor, batch: Batch, upsampling: int = UPSAMPLING) -> Tensor:
    """L1 distance of Lin et al.'s depth maps of predicted points [B, N, 3] and of the batch's targets.

    The sum over views and over pixels in which both show a point, mean over the batch; a difference in depth counts as the
    pixels that it would span across the picture at that depth, so that it compares with the other losses.
    """
    height, width = batch.masks.shape[-2:]
    terms = []
    for b, ours in enumerate(points):
        K, R, t = (torch.as_tensor(value[b], dtype=points.dtype, device=points.device) for value in (batch.K, batch.R, batch.t))
        cameras = CameraBatch(K, R, t, width, height)
        theirs = torch.as_tensor(batch.targets[b], dtype=points.dtype, device=points.device)
        shown, hit = depth_map(ours, cameras, upsampling)
        with torch.no_grad():
            true, there = depth_map(theirs, cameras, upsampling)
        both = hit & there
        scale = (K[:, 0, 0].view(-1, 1, 1) / torch.where(there, true, 1.0)) * both
        terms.append(((shown - true).abs() * scale).sum())
    return torch.stack(terms).mean()


def depth_map(points: Tensor, cameras: CameraBatch, upsampling: int) -> tuple[Tensor, Tensor]:
    """Lin et al.'s depth map [V, H, W] of one cloud [N, 3], 0 where it shows no point, and where it shows one."""
    points_px, valid = project(points.unsqueeze(0), cameras)
    depth = (points @ cameras.R.transpose(-1, -2))[..., 2] + cameras.t[:, 2:]  # [V, N]
    return discrete_depth(points_px[0], depth, valid[0], cameras.height, cameras.width, upsampling)


def bce_gradient(points: Tensor, batch: Batch, sigma_sq: float, silhouette: Silhouette | None) -> float:
    """Root mean square over points of the derivative of BCE by a point, [B, N, 3]; 0 where the projection has none."""
    moved = points.detach().requires_grad_(True)
    loss = mask_loss(moved, batch, sigma_sq, 0.0, "points", silhouette)[0]
    if not loss.requires_grad:
        return 0.0
    (gradient,) = torch.autograd.grad(loss, moved, allow_unused=True)
    return 0.0 if gradient is None else float(gradient.square().sum(-1).mean().sqrt())


def projected_objective(config: TrainConfig, projection: str) -> Objective:
    """The loss of training with masks through another projection; the affinity loss works on the points themselves.

    Parameters
    ----------
    projection : "plain", the discretised one: BCE has no gradient, so that all that moves points is the affinity loss.
        "depth", Lin et al.'s: the same, and the L1 loss of depth maps, made of the targets, moves points toward and away from
        the camera. "gaussian", the paper's, is what `train.train` has by itself.
    """
    silhouette = None if projection == GAUSSIAN else silhouette_sums

    def objective(points: Tensor, batch: Batch, weight: float) -> tuple[Tensor, float, float]:
        loss, bce, outliers = mask_loss(points, batch, config.sigma_sq, weight, config.affinity, silhouette)
        return (loss + depth_loss(points, batch) if projection == DEPTH else loss), bce, outliers

    return objective


def first_gradients(data: TrainingData, config: TrainConfig) -> dict[str, float]:
    """`bce_gradient` at the first step of a training: "own", of a discrete projection, and "gaussian", of the paper's."""
    state = start(data, config)
    batch = draw_step(data, None, config, Processes(), 0)[0]
    with torch.no_grad():
        points = state.network(images_of(batch, next(state.network.parameters()).device))
    named = {"own": silhouette_sums, GAUSSIAN: None}
    return {name: bce_gradient(points, batch, config.sigma_sq, silhouette) for name, silhouette in named.items()}
