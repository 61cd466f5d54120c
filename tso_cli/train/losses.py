"""Training losses: Chamfer distance to targets (PSGN-FC), masks through the projector (CAPNet)."""

from __future__ import annotations

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

# The supplement of the paper: "reduced to 0.02 of its initial value upon loss saturation".
DROP = 0.02
Silhouette = Callable[[Projected, CameraBatch], Tensor]


def point_loss(points: Tensor, batch: Batch) -> tuple[Tensor, float, float]:
    """Chamfer distance of predicted points [B, N, 3] and the targets, and its two directions.

    Each is a mean over the batch.
    """
    if len({len(target) for target in batch.targets}) == 1:
        pairs = [(points, np.stack(batch.targets))]
    else:
        pairs = [
            (cloud[None], target[None]) for cloud, target in zip(points, batch.targets, strict=True)
        ]
    distances = [
        chamfer(clouds, torch.as_tensor(targets, device=points.device)) for clouds, targets in pairs
    ]
    forward, backward = (torch.cat(parts).mean() for parts in zip(*distances, strict=True))
    return forward + backward, float(forward.detach()), float(backward.detach())


def mask_loss_by_category(
    points: Tensor,
    batch: Batch,
    sigma_sq: float,
    by_category: Mapping[str, float],
    weight: float,
    form: str,
) -> tuple[Tensor, float, float]:
    """`mask_loss` with the sigma^2 ``by_category``; ``sigma_sq`` for all other categories."""
    variances = np.array([by_category.get(category, sigma_sq) for category in batch.categories])
    if (variances == variances[0]).all():
        return mask_loss(points, batch, float(variances[0]), weight, form)
    loss, bce, outliers = points.new_zeros(()), 0.0, 0.0
    for variance in np.unique(variances):
        index = np.flatnonzero(variances == variance)
        chosen = points[torch.as_tensor(index, device=points.device)]
        part = mask_loss(chosen, batch.select(index), float(variance), weight, form)
        share = len(index) / len(variances)
        loss = loss + share * part[0]
        bce, outliers = bce + share * part[1], outliers + share * part[2]
    return loss, bce, outliers


def mask_loss(
    points: Tensor,
    batch: Batch,
    sigma_sq: float,
    weight: float,
    form: str,
    silhouette: Silhouette | None = None,
) -> tuple[Tensor, float, float]:
    """BCE + lambda * affinity (Eq. 4 to 6) of predicted points [B, N, 3].

    It is summed over views, mean over the batch. The affinity includes the squared distance, px^2,
    from each point outside the crop to the edge of the crop: BCE does not see such points, and the
    object lies inside the crop.

    Parameters
    ----------
    weight, form : lambda, and the form of Eq. 5.
    silhouette : returns the sums s [B, V, H, W] of another projection. BCE then has the gradient of
        these sums alone.

    Returns the loss, and the values of BCE and of the affinity (before its weight).
    """

    def like(array: Any) -> Tensor:
        return torch.as_tensor(array, dtype=points.dtype, device=points.device)

    height, width = batch.masks.shape[-2:]
    cameras = CameraBatch(like(batch.K), like(batch.R), like(batch.t), width, height)
    projected = project(points, cameras)
    if silhouette:
        sums = silhouette(projected, cameras)
    else:
        sums = silhouette_sums(projected, cameras, sigma_sq)
    images = sums, like(batch.masks), like(batch.known)
    sums, masks, known = (each.flatten(0, 1) for each in images)  # [B V, H, W]
    points_px, valid = projected.points_px.flatten(0, 1), projected.valid.flatten(0, 1)
    bce_points = points_px.detach() if silhouette else points_px
    bce = silhouette_bce(sums, masks, bce_points, valid, sigma_sq, known).sum() / len(points)
    if weight == 0.0:
        return bce, float(bce.detach()), 0.0
    outliers = affinity(sums, masks, points_px, valid, form)
    edge = points_px.new_tensor([width - 0.5, height - 0.5])
    beyond = points_px - torch.minimum(points_px.clamp(min=-0.5), edge)
    outliers = outliers + (beyond.square().sum(-1) * valid).sum(-1)
    outliers = outliers.sum() / len(points)
    return bce + weight * outliers, float(bce.detach()), float(outliers.detach())


@dataclass
class AffinitySchedule:
    """lambda of Eq. 6, which drops once, to 0.02 of its value, when the loss saturates.

    The loss is saturated if its mean over the last ``window`` steps is not smaller, by the relative
    ``gain``, than its mean over the ``window`` steps before. ``total`` and ``count`` belong to the
    current window, ``previous`` is the mean of the last full window.
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
        """Record the loss of ``step`` (counted from 1)."""
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

    @classmethod
    def from_json(cls, values: Any, name: str) -> AffinitySchedule:
        """The schedule with these fields; InputError with the file's ``name`` if they are wrong."""
        fields = asdict(cls(0.0))
        numbers = isinstance(values, dict) and all(
            isinstance(value, (int, float, type(None))) for value in values.values()
        )
        if not numbers or set(values) != set(fields):
            raise InputError(
                f"{name}: the schedule in the training state is damaged, "
                f"expected numbers for {', '.join(fields)}"
            )
        return cls(**values)
