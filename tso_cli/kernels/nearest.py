"""Exact nearest neighbours: a k-d tree on the CPU, chunked distances elsewhere."""

from __future__ import annotations

import torch
from torch import Tensor

# Pairs compared at once where there is no k-d tree.
PAIRS_PER_CHUNK = 1 << 26


def nearest(queries: Tensor, data: Tensor) -> Tensor:
    """Index into ``data`` of the point nearest to each query.

    Parameters
    ----------
    queries : [Q, D]
    data : [N, D], N >= 1

    Returns
    -------
    [Q] int64 on the queries' device. Nothing is differentiable here; gather with the index and subtract.
    """
    queries, data = queries.detach(), data.detach()
    if queries.device.type == "cpu":
        from scipy.spatial import cKDTree

        tree = cKDTree(data.numpy(), balanced_tree=False, compact_nodes=False)
        return torch.from_numpy(_query(tree, queries)[1])
    size = max(1, PAIRS_PER_CHUNK // len(data))
    return torch.cat([torch.cdist(part, data).argmin(1) for part in queries.split(size)])


def _query(tree, queries: Tensor, k: int = 1):  # type: ignore[no-untyped-def]
    # Threads cost more than they bring for small clouds.
    return tree.query(queries.numpy(), k=k, workers=-1 if len(queries) > 4096 else 1)


class StaticNearest:
    """Nearest neighbours between a cloud that stays and its own moved copy.

    Early in an optimisation a moved point is still nearest to its own start. Where the triangle inequality proves that, no
    search is made; the answers are exact either way.

    Parameters
    ----------
    start : [N, D], the cloud that stays.
    """

    def __init__(self, start: Tensor) -> None:
        self.start = start.detach()
        self.own = torch.arange(len(start), device=start.device)
        self._tree = None
        if start.device.type == "cpu" and len(start) > 1:
            from scipy.spatial import cKDTree

            self._tree = cKDTree(self.start.numpy())
            spacing = torch.from_numpy(_query(self._tree, self.start, k=2)[0][:, 1])
            # A hair less than the true spacing, so that rounding cannot prove what is not so.
            self.spacing = spacing.to(start.dtype) * (1.0 - 1e-5)

    def __call__(self, moved: Tensor) -> tuple[Tensor, Tensor]:
        """Index of the nearest moved point for each start [N], and of the nearest start for each moved point [N]."""
        moved = moved.detach()
        if self._tree is None:
            return nearest(self.start, moved), nearest(moved, self.start)
        distance = (moved - self.start).norm(dim=1)
        to_start, to_moved = self.own, self.own
        # |m_i - s_j| >= |s_i - s_j| - |m_i - s_i|, so s_i is nearest to m_i while m_i moved under half the spacing at s_i.
        doubtful = torch.nonzero(2.0 * distance >= self.spacing).squeeze(1)
        if len(doubtful):
            found = torch.from_numpy(_query(self._tree, moved[doubtful])[1])
            to_start = to_start.index_copy(0, doubtful, found)
        # |s_i - m_j| >= |s_i - s_j| - |m_j - s_j|, and no point moved further than the furthest.
        doubtful = torch.nonzero(distance + distance.max() >= self.spacing).squeeze(1)
        if len(doubtful):
            to_moved = to_moved.index_copy(0, doubtful, nearest(self.start[doubtful], moved))
        return to_moved, to_start
