"""Smooth displacement fields: the preconditioner of Nicolet et al. 2021, on a cloud's graph."""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array, Bits, Indices
from ..kernels.dispatch import use_compiled
from ..losses.nearest import fast_spread_subset, nearest_few

# Most nodes of a field, and the number that lambda is stated for. Twice as many are no better.
NODES = 512
# Neighbours of a node in the graph.
NEIGHBOURS = 8
# Nodes in the neighbourhood of a node, itself included.
PATCH = 12
# Nodes that a point is interpolated from.
INTERPOLATED_FROM = 6
# Least number of nodes in a block of the smoother's matrix.
BLOCK = 64


class SmoothField:
    """Displacement fields of a cloud, ``(I + lambda L)^-1 u``; L is the graph Laplacian.

    "Large Steps in Inverse Rendering of Geometry" (Nicolet, Jacobson, Jakob, 2021) optimises u on
    a mesh. Gradient steps in u move connected parts together, larger parts for a larger lambda.
    Here the graph joins the 8 nearest neighbours of ``nodes`` points of the cloud, chosen by
    farthest-point sampling. A point takes the weighted mean of its six nearest nodes, which bounds
    the cost of the solve. In a cloud of fewer points every point is a node.

    Attributes
    ----------
    nodes : [M] indices of the points that are nodes.
    patches : [M, 12] the nearest nodes of each node, itself first.
    """

    def __init__(self, points: Array, nodes: int = NODES) -> None:
        self.nodes: Indices = fast_spread_subset(points, nodes)
        positions = points[self.nodes]
        self.patches = _patches(positions)
        self._adjacent = _adjacent(self.patches)
        self._smoothers: dict[float, _Smoother] = {}
        self._index: Indices = np.arange(len(points))[:, None]
        self._weight: Array = np.ones((len(points), 1))
        if len(positions) < len(points):
            self._index = nearest_few(points, positions, min(INTERPOLATED_FROM, len(positions)))
            distance = np.sqrt(np.square(points[:, None] - positions[self._index]).sum(2))
            self._weight = falling_weights(distance)

    def smoothed(self, values: Array, weight: float) -> Array:
        """``(I + weight L)^-1 values``, [M, C]. The matrix is symmetric, so its own transpose."""
        if weight not in self._smoothers:
            # Between fewer nodes edges are longer.
            smoother = _Smoother(self._adjacent, weight * len(self.nodes) / NODES)
            self._smoothers[weight] = smoother
        return self._smoothers[weight](values)

    def spread(self, values: Array) -> Array:
        """[N, C] values of the points, interpolated between those of the nodes [M, C]."""
        if len(self._index[0]) == 1:
            return values
        if use_compiled():
            from ..kernels import points_numba

            out = np.empty((len(self._index), values.shape[1]))
            points_numba.spread(self._index, self._weight, values, out)
            return out
        spread: Array = np.einsum("nk,nkc->nc", self._weight, values[self._index])
        return spread

    def gather(self, values: Array) -> Array:
        """[M, C], the transpose of `spread`: gradients by the points become gradients by nodes."""
        if len(self._index[0]) == 1:
            return values
        if use_compiled():
            from ..kernels import points_numba

            out = np.empty((len(self.nodes), values.shape[1]))
            points_numba.gather(self._index, self._weight, values, out)
            return out
        index, weight = self._index.ravel(), self._weight
        columns = [
            np.bincount(index, (weight * column[:, None]).ravel(), len(self.nodes))
            for column in values.T
        ]
        return np.stack(columns, 1)

    def of_nearest_node(self, values: Array) -> Array:
        """[N]: for each point the value [M] of its nearest node."""
        return values[self._index[:, 0]]


