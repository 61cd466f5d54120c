"""The optimisation of a prepared problem: which views count how much, how long, and by what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..geometry.arrays import Array
from ..losses.chamfer import ChamferToStart
from .config import Settings
from .learned_start import RIGHT, Beginning
from .loop import Optimised, Parameters, Progress, Term, minimise, sum_of
from .objective import PositionPrior, SilhouetteObjective
from .parameters import PointParameters
from .presets import BEST_POINTS, FAR, LEAST_SEEN, PRIOR_WEIGHT
from .problem import Problem
from .view_weights import weights_of


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
        firmness = firmness_by(begin.asked, problem.masks_alone)
    begin = begin or Beginning(start)
    targets = problem.finely_around(begin.points).targets(weights).resolving(begin.points)
    held = PositionPrior(begin.points, firmness * PRIOR_WEIGHT)
    parameters = PointParameters(begin.points, learning_rate)
    found = minimise(parameters, sum_of([targets.loss, held]), steps, on_progress)
    # Compared without the position prior, which may hold the cloud elsewhere than at its start.
    loss_at_start, loss_at_best = targets.loss(start)[0], targets.loss(found.best)[0]
    better = loss_at_best < loss_at_start and not begin.right
    return replace(
        found,
        best=found.best if better else start,
        best_step=found.best_step if better else 0,
        first_loss=loss_at_start,
        best_loss=loss_at_best if better else loss_at_start,
        begun=begin,
    )


def firmness_by(asked: float, masks_alone: bool) -> float:
    """How many times as firmly points are held if the learned prior ``asked`` to move them so far.

    asked : a root mean square, in longest sides.
    """
    least = RIGHT if masks_alone else LEAST_SEEN
    return max(FAR / max(asked, least), 1.0)


@dataclass(frozen=True, eq=False)
class _Times:
    weight: float
    term: Term

    def __call__(self, points: Array) -> tuple[float, Array]:
        value, gradient = self.term(points)
        return self.weight * value, self.weight * gradient
