"""Chamfer distance between clouds (torch)."""

from __future__ import annotations

import torch
from torch import Tensor

from ..kernels.nearest import nearest_both_ways


def chamfer(prediction: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Chamfer distance of ``prediction`` [B, N, 3] and ``target`` [B, M, 3], with gradients.

    Returns
    -------
    forward [B], target -> prediction, and backward [B], prediction -> target. Squared distances,
    mean over points.
    """
    to_target, to_prediction = nearest_both_ways(prediction, target)
    forward = target - torch.take_along_dim(prediction, to_prediction.unsqueeze(-1), 1)
    backward = prediction - torch.take_along_dim(target, to_target.unsqueeze(-1), 1)
    return forward.square().sum(-1).mean(-1), backward.square().sum(-1).mean(-1)
