"""The default preset in points mode: smooth displacement fields, from coarse to fine, averaged."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..cloud.smooth_field import SmoothField
from ..geometry.arrays import Array
from .adam import Adam, UniformAdam
from .learned_start import Beginning
from .loop import Optimised, Progress, Term, minimise, offset_progress, sum_of
from .objective import MaskChamferObjective, ViewTargets
from .parameters import FieldParameters
from .position_prior import position_prior
from .presets import NETWORK, CoarseToFineConfig, Stage
from .problem import Problem


@dataclass(frozen=True, eq=False)
class CoarseToFine:
    """A coarse-to-fine optimisation of a cloud.

    Parameters
    ----------
    problem : the cloud and its views. weights : of the given views.
    field : of the cloud at its start.
    beginning : where the points are at first, and held; the start without it.
    learning_rate : the largest change of a node's vector in the first step. Smoothing makes the
        points move less.
    follow : whether windows follow the cloud from stage to stage.
    observations : `Problem.observations`. The more views, the less the detail of the last stage is
        a guess: its weight in the mean of the stages grows with their square.
    stage_terms : called with (points, stage) when a stage starts: its further terms.
    """

    problem: Problem
    weights: Sequence[float]
    field: SmoothField
    config: CoarseToFineConfig
    learning_rate: float
    beginning: Beginning | None = None
    follow: bool = True
    observations: float = 1.0
    stage_terms: Callable[[Array, Stage], list[Term]] = lambda points, stage: []

    def run(
        self, steps: int, on_progress: Progress | None = None, until: float = math.inf
    ) -> tuple[Optimised, Problem]:
        """Optimise for ``steps`` steps in all.

        The stages share the time left ``until`` then (`time.perf_counter`).

        Returns
        -------
        What was found: ``best`` is the weighted mean of the stages' best iterates, or the start
        where the start has a lower loss by the last objective. And the problem with its last
        windows.
        """
        problem, config = self.problem, self.config
        initial, stages = problem.cloud.start, config.stages
        begin = self.beginning or Beginning(initial)
        targets = problem.targets(self.weights)
        # What is truncated in every view stays unknown, however many views there are.
        observations = 1.0 if targets.truncated else self.observations

        def held_by(targets: ViewTargets) -> Term:
            return position_prior(begin.points, targets, config, observations, begin.rightness)

        held = held_by(targets)
        found: list[Optimised] = []
        points, done = begin.points, 0
        try:
            for number, stage in enumerate(stages, 1):
                if self.follow:
                    before = problem
                    around = problem.cloud.denormalise(points)
                    problem = problem.with_windows_around(around, stage.fine_grid)
                    if problem is not before:
                        targets = problem.targets(self.weights)
                        held = held_by(targets)
                agreement = [
                    self._mask_chamfer(targets, points, stage),
                    *self.stage_terms(points, stage),
                ]
                end = round(steps * number / len(stages))
                now = time.perf_counter()
                found.append(
                    minimise(
                        self._parameters(points, stage),
                        sum_of([*agreement, held]),
                        end - done,
                        on_progress and offset_progress(on_progress, done, steps),
                        now + (until - now) / (len(stages) - number + 1),
                    )
                )
                points, done = found[-1].best, end
                if found[-1].interrupted:
                    break
        except KeyboardInterrupt:
            # Between two stages: what is done counts.
            if not found:
                raise
            found[-1] = replace(found[-1], interrupted=True)
        weights = [stage.averaging_weight for stage in stages]
        weights[-1] *= observations**2
        result = _averaged(found, weights[: len(found)], initial, sum_of(agreement))
        return replace(result, begun=begin), problem

    def _mask_chamfer(self, targets: ViewTargets, points: Array, stage: Stage) -> Term:
        resolvability = None
        if self.config.use_resolvability:
            resolvability = targets.resolvability(points, self.field)
        return MaskChamferObjective(targets, stage.robust_scale, resolvability)

    def _parameters(self, points: Array, stage: Stage) -> FieldParameters:
        rate = stage.learning_rate_scale * self.learning_rate
        optimiser = UniformAdam(rate) if self.config.uniform_adam else Adam(rate)
        return FieldParameters(points, self.field, stage.smoothness, optimiser)


def network_objective(initial: Array, targets: ViewTargets) -> Term:
    """The objective of "best" in the network modes: mask Chamfer loss and position prior."""
    field = SmoothField(initial)
    prior = position_prior(initial, targets, NETWORK)
    (stage,) = NETWORK.stages
    resolvability = targets.resolvability(initial, field)
    return sum_of([MaskChamferObjective(targets, stage.robust_scale, resolvability), prior])


def _averaged(
    stages: list[Optimised], weights: list[float], initial: Array, objective: Term
) -> Optimised:
    """The stages as one: the mean of their best iterates.

    The ``objective`` compares it with the start: how far they agree with the views at last. It has
    no position prior, which may hold the cloud elsewhere than at its start.
    """
    last = stages[-1]
    # Displacements are averaged, not positions, so that unmoved points stay the same to the bit.
    displacements = [stage.best - initial for stage in stages]
    mean = initial + np.average(displacements, axis=0, weights=weights)
    loss_at_start, loss_at_mean = objective(initial)[0], objective(mean)[0]
    better = loss_at_mean < loss_at_start
    steps_before = sum(len(stage.losses) - 1 for stage in stages[:-1])
    # The first loss of a stage is of the iterate that the stage before ended with.
    later = (loss for stage in stages[1:] for loss in stage.losses[1:])
    return replace(
        last,
        best=mean if better else initial,
        best_step=last.best_step + steps_before if better else 0,
        losses=[*stages[0].losses, *later],
        first_loss=loss_at_start,
        best_loss=min(loss_at_mean, loss_at_start),
        stages=tuple(stage.best for stage in stages),
        objective=objective,
        out_of_time=any(stage.out_of_time for stage in stages),
    )
