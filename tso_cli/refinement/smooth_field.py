"""Displacements that take neighbours along: the preconditioner of Nicolet et al. 2021, carried from meshes to clouds."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..geometry.points import spread_subset

# A cloud moves by a field that is known at so many nodes, at most; between them it is interpolated.
NODES = 1024
NEIGHBOURS = 8
PATCH = 12
INTERPOLATED_FROM = 6
# How differently points may count for the surface that they stand for.
AREAS = 0.2, 5.0
# Distances compared at once; bounds memory.
PAIRS_AT_ONCE = 1 << 24


class SmoothField:
    """Displacement fields of B clouds as ``(I + lambda L)^-1 u``, L the graph Laplacian of each cloud's nodes.

    A cloud of up to ``nodes`` points is its own nodes. A larger one has so many, spread by farthest-point sampling, and its
    points take the weighted mean of the six nodes nearest to them: what a field costs to solve does not grow with the cloud.

    "Large Steps in Inverse Rendering of Geometry" (Nicolet, Jacobson, Jakob, 2021) descends in u on a mesh: steps of the
    gradient then move what is connected together, the further the larger lambda. Here the graph is that of the 8 nearest
    neighbours.

    Parameters
    ----------
    points : [B, N, 3]
    counts : [B], how many points of each row are there; None for all.
    nodes : at most so many for each cloud.

    Attributes
    ----------
    shape : B, M, 3 of u, M the largest number of nodes.
    nodes : [B, M] int64, which points are nodes; those behind the last of a cloud are 0, like its points' nodes.
    patches : [B, M, 12] int64, the nodes nearest to each node, itself among them.
    """

    def __init__(self, points: Tensor, counts: Tensor | None = None, nodes: int = NODES) -> None:
        points = points.detach()
        sizes = [points.shape[1]] * len(points) if counts is None else counts.tolist()
        places = [
            torch.from_numpy(spread_subset(cloud[:size].double().cpu().numpy(), nodes))
            for cloud, size in zip(points, sizes, strict=True)
        ]
        most = max(len(own) for own in places)
        self.nodes = _padded(places, most).to(points.device)
        places = [cloud[own] for cloud, own in zip(points, places, strict=True)]
        near = [_nearest_nodes(own) for own in places]
        self.patches = _padded(near, most).to(points.device)
        self.shape = (len(points), most, 3)
        laplacian = [_laplacian(own, index, most) for own, index in zip(places, near, strict=True)]
        # Lambda is stated for 1,024 nodes: with fewer, neighbours are further apart and edges reach further.
        self._laplacian = torch.stack([matrix * (len(own) / NODES) for matrix, own in zip(laplacian, places, strict=True)])
        self._smoothers: dict[float, Tensor] = {}
        self._between: tuple[Tensor, Tensor] | None = None
        if any(size > nodes for size in sizes):
            pairs = [_interpolation(cloud[:size], own) for cloud, size, own in zip(points, sizes, places, strict=True)]
            index = torch.zeros(*points.shape[:2], INTERPOLATED_FROM, dtype=torch.int64)
            weight = torch.zeros(index.shape, dtype=points.dtype)
            for row, (taken, share) in enumerate(pairs):
                index[row, : len(taken), : taken.shape[1]], weight[row, : len(taken), : taken.shape[1]] = taken, share
            index += torch.arange(len(points)).view(-1, 1, 1) * most
            self._between = index.view(-1, INTERPOLATED_FROM).to(points.device), weight.view(-1, INTERPOLATED_FROM).to(points)

    def smoother(self, weight: float) -> Tensor:
        """``(I + weight L)^-1`` [B, M, M] of all clouds; symmetric."""
        if weight not in self._smoothers:
            size = self.shape[1]
            system = torch.eye(size, dtype=self._laplacian.dtype, device=self._laplacian.device) + weight * self._laplacian
            self._smoothers[weight] = torch.stack([torch.cholesky_inverse(torch.linalg.cholesky(one)) for one in system])
        return self._smoothers[weight]

    def of_nearest_node(self, values: Tensor) -> Tensor:
        """[B, N] at the points, the value [B, M] of the node nearest to each."""
        if self._between is None:
            return values
        return values.flatten()[self._between[0][:, 0]].view(len(values), -1)

    def averaged(self, values: Tensor, weight: float) -> Tensor:
        """[B, N] ``values`` at the points, averaged over their surroundings: ``(I + weight L)^-1`` of their sums at the nodes,
        over that of the numbers of points."""
        total, count = values, torch.ones_like(values)
        if self._between is not None:
            index, shares = self._between
            # What lies behind a smaller cloud of a batch is interpolated from nothing.
            there = shares.any(1).to(values)
            total, count = (
                torch.zeros(self.shape[0] * self.shape[1], dtype=values.dtype, device=values.device)
                .index_add(0, index[:, 0], part)
                .view(self.shape[:2])
                for part in (values.flatten() * there, there)
            )
        smoother = self.smoother(weight)
        found = (smoother @ torch.stack([total, count], 2)).unbind(2)
        return self.of_nearest_node(found[0] / found[1].clamp_min(torch.finfo(values.dtype).tiny))

    def areas(self, points: Tensor, counts: Tensor) -> Tensor:
        """[B, N] how much surface each of the ``points`` [B, N, 3] stands for, in units of the mean of its cloud.

        The squared distance of a node to the one next to it, mean over it and its 8 neighbours, is shared by the points that
        it is the nearest node of. Kept within 1/5 and 5. Of clouds [B] with so many points; what is behind them counts 1.
        """
        nodes = torch.take_along_dim(points, self.nodes.unsqueeze(-1), 1)
        beside = torch.take_along_dim(nodes, self.patches[..., 1:2], 1)
        apart = (nodes - beside).square().sum(-1)
        around = self.patches[..., : NEIGHBOURS + 1]
        apart = torch.take_along_dim(apart.unsqueeze(1), around, 2).mean(2)
        there = torch.arange(points.shape[1], device=points.device) < counts.to(points.device).unsqueeze(1)
        if self._between is not None:
            owner = self._between[0][:, 0][there.flatten()]
            apart = apart / torch.bincount(owner, minlength=apart.numel()).view_as(apart).clamp_min(1)
        found = torch.where(there, self.of_nearest_node(apart), 0.0)
        mean = found.sum(1, keepdim=True) / there.sum(1, keepdim=True)
        areas = (found / mean.clamp_min(torch.finfo(points.dtype).tiny)).clamp(*AREAS)
        return torch.where(there & (mean > 0.0), areas, 1.0)

    def displacement(self, smoother: Tensor, values: Tensor) -> Tensor:
        """[B, N, 3] at the points, from ``u`` [B, M, 3] at the nodes; differentiable in ``u``."""
        return self._spread(_Smoothed.apply(values, smoother))

    def _spread(self, values: Tensor) -> Tensor:
        if self._between is None:
            return values
        index, weight = self._between
        found = torch.nn.functional.embedding_bag(index, values.flatten(0, 1), per_sample_weights=weight, mode="sum")
        return found.view(len(values), -1, 3)


class _Smoothed(torch.autograd.Function):
    """The product of a symmetric matrix [B, M, M] and values [B, M, 3], which is its own transpose.

    Both ways the few rows of values stand to the left of the matrix: a product with few columns to its right takes five
    times as long, one with the transposed matrix twenty.
    """

    @staticmethod
    def forward(ctx: Any, values: Tensor, matrix: Tensor) -> Tensor:
        ctx.save_for_backward(matrix)
        return (values.transpose(1, 2) @ matrix).transpose(1, 2)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        (matrix,) = ctx.saved_tensors
        return _Smoothed.apply(grad_outputs[0], matrix), None


def _padded(rows: list[Tensor], size: int) -> Tensor:
    """Rows of different lengths as one tensor, filled up with 0."""
    full = rows[0].new_zeros(len(rows), size, *rows[0].shape[1:])
    for row, own in zip(full, rows, strict=True):
        row[: len(own)] = own
    return full


def _nearest_nodes(nodes: Tensor) -> Tensor:
    """[M, 12] the nodes nearest to each, itself first; where there are fewer, itself again."""
    apart = torch.cdist(nodes, nodes, compute_mode="donot_use_mm_for_euclid_dist").fill_diagonal_(-1.0)
    near = apart.topk(min(PATCH, len(nodes)), largest=False).indices
    return torch.cat([near, near[:, :1].expand(-1, PATCH - near.shape[1])], 1)


def _laplacian(nodes: Tensor, near: Tensor, size: int) -> Tensor:
    """[size, size] of the graph that joins two nodes where one is among the 8 nearest of the other."""
    matrix = nodes.new_zeros(size, size)
    count = len(nodes)
    if count > 1:
        joined = nodes.new_zeros(count, count).scatter_(1, near[:, 1 : NEIGHBOURS + 1], 1.0).fill_diagonal_(0.0)
        joined = torch.maximum(joined, joined.T)
        matrix[:count, :count] = torch.diag(joined.sum(1)) - joined
    return matrix


def _interpolation(cloud: Tensor, nodes: Tensor) -> tuple[Tensor, Tensor]:
    """Numbers [n, 6] of the nodes nearest to each point, and their weights, which fall to 0 at the last.

    Where all points are nodes, each is its own: [n, 1].
    """
    if len(nodes) == len(cloud):
        return torch.arange(len(cloud)).unsqueeze(1), torch.ones(len(cloud), 1, dtype=cloud.dtype)
    count = min(INTERPOLATED_FROM, len(nodes))
    parts = cloud.split(max(1, PAIRS_AT_ONCE // len(nodes)))
    found = [torch.cdist(part, nodes).topk(count, largest=False) for part in parts]
    index, distance = torch.cat([part.indices for part in found]), torch.cat([part.values for part in found])
    return index.cpu(), falling_weights(distance).cpu()


def falling_weights(distance: Tensor) -> Tensor:
    """[n, k] of the k nearest nodes, in the order of their ``distance`` [n, k]; they sum to 1, and fall to 0 at the last."""
    furthest = distance[:, -1:].clamp_min(torch.finfo(distance.dtype).tiny)
    # The smallest part keeps the sum from 0 where all are equally far.
    weight = (1.0 - (distance / furthest).square()).square() + 1e-6
    return weight / weight.sum(1, keepdim=True)
