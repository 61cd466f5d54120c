"""One training step: its batches, predictions and loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from ..network.model import BaseNetwork
from .batches import Batch, Drawing, draw_batch
from .config import TrainConfig
from .data import TrainingData
from .losses import mask_loss_by_category, point_loss
from .processes import Processes

# From clouds [B, N, 3], their batch and lambda to the loss and two parts of it for the history.
Objective = Callable[[Tensor, Batch, float], tuple[Tensor, float, float]]


def draw_step(
    data: TrainingData,
    masked: TrainingData | None,
    config: TrainConfig,
    processes: Processes,
    step: int,
    targets: bool = False,
) -> list[Batch]:
    """This process's part of a step: one batch, or with "joint" one of points and one of masks.

    With ``targets`` a batch for supervision with masks holds the points too.
    """
    part = (processes.rank, processes.count)
    size = config.batch_size // (2 if masked else 1)
    drawing = Drawing(
        config.seed, size, config.frame, balance=config.balance, augment=config.augment
    )
    if config.supervision == "masks":
        drawing = replace(drawing, views=config.views, targets=targets)
        return [draw_batch(data, drawing, step, part)]
    batches = [draw_batch(data, drawing, step, part)]
    if masked:
        drawing = replace(drawing, views=1, input_supervises=True, targets=False)
        batches.append(draw_batch(masked, drawing, step, part))
    return batches


def batch_loss(
    clouds: list[Tensor], batches: list[Batch], config: TrainConfig, weight: float
) -> tuple[Tensor, float, float]:
    """The loss and two parts of it: forward and backward, BCE and affinity, or Chamfer and BCE."""
    projected = (config.sigma_sq, config.category_sigma_sq, weight, config.affinity)
    if config.supervision == "masks":
        return mask_loss_by_category(clouds[0], batches[0], *projected)
    loss, forward, backward = point_loss(clouds[0], batches[0])
    if config.supervision == "points":
        return loss, forward, backward
    mask, bce, _ = mask_loss_by_category(clouds[1], batches[1], *projected)
    return config.joint_weight * loss + mask, forward + backward, bce


def predict(network: BaseNetwork, batches: list[Batch], precision: str) -> list[Tensor]:
    """Clouds [B, N, 3] float32 of each batch; the layers run in mixed precision with "bfloat16"."""
    device = next(network.parameters()).device
    with torch.autocast(device.type, torch.bfloat16, enabled=precision == "bfloat16"):
        images = [torch.as_tensor(batch.images, device=device) for batch in batches]
        # Channels last, like the network's weights.
        clouds = [network(each.contiguous(memory_format=torch.channels_last)) for each in images]
    return [cloud.float() for cloud in clouds]
