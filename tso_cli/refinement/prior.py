"""The position prior: what it costs the points of a cloud to leave their start."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..silhouette.mask_chamfer import REFERENCE_POINTS
from .objective import MaskChamferObjective, ViewTargets
from .presets import CoarseToFineConfig
from .smooth_field import SmoothField

# Robust scale, px of a mask of 64, of the loss that tells how wrong the start is.
ROBUST_SCALE = 4.0
# A part of the cloud is held by its own loss where that, averaged with this smoothness, is over so many px^2 per mask pixel.
LOCAL_LOSS, LOCAL_SMOOTHNESS = 1.0, 1.0


@dataclass(frozen=True, eq=False)
class PositionPrior:
    """``sum_i w_i |x_i - x0_i|^2`` of each of B clouds."""

    initial: Tensor  # [B, N, 3]
    weights: Tensor  # [B, N]

    def __call__(self, points: Tensor) -> Tensor:
        return (self.weights * (points - self.initial).square().sum(2)).sum(1)


def position_prior(
    initial: Tensor,
    counts: Tensor,
    targets: ViewTargets,
    field: SmoothField,
    config: CoarseToFineConfig,
    evidence: Tensor | None = None,
) -> PositionPrior:
    """The prior of clouds ``initial`` [B, N, 3]: the better the start fits its views, the more it is held.

    Parameters
    ----------
    targets, field : of the start.
    evidence : [B], `Problem.evidence`; None for one mask. The more views, the less the start is needed: the least prior
        weight falls with its square.
    """
    objective = MaskChamferObjective(targets, ROBUST_SCALE)
    loss = (objective(initial) / targets.pixels).unsqueeze(1)  # px^2 per mask pixel
    if config.local_prior:
        of_points = objective.per_point(initial) * (counts.to(initial) / targets.pixels).unsqueeze(1)
        local = field.averaged(of_points, LOCAL_SMOOTHNESS)
        loss = torch.maximum(loss, torch.where(local > LOCAL_LOSS, local, 0.0))
    least = (config.least_prior_weight / squared_evidence(evidence, initial)).unsqueeze(1)
    weights = torch.maximum((config.prior_weight / loss**config.prior_decay).clamp_max(config.most_prior_weight), least)
    weights = weights * (REFERENCE_POINTS / counts).to(initial).unsqueeze(1)
    # By area, a piece of surface is held alike whether its points are few or many.
    areas = field.areas(initial, counts) if config.by_area else torch.ones_like(initial[..., 0])
    weights = torch.where(targets.truncated.unsqueeze(1), config.truncated_prior * weights, weights)
    return PositionPrior(initial, weights * areas)


def squared_evidence(evidence: Tensor | None, like: Tensor) -> Tensor:
    """[B]"""
    return torch.ones_like(like[:, 0, 0]) if evidence is None else evidence.to(like).square()
