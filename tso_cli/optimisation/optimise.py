"""The optimisation of a prepared problem: which views count how much, how long, and by what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.arrays import Array, Indices
from ..losses.chamfer import ChamferToStart
from ..losses.nearest import nearest_few
from ..losses.photometric import Photo, PhotometricTerm
from .learned_start import RIGHT, Beginning
from .loop import Optimised, Parameters, Progress, Term, minimise, sum_of
from .objective import PositionPrior, SilhouetteObjective
from .parameters import PointParameters
from .presets import BEST_POINTS, FAR, PRIOR_WEIGHT
from .problem import Problem
from .settings import Settings
from .view_weights import weights_of

# Points that move alike by a photo: the detail of one point alone fits many places.
NEIGHBOURS = 12


@dataclass(frozen=True, eq=False)
class WeighedProblem:
    """A problem with the weights of the views that were given."""

    problem: Problem
    weights: list[float]


def weigh(problem: Problem, settings: Settings) -> WeighedProblem:
    """The weights of the given views, by their silhouettes of the start."""
    if settings.preset == "paper":
        return WeighedProblem(problem, [1.0] * len(problem.given))
    resampled = [windowed.resampled for windowed in problem.given]
    return WeighedProblem(problem, weights_of(resampled, problem.cloud.start))


def optimise(
    weighed: WeighedProblem,
    settings: Settings,
    steps: int,
    network: Parameters | None = None,
    begin: Beginning | None = None,
    on_progress: Progress | None = None,
) -> Optimised:
    """Move the cloud, or the ``network`` that predicts it, until it agrees with its views.

    The default preset in points mode begins at ``begin``, without it at the start.
    """
    problem, weights, rate = weighed.problem, weighed.weights, settings.learning_rate
    start = problem.cloud.start
    if settings.smooth:
        return optimise_points(problem, weights, steps, rate, begin, on_progress=on_progress)
    objective: Term = SilhouetteObjective(problem.resampled, problem.all_weights(weights))
    if settings.preset == "best":
        objective = sum_of([problem.targets(weights).loss, PositionPrior(start, PRIOR_WEIGHT)])
    elif settings.gamma:
        objective = sum_of([objective, _Times(settings.gamma, ChamferToStart(start))])
    parameters = network or PointParameters(start, rate)
    return minimise(parameters, objective, steps, on_progress)


def optimise_points(
    problem: Problem,
    weights: Sequence[float],
    steps: int,
    learning_rate: float = BEST_POINTS.learning_rate,
    begin: Beginning | None = None,
    on_progress: Progress | None = None,
) -> Optimised:
    """Move the points of a cloud until it agrees with its views, held near where they begin.

    ``best`` is the best iterate; or the start where it agrees better with the views, or is right.

    Parameters
    ----------
    weights : of the given views.
    learning_rate : how far a coordinate moves in the first step.
    begin : where the learned prior has moved the points; they are held there, else at the start.
    """
    start, firmness = problem.cloud.start, 1.0
    if begin is not None and begin.asked is not None:
        firmness = firmness_by(begin.asked)
    begin = begin or Beginning(start)
    photos = _photometric(problem, weights, begin.points)
    targets = problem.finely_around(begin.points).targets(weights).resolving(begin.points)
    agreement = sum_of([targets.loss, *photos])
    held = PositionPrior(begin.points, firmness * PRIOR_WEIGHT)
    parameters = PointParameters(begin.points, learning_rate)
    found = minimise(parameters, sum_of([agreement, held]), steps, on_progress)
    # Compared without the position prior, which may hold the cloud elsewhere than at its start.
    loss_at_start, loss_at_best = agreement(start)[0], agreement(found.best)[0]
    better = loss_at_best < loss_at_start and not begin.right
    return replace(
        found,
        best=found.best if better else start,
        best_step=found.best_step if better else 0,
        first_loss=loss_at_start,
        best_loss=loss_at_best if better else loss_at_start,
        begun=begin,
    )


def firmness_by(asked: float) -> float:
    """How many times as firmly points are held if the learned prior ``asked`` to move them so far.

    asked : a root mean square, in longest sides.
    """
    return max(FAR / max(asked, RIGHT), 1.0)


@dataclass(frozen=True, eq=False)
class _Times:
    weight: float
    term: Term

    def __call__(self, points: Array) -> tuple[float, Array]:
        value, gradient = self.term(points)
        return self.weight * value, self.weight * gradient


@dataclass(frozen=True, eq=False)
class _Smoothed:
    """A term whose gradient is averaged twice over the points ``near`` [N, k] each point."""

    term: Term
    near: Indices

    def __call__(self, points: Array) -> tuple[float, Array]:
        value, gradient = self.term(points)
        return value, gradient[self.near].mean(1)[self.near].mean(1)


def _photometric(problem: Problem, weights: Sequence[float], points: Array) -> list[Term]:
    """The terms of the photos of the given views at ``points``, if the cloud has colours."""
    if problem.cloud.colours is None:
        return []
    colours = np.asarray(problem.cloud.colours, dtype=np.float64)
    near = nearest_few(points, points, min(NEIGHBOURS, len(points)))
    terms: list[Term] = []
    for windowed, weight in zip(problem.given, weights, strict=True):
        view = windowed.resampled
        if view.image is not None:
            photo = Photo(view.image, view.target.inside, view.camera, weight)
            terms.append(_Smoothed(PhotometricTerm.at(photo, colours, points), near))
    return terms
