"""Which shapes of a category may stand in for which others, nearest first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry.arrays import Floats
from .shapes import Shape

COMPARED_POINTS = 64  # of each shape: enough to rank shapes
MOST_COMPARED = 500  # shapes of a category that one shape is compared with
NEAREST = 8
# A start is no farther from the truth than this quantile of the distances within the category.
# Categories differ: among cars the distances are small, and among chairs they are large.
FARTHEST_QUANTILE = 0.6


@dataclass(frozen=True, eq=False)
class Neighbours:
    """For each of S shapes, other shapes of its category that are of another kind.

    order : [S, K] indices of shapes, nearest first; -1 where there are fewer than K.
    near : [S], the number of shapes that count as near: up to NEAREST.
    eligible : [S], the number of shapes within the category's farthest distance, at least ``near``.
    """

    order: NDArray[np.int32]
    near: NDArray[np.int64]
    eligible: NDArray[np.int64]


def find_neighbours(shapes: list[Shape], rng: np.random.Generator) -> Neighbours:
    """Compare the shapes of each category with each other; every category has two kinds or more.

    In a category of over MOST_COMPARED shapes each is compared with as many that are drawn.
    """
    categories = np.array([shape.category for shape in shapes])
    kinds = np.array([shape.kind for shape in shapes])
    points = np.stack([shape.samplings[0, :COMPARED_POINTS] for shape in shapes])
    order = np.full((len(shapes), MOST_COMPARED), -1, np.int32)
    near, eligible = np.zeros((2, len(shapes)), np.int64)
    for category in np.unique(categories):
        members = np.flatnonzero(categories == category)
        ranked = {}
        for member in members.tolist():
            others = members[kinds[members] != kinds[member]]
            if len(others) > MOST_COMPARED:
                others = rng.choice(others, MOST_COMPARED, replace=False)
            distances = _chamfer(points[member], points[others])
            ranks = np.argsort(distances, kind="stable")
            ranked[member] = others[ranks], distances[ranks]
        farthest = np.quantile(np.concatenate([d for _, d in ranked.values()]), FARTHEST_QUANTILE)
        for member, (others, distances) in ranked.items():
            order[member, : len(others)] = others
            near[member] = min(NEAREST, len(others))
            eligible[member] = max(near[member], (distances <= farthest).sum())
    return Neighbours(order[:, : (order >= 0).sum(1).max()], near, eligible)


def _chamfer(cloud: Floats, others: Floats) -> Floats:
    """Squared Chamfer distances [S], both ways, from ``cloud`` [N, 3] to ``others`` [S, N, 3]."""
    products = (others.reshape(-1, 3) @ cloud.T).reshape(len(others), -1, len(cloud))
    squared = np.square(others).sum(2)[:, :, None] + np.square(cloud).sum(1) - 2.0 * products
    distances: Floats = squared.min(1).mean(1) + squared.min(2).mean(1)
    return distances
