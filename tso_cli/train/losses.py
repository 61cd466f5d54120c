"""What the network is trained with: Chamfer to the surface (PSGN-FC) or masks through the projector (CAPNet)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..silhouette.affinity import affinity
from ..silhouette.bce import silhouette_bce
from ..silhouette.chamfer import chamfer
from ..silhouette.projection import CameraBatch, Projected, project, silhouette_sums
from .batches import Batch

# The supplement: "reduced to 0.02 of its initial value upon loss saturation".
DROP = 0.02
Silhouette = Callable[[Projected, CameraBatch], Tensor]


def point_loss(points: Tensor, batch: Batch) -> tuple[Tensor, float, float]:
    """Chamfer distance between predicted points [B, N, 3] and the targets, mean over the batch; and its two directions."""
    if len({len(target) for target in batch.targets}) == 1:
        # one call for the whole batch
        pairs = [(points, torch.as_tensor(np.stack(batch.targets), device=points.device))]
    else:
        targets = [torch.as_tensor(target, device=points.device) for target in batch.targets]
        pairs = [(ours.unsqueeze(0), target.unsqueeze(0)) for ours, target in zip(points, targets, strict=True)]
    directions = [chamfer(ours, target) for ours, target in pairs]
    ahead, back = (torch.cat(parts).mean() for parts in zip(*directions, strict=True))
    return ahead + back, float(ahead.detach()), float(back.detach())


def mask_loss_by_category(
    points: Tensor, batch: Batch, sigma_sq: float, by_category: Mapping[str, float], weight: float, form: str
) -> tuple[Tensor, float, float]:
    """`mask_loss` where some categories have a sigma^2 of their own."""
    kernels = np.array([by_category.get(category, sigma_sq) for category in batch.categories])
    if (kernels == kernels[0]).all():
        return mask_loss(points, batch, float(kernels[0]), weight, form)
    total, bce, outliers = points.new_zeros(()), 0.0, 0.0
    for kernel in np.unique(kernels):
        chosen = np.flatnonzero(kernels == kernel)
        share = len(chosen) / len(kernels)
        index = torch.as_tensor(chosen, device=points.device)
        loss, first, second = mask_loss(points[index], batch.select(chosen), float(kernel), weight, form)
        total, bce, outliers = total + share * loss, bce + share * first, outliers + share * second
    return total, bce, outliers


def mask_loss(
    points: Tensor,
    batch: Batch,
    sigma_sq: float,
    weight: float,
    form: str,
    silhouette: Silhouette | None = None,
    bounded: bool = True,
) -> tuple[Tensor, float, float]:
    """BCE + weight * affinity (Eq. 4 to 6) of predicted points [B, N, 3], summed over views, mean over the batch.

    The crop holds the whole object. A point that falls beyond its edge, where no pixel speaks against it, is an outlier too:
    its squared distance to the edge, in pixels, counts as affinity unless ``bounded`` is False. ``silhouette`` gives the sums
    s [B, V, H, W] of another projection; then BCE moves the points by the derivative of those sums alone.

    Returns the loss, and the values of BCE and of the affinity term (before its weight).
    """

    def like(array: Any) -> Tensor:
        return torch.as_tensor(array, dtype=points.dtype, device=points.device)

    height, width = batch.masks.shape[-2:]
    cameras = CameraBatch(like(batch.K), like(batch.R), like(batch.t), width, height)
    projected = project(points, cameras)
    if silhouette is None:
        sums = silhouette_sums(projected, cameras, sigma_sq).flatten(0, 1)  # [B V, H, W]
    else:
        sums = silhouette(projected, cameras).flatten(0, 1)
    masks, known = like(batch.masks).flatten(0, 1), like(batch.known).flatten(0, 1)
    points_px, valid = projected.points_px.flatten(0, 1), projected.valid.flatten(0, 1)
    reached = points_px if silhouette is None else points_px.detach()
    bce = silhouette_bce(sums, masks, reached, valid, sigma_sq, known).sum() / len(points)
    if weight == 0.0:
        return bce, float(bce.detach()), 0.0
    outliers = affinity(sums, masks, points_px, valid, form)
    if bounded:
        outliers = outliers + _beyond(points_px, valid, height, width)
    outliers = outliers.sum() / len(points)
    return bce + weight * outliers, float(bce.detach()), float(outliers.detach())


def _beyond(points_px: Tensor, valid: Tensor, height: int, width: int) -> Tensor:
    """Sum [M] over points of the squared distance to the image, 0 for those inside it."""
    limit = points_px.new_tensor([width - 0.5, height - 0.5])
    inside = torch.minimum(points_px.clamp(min=-0.5), limit)
    return ((points_px - inside).square().sum(-1) * valid).sum(-1)


@dataclass
class AffinitySchedule:
    """lambda, and when it drops to 0.02 of itself.

    The loss counts as saturated when the mean over the last ``window`` steps is not lower, by the relative ``gain``, than
    the mean over the ``window`` steps before them. It drops once.
    """

    initial: float
    window: int = 500
    gain: float = 0.01
    total: float = 0.0
    count: int = 0
    previous: float | None = None
    dropped_at: int | None = None

    @property
    def weight(self) -> float:
        """lambda of the next step."""
        return self.initial * DROP if self.dropped_at is not None else self.initial

    def observe(self, loss: float, step: int) -> None:
        """Take note of the loss of ``step`` (counted from 1)."""
        if self.dropped_at is not None:
            return
        self.total += loss
        self.count += 1
        if self.count < self.window:
            return
        mean = self.total / self.count
        if self.previous is not None and mean > (1.0 - self.gain) * self.previous:
            self.dropped_at = step
        self.previous, self.total, self.count = mean, 0.0, 0

    def to_json(self) -> dict[str, Any]:
        """All of it, exactly."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Any, name: str) -> AffinitySchedule:
        """The schedule that `to_json` gave; InputError naming the file ``name`` if it is not one."""
        template = asdict(cls(0.0))
        if not isinstance(values, dict) or set(values) != set(template):
            raise InputError(f"{name}: the schedule in the training state is damaged, expected {', '.join(template)}")
        for key, value in values.items():
            empty = value is None and template[key] is None
            whole = key in ("window", "count", "dropped_at")
            fits = isinstance(value, int if whole else (int, float)) and not isinstance(value, bool)
            if not empty and not (fits and math.isfinite(value)):
                raise InputError(f"{name}: {key} of the schedule in the training state is damaged, expected a number")
        return cls(**values)