def _patches(nodes: Array) -> Indices:
    """[M, 12], for each node itself and its nearest nodes; itself again if there are fewer."""
    itself = np.arange(len(nodes))[:, None]
    near = nearest_few(nodes, nodes, min(PATCH, len(nodes)))
    # Where nodes coincide, another node may come first, and itself may be missing.
    place = np.where((near == itself).any(1), (near == itself).argmax(1), near.shape[1] - 1)[
        :, None
    ]
    np.put_along_axis(near, place, near[:, :1], 1)
    near[:, :1] = itself
    return np.concatenate([near, np.repeat(itself, PATCH - near.shape[1], 1)], 1)


def _adjacent(patches: Indices) -> Bits:
    """[M, M], whether one of two nodes is among the 8 nearest of the other, or both are one."""
    near = np.zeros((len(patches), len(patches)), bool)
    np.put_along_axis(near, patches[:, : NEIGHBOURS + 1], True, 1)
    adjacent: Bits = near | near.T
    return adjacent


class _Smoother:
    """``(I + weight L)^-1`` of a graph's Laplacian L.

    A layer is all nodes that are equally many edges away from a first node. A layer is adjacent
    only to the layers before and after it. In the order of layers the matrix is block tridiagonal,
    and blocks are eliminated one by one. That is ten times as fast as the inverse.
    """

    def __init__(self, adjacent: Bits, weight: float) -> None:
        blocks = _layers(adjacent)
        diagonal = 1.0 + weight * (np.count_nonzero(adjacent, axis=1) - 1)
        self._order = np.concatenate(blocks)
        self._inverses: list[Array] = []
        self._carries: list[Array] = []
        for number, block in enumerate(blocks):
            matrix = -weight * adjacent[np.ix_(block, block)]
            np.fill_diagonal(matrix, diagonal[block])
            if number:
                coupling = -weight * adjacent[np.ix_(block, blocks[number - 1])]
                self._carries.append(coupling @ self._inverses[-1])
                matrix -= self._carries[-1] @ coupling.T
            self._inverses.append(np.linalg.inv(matrix))
        ends = np.cumsum([len(block) for block in blocks]).tolist()
        self._slices = [slice(first, last) for first, last in zip([0, *ends], ends, strict=False)]
        self._transposed = [carry.T for carry in self._carries]

    def __call__(self, values: Array) -> Array:
        """[M, C] smoothed."""
        ordered = values[self._order]
        parts = [ordered[slice_] for slice_ in self._slices]
        before = parts[0]
        for carry, part in zip(self._carries, parts[1:], strict=True):
            part -= carry @ before
            before = part
        for inverse, part in zip(self._inverses, parts, strict=True):
            part[:] = inverse @ part
        after = parts[-1]
        for carry, part in zip(reversed(self._transposed), reversed(parts[:-1]), strict=True):
            part -= carry @ after
            after = part
        smoothed = np.empty_like(values)
        smoothed[self._order] = ordered
        return smoothed


def _layers(adjacent: Bits) -> list[Indices]:
    """All nodes in blocks of about `BLOCK`. Only successive blocks are adjacent."""
    left = np.ones(len(adjacent), bool)
    blocks: list[Indices] = []
    block: list[Indices] = []
    layer = np.empty(0, np.int64)
    while left.any():
        if not len(layer):
            layer = np.flatnonzero(left)[:1]
        left[layer] = False
        block.append(layer)
        if sum(map(len, block)) >= BLOCK:
            blocks.append(np.concatenate(block))
            block = []
        layer = np.flatnonzero(adjacent[layer].any(0) & left)
    return [*blocks, np.concatenate(block)] if block else blocks


def falling_weights(distance: Array) -> Array:
    """Weights [n, k] of the k nearest nodes by their sorted ``distance`` [n, k].

    They sum to 1, and fall to 0 at the last node.
    """
    furthest = np.maximum(distance[:, -1:], np.finfo(float).tiny)
    # The constant keeps the sum positive where all nodes are equally far.
    weight = np.square(1.0 - np.square(distance / furthest)) + 1e-6
    falling: Array = weight / weight.sum(1, keepdims=True)
    return falling
