"""The default preset in points mode: a smooth displacement field, held near its beginning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..cloud.smooth_field import SmoothField
from ..geometry.arrays import Array
from .adam import Adam, UniformAdam
from .learned_start import Beginning
from .loop import Optimised, Progress, Term, minimise, sum_of
from .objective import MaskChamferObjective, ViewTargets
from .parameters import FieldParameters
from .position_prior import position_prior
from .presets import NETWORK, Recipe
from .problem import Problem


def optimise_field(
    problem: Problem,
    weights: Sequence[float],
    field: SmoothField,
    recipe: Recipe,
    learning_rate: float,
    steps: int,
    *,
    begin: Beginning | None = None,
    observations: float = 1.0,
    terms: Sequence[Term] = (),
    on_progress: Progress | None = None,
) -> Optimised:
    """Move a cloud by a smooth displacement field until it agrees with its views.

    ``best`` is the best iterate, or the start where the start agrees better with the views.

    Parameters
    ----------
    weights : of the given views.
    field : of the cloud at its start.
    learning_rate : the largest change of a node's vector in the first step. Smoothing makes the
        points move less.
    begin : where the points are at first, and held; the start without it.
    observations : `Problem.observations`: the more views, the looser the points are held.
    terms : further losses.
    on_progress : as `minimise`.
    """
    start = problem.cloud.start
    begin = begin or Beginning(start)
    targets = problem.targets(weights)
    # What is truncated in every view stays unknown, however many views there are.
    observations = 1.0 if targets.truncated else observations
    held = position_prior(begin.points, targets, recipe, observations, begin.rightness)
    agreement = sum_of([_mask_chamfer(targets, begin.points, field, recipe), *terms])
    optimiser = UniformAdam(learning_rate) if recipe.uniform_adam else Adam(learning_rate)
    parameters = FieldParameters(begin.points, field, recipe.smoothness, optimiser)
    found = minimise(parameters, sum_of([agreement, held]), steps, on_progress)
    # Compared without the position prior, which may hold the cloud elsewhere than at its start.
    loss_at_start, loss_at_best = agreement(start)[0], agreement(found.best)[0]
    better = loss_at_best < loss_at_start
    return replace(
        found,
        best=found.best if better else start,
        best_step=found.best_step if better else 0,
        first_loss=loss_at_start,
        best_loss=min(loss_at_best, loss_at_start),
        begun=begin,
    )


def network_objective(initial: Array, targets: ViewTargets) -> Term:
    """The objective of "best" in the network modes: mask Chamfer loss and position prior."""
    prior = position_prior(initial, targets, NETWORK)
    return sum_of([_mask_chamfer(targets, initial, SmoothField(initial), NETWORK), prior])


def _mask_chamfer(targets: ViewTargets, points: Array, field: SmoothField, recipe: Recipe) -> Term:
    resolvability = targets.resolvability(points, field) if recipe.use_resolvability else None
    return MaskChamferObjective(targets, recipe.robust_scale, resolvability)
