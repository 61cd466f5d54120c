"""The learned prior: how a cloud moves to the shape that masks show, by what shapes are like."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

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

    @classmethod
    def read(cls, path: Path) -> LearnedPrior:
        """From a file; InputError as `read_prior`."""
        return cls(read_prior(path)[0])


def named_prior(name: str) -> LearnedPrior | None:
    """The prior of a name: "learned", "none" or a file; InputError as `read_prior`."""
    if name == NO_PRIOR:
        return None
    return LearnedPrior.read(shipped_prior() if name == LEARNED else Path(name))


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
        dense, first = along[_every(len(along), count)], _every(count, min(NODES, count))
        return np.concatenate([dense[first], np.delete(dense, first)])

    @cached_property
    def _interpolation(self) -> tuple[Indices, Array]:
        nodes = self.start[self._chosen[:NODES]]
        index = nearest_few(self.start, nodes, min(INTERPOLATED_FROM, len(nodes)))
        distance = np.linalg.norm(self.start[:, None] - nodes[index], axis=2)
        return index, falling_weights(distance)

    def step(self, prior: LearnedPrior, points: Array, until: float = math.inf) -> Array | None:
        """[N, 3]: how ``points`` [N, 3], where the start has got to, should move.

        None where the time is over before all views have been asked (`time.perf_counter`), or where
        the answer is not finite.
        """
        dense = (points[self._chosen] - self.frame.centre) / self.frame.scale
        answers = []
        for view in self.views:
            if time.perf_counter() > until:
                return None
            answers.append(self._answer(prior, dense, view))
        displacements, log_weights = (np.stack(part)[None] for part in zip(*answers, strict=True))
        rotations = np.stack([view.rotation for view in self.views])[None]
        of_nodes = fused(NUMPY, displacements, log_weights, rotations)[0]
        index, share = self._interpolation
        step: Array = self.frame.scale * np.einsum("nk,nkc->nc", share, of_nodes[index])
        return step if np.isfinite(step).all() else None

    def _answer(self, prior: LearnedPrior, dense: Array, view: Shown) -> tuple[Array, Array]:
        """Displacements [M, 3] of the nodes in the axes of a view, and logarithms of weights."""
        given = features(
            NUMPY,
            (dense @ view.rotation.T)[None],
            min(NODES, len(dense)),
            np.array([view.closeness]),
            view.distance[None],
            view.known[None],
            view.cells[None],
            np.ones((1, len(view.cells))),
        )
        (displacements,), (log_weights,) = predict(NUMPY, prior.weights, given)
        return displacements, log_weights + np.log(view.weight)


def _every(total: int, count: int) -> Indices:
    """[count] whole numbers under ``total``, evenly spaced."""
    chosen: Indices = ((np.arange(count) + 0.5) * total / count).astype(np.int64)
    return chosen


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
