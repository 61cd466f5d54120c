"""The prior's network: features of a view -> how each node moves, and what is wrong in the view.

A small convolutional network sees the maps. Its cells, the nodes' features and one vector that sums
up the view decide how each node moves. The function is written once, for numpy and torch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .backend import Backend
from .features import LATTICE, MAPS, OF_NODE, OF_VIEW, Features, doubled

Weights = Mapping[str, Any]
# Channels of the convolutions; cells of the last one; length of the vector that sums up a view, and
# of the layer before it; numbers of a node; channels that return to the maps.
CHANNELS, CELLS = (24, 40, 64), 25
SUMMARY, BEFORE_SUMMARY, WIDTH, RETURNED = 256, 512, 192, 16
# Channels between the maps and what belongs; what a cell of the mask may be (`Answers.cells`).
OF_CELLS, KINDS_OF_CELL = 16, 2
# What may be wrong with a view or its cloud, besides that the cloud is of another shape.
TROUBLES = ("shape", "moved", "camera", "foreign", "hidden", "outline", "unrelated", "plane")
# Displacements are a small share of the cloud's size.
SCALE = 0.2
# Logarithms of weights are between minus this and this: a view never counts for nothing.
MOST_LOG_WEIGHT = 4.0


OUTPUTS = ("moved", "lattice", "cells2", "troubles")
"""Layers whose weights are 0 at first."""


def shapes() -> dict[str, tuple[int, ...]]:
    """The names of the weights, and their shapes."""
    first, second, third = CHANNELS
    seen = first + second + second
    layers = {
        "map1": (first, MAPS, 3, 3),
        "map2": (second, first, 3, 3),
        "map2b": (second, second, 3, 3),
        "map3": (third, second, 3, 3),
        "map3b": (third, third, 3, 3),
        "view1": (third * CELLS + OF_VIEW, BEFORE_SUMMARY),
        "view2": (BEFORE_SUMMARY, SUMMARY),
        "returned": (SUMMARY, RETURNED),
        "map4": (second, second + RETURNED, 3, 3),
        "node1": (OF_NODE + seen, WIDTH),
        "node2": (WIDTH, WIDTH),
        "node3": (WIDTH, WIDTH),
        "of_view1": (SUMMARY, WIDTH),
        "of_view2": (SUMMARY, WIDTH),
        "moved": (WIDTH, 6),
        "lattice": (SUMMARY, 3 * LATTICE**3),
        "cells1": (OF_CELLS, first + second, 3, 3),
        "cells2": (4 * KINDS_OF_CELL, OF_CELLS, 3, 3),
        "troubles": (SUMMARY, len(TROUBLES)),
    }
    offsets = {
        f"{name}.offset": (shape[0] if len(shape) == 4 else shape[1],)
        for name, shape in layers.items()
    }
    return layers | offsets


def initial(seed: int) -> dict[str, np.ndarray[Any, Any]]:
    """Weights of a network that moves nothing yet, float32."""
    rng, weights = np.random.default_rng(seed), {}
    for name, shape in shapes().items():
        inputs = int(np.prod(shape[1:])) if len(shape) == 4 else shape[0]
        spread = 0.0 if len(shape) == 1 or name in OUTPUTS else (1.6 / inputs) ** 0.5
        weights[name] = (spread * rng.standard_normal(shape)).astype(np.float32)
    return weights


@dataclass(frozen=True, eq=False)
class Answers:
    """What the network says of B views.

    displacements : [B, N, 3] of the nodes, in the axes of each view.
    log_weights : [B, N, 3], logarithms of 1 over the variance along these axes.
    cells : [B, KINDS_OF_CELL, GRID, GRID], log-odds that a cell shows foreground that is not the
        object's, and that it hides a part of the object.
    troubles : [B, T], log-odds of `TROUBLES`.
    Both are None where they were not asked for.
    """

    displacements: Any
    log_weights: Any
    cells: Any = None
    troubles: Any = None


def predict(backend: Backend, weights: Weights, given: Features, doubts: bool = True) -> Answers:
    """The network's answers; without ``doubts`` only how nodes move, which takes less time."""
    xp = backend.xp

    def convolved(name: str, maps: Any, stride: int = 1) -> Any:
        return backend.convolved(maps, weights[name], weights[f"{name}.offset"], stride)

    def linear(name: str, values: Any) -> Any:
        return backend.linear(values, weights[name], weights[f"{name}.offset"])

    activated = backend.activated
    first = activated(convolved("map1", given.maps, 2))
    second = activated(convolved("map2", first, 2))
    second = second + activated(convolved("map2b", second))
    third = activated(convolved("map3", second, 2))
    third = third + activated(convolved("map3b", third))
    flat = third.reshape(len(third), -1)
    summary = activated(linear("view1", xp.concatenate([flat, given.view], axis=1)))
    summary = activated(linear("view2", summary))
    returned = linear("returned", summary)[:, :, None, None] + xp.zeros_like(second[:, :1])
    again = activated(convolved("map4", xp.concatenate([second, returned], axis=1)))
    seen = [backend.sampled(maps, given.places) for maps in (first, second, again)]
    nodes = linear("node1", xp.concatenate([given.nodes, *seen], axis=-1))
    nodes = activated(nodes + linear("of_view1", summary)[:, None])
    nodes = nodes + activated(linear("node2", nodes) + linear("of_view2", summary)[:, None])
    nodes = nodes + activated(linear("node3", nodes))
    moved = linear("moved", nodes)
    lattice = linear("lattice", summary).reshape(len(summary), LATTICE**3, 3)
    displacements = SCALE * (moved[..., :3] + given.basis @ lattice)
    log_weights = moved[..., 3:].clip(-MOST_LOG_WEIGHT, MOST_LOG_WEIGHT)
    if not doubts:
        return Answers(displacements, log_weights)
    cells = xp.concatenate([first, doubled(xp, again)], axis=1)
    cells = convolved("cells2", activated(convolved("cells1", cells)))
    troubles = linear("troubles", summary)
    return Answers(displacements, log_weights, _spread(xp, cells), troubles)


def _spread(xp: Any, maps: Any) -> Any:
    """[B, C, 2 H, 2 W]: each cell of ``maps`` [B, 4 C, H, W] is four."""
    batch, channels, height, width = maps.shape
    four = maps.reshape(batch, channels // 4, 2, 2, height, width)
    ordered = xp.moveaxis(four, (2, 3), (3, 5))
    return ordered.reshape(batch, channels // 4, 2 * height, 2 * width)


def fused(backend: Backend, displacements: Any, log_weights: Any, rotations: Any) -> Any:
    """One displacement [B, N, 3] in the axes of the cloud, of those that V views ask for.

    The weighted least squares of all: what a view is unsure of, such as its own depth, others say.

    Parameters
    ----------
    displacements, log_weights : [B, V, N, 3] in the axes of each view.
    rotations : [B, V, 3, 3] from the axes of the cloud to those of each view.
    """
    xp = backend.xp
    turn = rotations[:, :, None]  # [B, V, 1, 3, 3]
    weighed = turn * xp.exp(log_weights)[..., None]
    normal = (xp.swapaxes(turn, 3, 4) @ weighed).sum(1)
    right = (xp.swapaxes(weighed, 3, 4) @ displacements[..., None]).sum(1)
    return xp.linalg.solve(normal, right)[..., 0]
