"""Smooth displacement fields: the preconditioner of Nicolet et al. 2021, on the neighbour graph of a cloud."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..geometry.points import spread_subset
from .presets import FIELD_NODES

# Neighbours in the graph; nodes of a patch; nodes that a point is interpolated from.
NEIGHBOURS = 8
PATCH = 12
INTERPOLATED_FROM = 6
# Limits of the surface area of a point, in units of the mean.
AREAS = 0.2, 5.0
# Distances computed at once; bounds memory.
PAIRS_AT_ONCE = 1 << 24


class SmoothField:
    """Displacement fields of B clouds as ``(I + lambda L)^-1 u``, L the graph Laplacian of each cloud's nodes.

    "Large Steps in Inverse Rendering of Geometry" (Nicolet, Jacobson, Jakob, 2021) descends in u on a mesh: gradient steps
    then move connected parts together, larger parts for larger lambda. Here the graph joins the 8 nearest neighbours.

    Every point of a small cloud is a node. A cloud of more than ``nodes`` points has that many, by farthest-point sampling,
    and its points take the weighted mean of their six nearest nodes, so that the cost of the solve is bounded.

    Parameters
    ----------
    points : [B, N, 3]. counts : [B] points of each cloud, the rest is padding; None for all.

    Attributes
    ----------
    shape : B, M, 3 of u, M the largest number of nodes.
    nodes : [B, M] int64, indices of the points that are nodes, padded with 0.
    patches : [B, M, 12] int64, the nearest nodes of each node, itself first.
    """

    def __init__(self, points: Tensor, counts: Tensor | None = None, nodes: int = FIELD_NODES) -> None:
        points = points.detach()
        sizes = [points.shape[1]] * len(points) if counts is None else counts.tolist()
        places = [
            torch.from_numpy(spread_subset(cloud[:size].double().cpu().numpy(), nodes))
            for cloud, size in zip(points, sizes, strict=True)
        ]
        most = max(len(indices) for indices in places)
        self.nodes = _padded(places, most).to(points.device)
        positions = [cloud[indices] for cloud, indices in zip(points, places, strict=True)]
        near = [_nearest_nodes(nodes_of) for nodes_of in positions]
        self.patches = _padded(near, most).to(points.device)
        self.shape = (len(points), most, 3)
        laplacian = [_laplacian(nodes_of, index, most) for nodes_of, index in zip(positions, near, strict=True)]
        # Lambda is stated for 1,024 nodes: with fewer nodes the edges are longer.
        self._laplacian = torch.stack(
            [matrix * (len(nodes_of) / FIELD_NODES) for matrix, nodes_of in zip(laplacian, positions, strict=True)]
        )
        self._smoothers: dict[float, Tensor] = {}
        self._between: tuple[Tensor, Tensor] | None = None
        if any(size > nodes for size in sizes):
            pairs = [
                _interpolation(cloud[:size], nodes_of) for cloud, size, nodes_of in zip(points, sizes, positions, strict=True)
            ]
            index = torch.zeros(*points.shape[:2], INTERPOLATED_FROM, dtype=torch.int64)
            weight = torch.zeros(index.shape, dtype=points.dtype)
            for row, (nearest, weights) in enumerate(pairs):
                size, count = nearest.shape
                index[row, :size, :count], weight[row, :size, :count] = nearest, weights
            index += torch.arange(len(points)).view(-1, 1, 1) * most
            self._between = index.view(-1, INTERPOLATED_FROM).to(points.device), weight.view(-1, INTERPOLATED_FROM).to(points)

    def smoother(self, weight: float) -> Tensor:
        """``(I + weight L)^-1`` [B, M, M] of all clouds; symmetric."""
        if weight not in self._smoothers:
            size = self.shape[1]
            system = torch.eye(size, dtype=self._laplacian.dtype, device=self._laplacian.device) + weight * self._laplacian
            self._smoothers[weight] = torch.stack([torch.cholesky_inverse(torch.linalg.cholesky(matrix)) for matrix in system])
        return self._smoothers[weight]

    def of_nearest_node(self, values: Tensor) -> Tensor:
        """[B, N]: for each point the value [B, M] of its nearest node."""
        if self._between is None:
            return values
        return values.flatten()[self._between[0][:, 0]].view(len(values), -1)

    def averaged(self, values: Tensor, weight: float) -> Tensor:
        """[B, N] ``values`` averaged around each point: ``(I + weight L)^-1`` of the nodes' sums over that of their counts."""
        total, count = values, torch.ones_like(values)
        if self._between is not None:
            index, shares = self._between
            # Padding has no weights.
            is_point = shares.any(1).to(values)
            total, count = (
                torch.zeros(self.shape[0] * self.shape[1], dtype=values.dtype, device=values.device)
                .index_add(0, index[:, 0], part)
                .view(self.shape[:2])
                for part in (values.flatten() * is_point, is_point)
            )
        smoother = self.smoother(weight)
        sums, counts = (smoother @ torch.stack([total, count], 2)).unbind(2)
        return self.of_nearest_node(sums / counts.clamp_min(torch.finfo(values.dtype).tiny))

    def areas(self, points: Tensor, counts: Tensor) -> Tensor:
        """[B, N] surface area per point of clouds [B, N, 3], in units of the cloud's mean, within 1/5 and 5.

        A node's area is the squared distance to its nearest node, averaged over its 8 neighbours, and divided among the points
        it is nearest to. What is behind the ``counts`` [B] of the clouds is padding and gets 1.
        """
        nodes = torch.take_along_dim(points, self.nodes.unsqueeze(-1), 1)
        beside = torch.take_along_dim(nodes, self.patches[..., 1:2], 1)
        squared = (nodes - beside).square().sum(-1)
        around = self.patches[..., : NEIGHBOURS + 1]
        node_areas = torch.take_along_dim(squared.unsqueeze(1), around, 2).mean(2)
        is_point = torch.arange(points.shape[1], device=points.device) < counts.to(points.device).unsqueeze(1)
        if self._between is not None:
            owner = self._between[0][:, 0][is_point.flatten()]
            node_areas = node_areas / torch.bincount(owner, minlength=node_areas.numel()).view_as(node_areas).clamp_min(1)
        areas = torch.where(is_point, self.of_nearest_node(node_areas), 0.0)
        mean = areas.sum(1, keepdim=True) / is_point.sum(1, keepdim=True)
        areas = (areas / mean.clamp_min(torch.finfo(points.dtype).tiny)).clamp(*AREAS)
        return torch.where(is_point & (mean > 0.0), areas, 1.0)

    def displacement(self, smoother: Tensor, values: Tensor) -> Tensor:
        """[B, N, 3] displacements of the points, from ``values`` u [B, M, 3] at the nodes; differentiable in u."""
        values = _Smoothed.apply(values, smoother)
        if self._between is None:
            return values
        index, weight = self._between
        spread = torch.nn.functional.embedding_bag(index, values.flatten(0, 1), per_sample_weights=weight, mode="sum")
        return spread.view(len(values), -1, 3)


