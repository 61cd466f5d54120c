"""The learned prior: how a cloud moves to the shape that masks show, by what shapes are like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..cloud.interpolation import falling_weights
from ..geometry.arrays import Array, Indices
from ..io.shipped import LEARNED, NO_PRIOR
from ..losses.nearest import nearest_few
from .backend import NUMPY
from .features import DENSE, INTERPOLATED_FROM, NODES, Sight, features
from .file import EXPECTED, read_prior, shipped_prior
from .network import Weights, fused, predict
from .view import Frame, Shown

# Samples of a cloud whose answers are averaged. With one, a third of a displacement is chance.
SAMPLES = 2
# Cells along each side of the cube whose curve orders a cloud.
CURVE = 1 << 10


@dataclass(frozen=True, eq=False)
class LearnedPrior:
    """A trained network.

    It runs in double precision: single precision differs between processors in the fourth digit.
    """

    weights: Weights

    @classmethod
    def read(cls, path: Path, expected: str = EXPECTED) -> LearnedPrior:
        """From a file; InputError as `read_prior`."""
        return cls(read_prior(path, expected)[0])


def named_prior(name: str) -> LearnedPrior | None:
    """The prior of a name: "learned", "none" or a file; InputError as `read_prior`."""
    if name == NO_PRIOR:
        return None
    path = shipped_prior() if name == LEARNED else Path(name)
    return LearnedPrior.read(path, f"{EXPECTED}, or one of the words {LEARNED} and {NO_PRIOR}")


@dataclass(frozen=True, eq=False)
class Answer:
    """What a prior answers.

    displacements : [N, 3]. sureness : the mean logarithm of the weights along the lines of sight,
        over points and views; low where the depth is hard to guess.
    cells, troubles : [V, KINDS_OF_CELL, GRID, GRID] and [V, T], probabilities, see
        `network.Answers`.
    """

    displacements: Array
    sureness: float
    cells: Array
    troubles: Array


@dataclass(frozen=True, eq=False)
class _OfView:
    """What a prior answers in one view: displacements and logarithms of weights [N, 3] in the axes
    of the view, and the probabilities of `network.Answers`.
    """

    displacements: Array
    log_weights: Array
    cells: Array
    troubles: Array


@dataclass(frozen=True, eq=False)
class SeenCloud:
    """A cloud ``start`` [N, 3] and what ``views`` show of it, in the frame of the cloud."""

    start: Array
    frame: Frame
    views: Sequence[Shown]

    @cached_property
    def _samples(self) -> list[list[_Sample]]:
        """Of each view."""
        return [_samples(self.start @ view.rotation.T) for view in self.views]

    def ask(self, prior: LearnedPrior, points: Array) -> Answer | None:
        """How ``points`` [N, 3], where the start has got to, should move.

        None where the answer is not finite.
        """
        framed = (points - self.frame.centre) / self.frame.scale
        of_views = [
            _answer(prior, framed @ view.rotation.T, view, samples)
            for view, samples in zip(self.views, self._samples, strict=True)
        ]
        displacements = np.stack([said.displacements for said in of_views])[None]
        log_weights = np.stack([said.log_weights for said in of_views])[None]
        rotations = np.stack([view.rotation for view in self.views])[None]
        weighed = log_weights + np.log([view.weight for view in self.views])[:, None, None]
        moves: Array = self.frame.scale * fused(NUMPY, displacements, weighed, rotations)[0]
        sureness = float(log_weights[..., 2].mean())
        if not np.isfinite(moves).all():
            return None
        cells, troubles = (
            np.stack([getattr(said, name) for said in of_views]) for name in ("cells", "troubles")
        )
        return Answer(moves, sureness, cells, troubles)


@dataclass(frozen=True, eq=False)
class _Sample:
    """A part of a cloud [N, 3] that the network is given.

    chosen : [M], up to `DENSE` points, the first `NODES` of them the nodes.
    index, share : [N, K], the nodes that each point is interpolated from, and their weights.
    """

    chosen: Indices
    index: Indices
    share: Array

    @classmethod
    def of(cls, points: Array, along: Indices, shift: float) -> _Sample:
        """Every k-th of the ``points`` in their order ``along`` a curve, from a ``shift`` on.

        The sample keeps the density of the cloud: evenly spread points would give single points and
        sparse parts too large a share.
        """
        dense = along[_every(len(along), DENSE, shift)]
        first = _every(len(dense), NODES, shift)
        chosen = np.concatenate([dense[first], np.delete(dense, first)])
        nodes = points[chosen[:NODES]]
        index = nearest_few(points, nodes, min(INTERPOLATED_FROM, len(nodes)))
        distance = np.linalg.norm(points[:, None] - nodes[index], axis=2)
        return cls(chosen, index, falling_weights(distance))

    def spread(self, of_nodes: Array) -> Array:
        """[N, 3], of all points."""
        spread: Array = np.einsum("nk,nkc->nc", self.share, of_nodes[self.index])
        return spread


def _samples(points: Array) -> list[_Sample]:
    """Of ``points`` [N, 3] in the axes of a view, so that the axes of the cloud do not matter."""
    along = _along_curve(points)
    return [_Sample.of(points, along, (number + 0.5) / SAMPLES) for number in range(SAMPLES)]


def _answer(prior: LearnedPrior, points: Array, view: Shown, samples: Sequence[_Sample]) -> _OfView:
    """What the ``prior`` answers in a view, the mean over ``samples`` of the ``points`` [N, 3]."""
    dense = points[np.stack([sample.chosen for sample in samples])]

    def alike(value: Array | float) -> Array:
        return np.broadcast_to(value, (len(dense), *np.shape(value)))

    sight = Sight(
        closeness=alike(view.closeness),
        distance=alike(view.distance),
        known=alike(view.known),
        cells=alike(view.cells),
        counted=np.ones((len(dense), len(view.cells))),
        depth=alike(view.depth),
        measured=alike(view.measured),
        metric=alike(float(view.metric)),
        size=alike(view.size),
    )
    said = predict(NUMPY, prior.weights, features(NUMPY, dense, min(NODES, dense.shape[1]), sight))

    def spread(of_nodes: Array) -> Array:
        each = [part.spread(values) for part, values in zip(samples, of_nodes, strict=True)]
        mean: Array = np.mean(each, axis=0)
        return mean

    cells, troubles = (
        np.mean(1.0 / (1.0 + np.exp(-values)), axis=0) for values in (said.cells, said.troubles)
    )
    return _OfView(spread(said.displacements), spread(said.log_weights), cells, troubles)


def _every(total: int, count: int, shift: float) -> Indices:
    """[count] or fewer whole numbers under ``total``, evenly spaced."""
    count = min(count, total)
    chosen: Indices = ((np.arange(count) + shift) * total / count).astype(np.int64)
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
