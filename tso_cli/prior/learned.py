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
from .network import Answers, Weights, fused, predict
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
    """

    displacements: Array
    sureness: float


@dataclass(frozen=True, eq=False)
class Doubts:
    """What a prior finds wrong with V views of a cloud, as probabilities.

    foreign, hidden : [V, GRID, GRID], that a cell shows foreground that is not the object's, and
        that something hides a part of the object there.
    troubles : [V, T], of `network.TROUBLES`.
    """

    foreign: Array
    hidden: Array
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
        of_views = []
        for view, samples in zip(self.views, self._samples, strict=True):
            said = _said(prior, framed @ view.rotation.T, view, samples, doubts=False)
            of_views.append(
                (_spread(samples, said.displacements), _spread(samples, said.log_weights))
            )
        displacements, log_weights = (np.stack(each)[None] for each in zip(*of_views, strict=True))
        rotations = np.stack([view.rotation for view in self.views])[None]
        weighed = log_weights + np.log([view.weight for view in self.views])[:, None, None]
        moves: Array = self.frame.scale * fused(NUMPY, displacements, weighed, rotations)[0]
        sureness = float(log_weights[..., 2].mean())
        return Answer(moves, sureness) if np.isfinite(moves).all() else None

    def doubts(self, prior: LearnedPrior) -> Doubts:
        """What the prior finds wrong with the views of the start."""
        framed = (self.start - self.frame.centre) / self.frame.scale
        cells, troubles = [], []
        for view, samples in zip(self.views, self._samples, strict=True):
            said = _said(prior, framed @ view.rotation.T, view, samples, doubts=True)
            cells.append(_probabilities(said.cells))
            troubles.append(_probabilities(said.troubles))
        foreign, hidden = np.stack(cells, 1)
        return Doubts(foreign, hidden, np.stack(troubles))


def _probabilities(log_odds: Array) -> Array:
    """The mean over samples."""
    mean: Array = np.mean(1.0 / (1.0 + np.exp(-log_odds)), axis=0)
    return mean


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


def _said(
    prior: LearnedPrior, points: Array, view: Shown, samples: Sequence[_Sample], doubts: bool
) -> Answers:
    """What the network answers in a view, for each of the ``samples`` of the ``points`` [N, 3]."""
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
    given = features(NUMPY, dense, min(NODES, dense.shape[1]), sight)
    return predict(NUMPY, prior.weights, given, doubts)


def _spread(samples: Sequence[_Sample], of_nodes: Array) -> Array:
    """[N, 3] of all points, the mean over ``samples``."""
    each = [sample.spread(values) for sample, values in zip(samples, of_nodes, strict=True)]
    mean: Array = np.mean(each, axis=0)
    return mean


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
