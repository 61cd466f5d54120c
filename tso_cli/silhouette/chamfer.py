"""Chamfer distance between clouds, and from initial clouds to their moved copies (Eq. 7)."""

from __future__ import annotations

import torch
from torch import Tensor

from ..kernels.dispatch import use_numba, whole_batches
from ..kernels.nearest import StaticNearest, nearest_both_ways, nearest_in_rows


def chamfer(prediction: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Chamfer distance between ``prediction`` [B, N, 3] and ``target`` [B, M, 3], differentiable in both.

    Returns
    -------
    forward [B], target -> prediction, and backward [B], prediction -> target: squared distances, mean over points.
    """
    to_target, to_prediction = nearest_both_ways(prediction, target)
    forward = target - torch.take_along_dim(prediction, to_prediction.unsqueeze(-1), 1)
    backward = prediction - torch.take_along_dim(target, to_target.unsqueeze(-1), 1)
    return forward.square().sum(-1).mean(-1), backward.square().sum(-1).mean(-1)


class ChamferToInitial:
    """The regulariser d(y, y^) of Eq. 7: Chamfer between initial clouds and the same clouds being moved.

    Of ``initial`` [B, N, 3] the first ``counts`` [B] points of each row exist; None for all.
    """

    def __init__(self, initial: Tensor, counts: Tensor | None = None) -> None:
        self.initial = initial.detach()
        self.counts = torch.full((len(initial),), initial.shape[1]) if counts is None else counts
        self._compiled = use_numba(self.initial)
        if self._compiled:
            from ..kernels.static_chamfer_numba import StaticTrees

            self._trees = StaticTrees(self.initial, self.counts)
        elif whole_batches(self.initial):
            exists = torch.arange(initial.shape[1]) < self.counts.unsqueeze(1)
            self._exists = exists.to(initial.device)
            self._mean = (exists / self.counts.unsqueeze(1)).to(self.initial)
        else:
            rows = zip(self.initial, self.counts.tolist(), strict=True)
            self._nearest = [StaticNearest(cloud[:count]) for cloud, count in rows]

    def __call__(self, points: Tensor) -> Tensor:
        """Both directions summed [B], squared distances, mean over points; differentiable in ``points`` [B, N, 3]."""
        if self._compiled:
            return self._trees.chamfer(points)
        if whole_batches(points):
            to_points = nearest_in_rows(self.initial, points, self._exists, self._exists).clamp_min_(0)
            to_initial = nearest_in_rows(points, self.initial, self._exists, self._exists).clamp_min_(0)
            forward = self.initial - torch.take_along_dim(points, to_points.unsqueeze(-1), 1)
            backward = points - torch.take_along_dim(self.initial, to_initial.unsqueeze(-1), 1)
            return ((forward.square() + backward.square()).sum(-1) * self._mean).sum(-1)
        terms = []
        for start, moved, nearest in zip(self.initial, points, self._nearest, strict=True):
            start, moved = start[: len(nearest.start)], moved[: len(nearest.start)]
            to_moved, to_start = nearest(moved)
            forward = (start - moved[to_moved]).square().sum(1).mean()
            terms.append(forward + (moved - start[to_start]).square().sum(1).mean())
        return torch.stack(terms)
