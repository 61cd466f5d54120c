"""The preset "best" of points mode: smooth displacement fields, from coarse to fine, averaged over the stages."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..cloud.smooth_field import SmoothField
from .adam import Adam, UniformAdam
from .loop import Descent, Progress, Term, descend, offset_progress, sum_of
from .objective import Array, MaskChamferObjective, ViewTargets
from .parameters import FieldParameters
from .presets import NETWORK, CoarseToFineConfig, Stage
from .prior import position_prior
from .problem import Problem


@dataclass(frozen=True, eq=False)
class CoarseToFine:
    """A coarse-to-fine descent of a cloud.

    Parameters
    ----------
    problem : the cloud and its views; ``weights`` of all of them.
    field : of the cloud at its start, with `FIELD_NODES`; stages take coarser ones.
    learning_rate : about how far the node with the largest gradient moves in one of the first steps.
    follow : whether windows follow the cloud from stage to stage.
    evidence : `Problem.evidence`. The more views, the less is the detail of the last stage a guess: its part in the mean of
        the stages grows with the square.
    stage_terms : terms of a stage that starts at these points, beside masks, depth and prior.
    """

    problem: Problem
    weights: list[float]
    field: SmoothField
    config: CoarseToFineConfig
    learning_rate: float
    follow: bool = True
    evidence: float = 1.0
    stage_terms: Callable[[Array, Stage], list[Term]] = lambda points, stage: []

    def run(
        self, steps: int, on_progress: Progress | None = None, until: float = math.inf
    ) -> tuple[Descent, Problem]:
        """Descend for ``steps`` in all; the stages share the time left ``until`` then (`time.perf_counter`).

        Returns
        -------
        The descent, whose ``best`` is the weighted mean of the stages' best iterates, or the start where that has a lower loss
        by the last objective; and the problem with its last windows.
        """
        problem, config = self.problem, self.config
        initial, stages = problem.cloud.normalised(), config.stages
        targets = ViewTargets.of(problem.resampled, self.weights)
        # What is truncated in every view stays unknown, however many there are.
        evidence = 1.0 if targets.truncated else self.evidence
        finest = self.field.with_nodes(max(stage.nodes for stage in stages))
        prior = position_prior(initial, targets, finest, config, evidence)
        parts: list[Descent] = []
        points, done = initial, 0
        for number, stage in enumerate(stages, 1):
            try:
                if self.follow:
                    before, problem = (
                        problem,
                        problem.with_windows_around(
                            problem.cloud.denormalised(points), stage.fine_grid
                        ),
                    )
                    if problem is not before:
                        targets = ViewTargets.of(problem.resampled, self.weights)
                        prior = position_prior(initial, targets, finest, config, evidence)
                resolvability = (
                    targets.resolvability(points, finest) if config.use_resolvability else None
                )
                mask_chamfer = MaskChamferObjective(targets, stage.robust_scale, resolvability)
                objective = sum_of([mask_chamfer, prior, *self.stage_terms(points, stage)])
                optimiser = (UniformAdam if config.uniform_adam else Adam)(
                    stage.learning_rate_scale * self.learning_rate
                )
                parameters = FieldParameters(
                    points, finest.with_nodes(stage.nodes), stage.smoothness, optimiser
                )
                end = round(steps * number / len(stages))
                report = on_progress and offset_progress(on_progress, done, steps)
                now = time.perf_counter()
                share = (until - now) / (len(stages) - number + 1)
                part = descend(parameters, objective, end - done, report, now + share)
                parts.append(part)
                points, done = part.best, end
            except KeyboardInterrupt:
                # Between two descents: what is done counts.
                if not parts:
                    raise
                parts[-1] = replace(parts[-1], interrupted=True)
            if parts[-1].interrupted:
                break
        weights = [stage.averaging_weight for stage in stages]
        weights[-1] *= evidence**2
        return _averaged(parts, weights[: len(parts)], initial, objective), problem


def network_objective(initial: Array, targets: ViewTargets) -> Term:
    """The objective of the preset "best" in the network modes: mask Chamfer loss and position prior."""
    field = SmoothField(initial)
    prior = position_prior(initial, targets, field, NETWORK)
    (stage,) = NETWORK.stages
    return sum_of(
        [
            MaskChamferObjective(
                targets, stage.robust_scale, targets.resolvability(initial, field)
            ),
            prior,
        ]
    )


def _averaged(
    parts: list[Descent], weights: list[float], initial: Array, objective: Term
) -> Descent:
    """One descent of its stages: the mean of their best iterates by ``weights``, judged by the last objective."""
    last = parts[-1]
    # Displacements are averaged, not positions, so that unmoved points stay bit-identical.
    mean = initial + np.average([part.best - initial for part in parts], axis=0, weights=weights)
    loss_at_start, loss_at_mean = objective(initial)[0], objective(mean)[0]
    better = loss_at_mean < loss_at_start
    steps_before = sum(len(part.losses) - 1 for part in parts[:-1])
    return replace(
        last,
        best=mean if better else initial,
        best_step=last.best_step + steps_before if better else 0,
        losses=[*parts[0].losses, *(loss for part in parts[1:] for loss in part.losses[1:])],
        first_loss=loss_at_start,
        best_loss=min(loss_at_mean, loss_at_start),
        stages=tuple(part.best for part in parts),
        objective=objective,
        out_of_time=any(part.out_of_time for part in parts),
    )
