"""The learned prior: how a cloud moves to the shape that masks show, by what shapes are like."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..cloud.smooth_field import falling_weights
from ..geometry.arrays import Array, Indices
from ..io.shipped import LEARNED, NO_PRIOR
from ..losses.nearest import nearest_few
from .backend import NUMPY
from .features import DENSE, INTERPOLATED_FROM, NODES, features
from .file import read_prior, shipped_prior
from .network import Weights, fused, predict
from .view import Frame, Shown

# Cells along each side of the cube whose curve orders a cloud.
CURVE = 1 << 10


@dataclass(frozen=True, eq=False)
class LearnedPrior:
    """A trained network.

    It runs in double precision: single precision differs between processors in the fourth digit.
    """

    weights: Weights
    about: dict[str, Any]

    @classmethod
    def read(cls, path: Path) -> LearnedPrior:
        """From a file; InputError as `read_prior`."""
        return cls(*read_prior(path))


def named_prior(name: str) -> LearnedPrior | None:
    """The prior of a name: "learned", "none" or a file; InputError as `read_prior`."""
    if name == NO_PRIOR:
        return None
    path = shipped_prior() if name == LEARNED else Path(name)
    return _read(path, path.stat().st_mtime_ns if path.is_file() else 0)


@functools.lru_cache(maxsize=2)
def _read(path: Path, _changed: int) -> LearnedPrior:
    """A batch reads its prior once."""
    return LearnedPrior.read(path)


@dataclass(frozen=True, eq=False)
class SeenCloud:
    """A cloud ``start`` [N, 3] and what ``views`` show of it, in the frame of the cloud."""

    start: Array
    frame: Frame
    views: Sequence[Shown]

    @cached_property
    def _chosen(self) -> Indices:
        """Up to `DENSE` points, the first `NODES` of them the nodes.

        They keep the density of the cloud: evenly spread points would give single points and sparse
        parts too large a share.
        """
        along = _along_curve(self.start)
        count = min(DENSE, len(along))
        dense = along[(np.arange(count) + 0.5).astype(int) * len(along) // count]
        nodes = (np.arange(min(NODES, count)) + 0.5) * count / min(NODES, count)
        first = nodes.astype(int)
        return np.concatenate([dense[first], np.delete(dense, first)])

    @cached_property
    def _interpolation(self) -> tuple[Indices, Array]:
        nodes = self.start[self._chosen[:NODES]]
        index = nearest_few(self.start, nodes, min(INTERPOLATED_FROM, len(nodes)))
        distance = np.linalg.norm(self.start[:, None] - nodes[index], axis=2)
        return index, falling_weights(distance)

    def step(self, prior: LearnedPrior, points: Array) -> Array:
        """[N, 3]: how ``points`` [N, 3], where the start has got to, should move."""
        nodes = min(NODES, len(points))
        dense = (points[self._chosen] - self.frame.centre) / self.frame.scale
        rotations = np.stack([view.rotation for view in self.views])
        most = max(len(view.cells) for view in self.views)
        cells, counted = np.zeros((len(self.views), most, 2)), np.zeros((len(self.views), most))
        for number, view in enumerate(self.views):
            cells[number, : len(view.cells)] = view.cells
            counted[number, : len(view.cells)] = 1.0
        given = features(
            NUMPY,
            np.einsum("vij,nj->vni", rotations, dense),
            nodes,
            np.array([view.closeness for view in self.views]),
            np.stack([view.distance for view in self.views]),
            np.stack([view.known for view in self.views]),
            cells,
            counted,
        )
        displacements, log_weights = predict(NUMPY, prior.weights, given)
        log_weights += np.log([view.weight for view in self.views])[:, None, None]
        of_nodes = fused(NUMPY, displacements[None], log_weights[None], rotations[None])[0]
        index, share = self._interpolation
        step: Array = self.frame.scale * np.einsum("nk,nkc->nc", share, of_nodes[index])
        return step


def _along_curve(points: Array) -> Indices:
    """[N]: the points in the order of a curve that fills space (Morton, 1966).

    Every k-th of them is a k-th of each part of the cloud.
    """
    low = points.min(0)
    side = float((points.max(0) - low).max()) or 1.0
    cell = np.minimum((points - low) / side * CURVE, CURVE - 1).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(CURVE.bit_length() - 1):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")