class _Smoothed(torch.autograd.Function):
    """The product of a symmetric matrix [B, M, M] and values [B, M, 3]; its backward pass is the same product.

    The values stand to the left of the matrix: a product with few columns on the right takes five times as long, one with
    the transposed matrix, as autograd would compute it, twenty times.
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
    """Rows of different lengths as one tensor, padded with 0."""
    return torch.stack([torch.cat([row, row.new_zeros(size - len(row), *row.shape[1:])]) for row in rows])


def _nearest_nodes(nodes: Tensor) -> Tensor:
    """[M, 12] indices of the nearest nodes of each, itself first; where there are fewer, itself again."""
    distance = torch.cdist(nodes, nodes, compute_mode="donot_use_mm_for_euclid_dist").fill_diagonal_(-1.0)
    near = distance.topk(min(PATCH, len(nodes)), largest=False).indices
    return torch.cat([near, near[:, :1].expand(-1, PATCH - near.shape[1])], 1)


def _laplacian(nodes: Tensor, near: Tensor, size: int) -> Tensor:
    """[size, size], of the graph that joins two nodes where either is among the 8 nearest of the other."""
    matrix = nodes.new_zeros(size, size)
    count = len(nodes)
    if count > 1:
        joined = nodes.new_zeros(count, count).scatter_(1, near[:, 1 : NEIGHBOURS + 1], 1.0).fill_diagonal_(0.0)
        joined = torch.maximum(joined, joined.T)
        matrix[:count, :count] = torch.diag(joined.sum(1)) - joined
    return matrix


def _interpolation(cloud: Tensor, nodes: Tensor) -> tuple[Tensor, Tensor]:
    """Indices [n, 6] of the nearest nodes of each point, and their weights; [n, 1] where all points are nodes."""
    if len(nodes) == len(cloud):
        return torch.arange(len(cloud)).unsqueeze(1), torch.ones(len(cloud), 1, dtype=cloud.dtype)
    count = min(INTERPOLATED_FROM, len(nodes))
    parts = cloud.split(max(1, PAIRS_AT_ONCE // len(nodes)))
    nearest = [torch.cdist(part, nodes).topk(count, largest=False) for part in parts]
    index, distance = torch.cat([part.indices for part in nearest]), torch.cat([part.values for part in nearest])
    return index.cpu(), falling_weights(distance).cpu()


def falling_weights(distance: Tensor) -> Tensor:
    """Weights [n, k] of the k nearest nodes by their sorted ``distance`` [n, k]: they sum to 1 and fall to 0 at the last."""
    furthest = distance[:, -1:].clamp_min(torch.finfo(distance.dtype).tiny)
    # The constant keeps the sum positive where all are equally far.
    weight = (1.0 - (distance / furthest).square()).square() + 1e-6
    return weight / weight.sum(1, keepdim=True)
