"""The optimisation of a prepared problem: which views count how much, how long, and by what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..cloud.smooth_field import SmoothField
from ..geometry.arrays import Array
from ..losses.chamfer import ChamferToStart
from ..losses.photometric import Photo, PhotometricTerm
from .adam import Adam
from .field_optimisation import network_objective, optimise_field
from .learned_start import Beginning
from .loop import Optimised, Parameters, Progress, Term, minimise, sum_of
from .objective import SilhouetteObjective
from .parameters import PointParameters
from .problem import Problem
from .settings import Settings
from .view_weights import ViewWeights


@dataclass(frozen=True, eq=False)
class WeighedProblem:
    """A problem with the weights of its views, and the displacement field of its start.

    weights : of the given views. field : None unless the default preset moves points.
    """

    problem: Problem
    weights: ViewWeights
    field: SmoothField | None


def weigh(problem: Problem, settings: Settings) -> WeighedProblem:
    """The weights of the given views, by their silhouettes of the start."""
    start, weights = problem.cloud.start, ViewWeights.even(len(problem.given))
    if settings.preset == "best":
        weights = ViewWeights.of([windowed.resampled for windowed in problem.given], start)
    return WeighedProblem(problem, weights, SmoothField(start) if settings.smooth else None)


def optimise(
    weighed: WeighedProblem,
    settings: Settings,
    steps: int,
    network: Parameters | None = None,
    begin: Beginning | None = None,
    on_progress: Progress | None = None,
) -> tuple[Optimised, Problem]:
    """Move the cloud, or the ``network`` that predicts it, until it agrees with its views.

    The default preset in points mode begins at ``begin``, without it at the start.

    Returns what was found, and the problem with the windows of the optimisation.
    """
    problem, start, weights = weighed.problem, weighed.problem.cloud.start, weighed.weights.loss
    chamfer: list[Term] = []
    if settings.gamma:
        chamfer = [_Times(settings.gamma, ChamferToStart(start))]
    if weighed.field:
        begin, recipe = begin or Beginning(start), settings.recipe
        around = problem.cloud.denormalise(begin.points)
        problem = problem.with_windows_around(around, recipe.fine_grid)
        found = optimise_field(
            problem,
            weights,
            weighed.field,
            recipe,
            settings.learning_rate,
            steps,
            begin=begin,
            observations=problem.observations(weights),
            terms=[*chamfer, *_photometric(problem, weights, begin.points)],
            on_progress=on_progress,
        )
        return found, problem
    term: Term = SilhouetteObjective(problem.resampled, problem.all_weights(weights))
    if settings.preset == "best":
        term = network_objective(start, problem.targets(weights))
    parameters = network or PointParameters(start, Adam(settings.learning_rate))
    return minimise(parameters, sum_of([term, *chamfer]), steps, on_progress), problem


@dataclass(frozen=True, eq=False)
class _Times:
    weight: float
    term: Term

    def __call__(self, points: Array) -> tuple[float, Array]:
        value, gradient = self.term(points)
        return self.weight * value, self.weight * gradient


def _photometric(problem: Problem, weights: Sequence[float], points: Array) -> list[Term]:
    """The terms of the photos of the given views at ``points``, if the cloud has colours."""
    if problem.cloud.colours is None:
        return []
    colours = np.asarray(problem.cloud.colours, dtype=np.float64)
    terms: list[Term] = []
    for windowed, weight in zip(problem.given, weights, strict=True):
        view = windowed.resampled
        if view.image is not None:
            photo = Photo(view.image, view.target.inside, view.camera, weight)
            terms.append(PhotometricTerm.at(photo, colours, points))
    return terms
