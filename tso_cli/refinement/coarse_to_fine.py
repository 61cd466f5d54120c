"""The preset "best" of points mode: smooth displacement fields, from coarse to fine, averaged over the stages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from .adam import Adam, UniformAdam
from .objective import MaskChamferObjective, ViewTargets
from .optimise import Descent, Objective, Progress, descend, offset_progress
from .photometric import PhotometricLoss
from .presets import NETWORK, CoarseToFineConfig, Stage
from .prior import PositionPrior, position_prior, squared_evidence
from .problem import Problem
from .smooth_field import SmoothField


@dataclass(frozen=True, eq=False)
class WindowedTargets:
    """The targets of a batch of problems, in windows around their clouds.

    ``initial`` [B, N, 3], ``counts`` [B] and ``weights`` [B, V] are as `ViewTargets` takes them.
    """

    problems: tuple[Problem, ...]
    initial: Tensor
    counts: Tensor
    weights: Tensor
    targets: ViewTargets

    @classmethod
    def of(cls, problems: Sequence[Problem], initial: Tensor, counts: Tensor, weights: Tensor) -> WindowedTargets:
        targets = ViewTargets([problem.resampled for problem in problems], counts, initial, weights)
        return cls(tuple(problems), initial, counts, weights, targets)

    def around(self, points: Tensor, fine_grid: bool) -> WindowedTargets:
        """The targets in windows around normalised ``points`` [B, N, 3]; itself where no window changes."""
        moved = tuple(
            problem.with_windows_around(problem.cloud.denormalised(cloud), fine_grid)
            for problem, cloud in zip(self.problems, points.double().cpu().numpy(), strict=True)
        )
        if all(
            new is old
            for after, before in zip(moved, self.problems, strict=True)
            for new, old in zip(after.resampled, before.resampled, strict=True)
        ):
            return self
        return WindowedTargets.of(moved, self.initial, self.counts, self.weights)


class SmoothFields:
    """Smooth fields of the same clouds with different numbers of nodes, built when they are first asked for."""

    def __init__(self, points: Tensor, counts: Tensor) -> None:
        self._points, self._counts = points, counts
        self._fields: dict[int, SmoothField] = {}

    def with_nodes(self, nodes: int) -> SmoothField:
        if nodes not in self._fields:
            self._fields[nodes] = SmoothField(self._points, self._counts, nodes)
        return self._fields[nodes]


@dataclass(frozen=True, eq=False)
class CoarseToFine:
    """A coarse-to-fine descent of B clouds.

    Parameters
    ----------
    windowed, fields : of the clouds at the start.
    learning_rate : about how far the node with the largest gradient moves in one of the first steps.
    follow : whether windows follow the clouds from stage to stage.
    evidence : [B], `Problem.evidence`; None for one mask. The more views, the less is the detail of the last stage a guess: its
        averaging weight grows with the square.
    photometric : of a single cloud with colours.
    """

    windowed: WindowedTargets
    fields: SmoothFields
    config: CoarseToFineConfig
    learning_rate: float
    follow: bool = True
    evidence: Tensor | None = None
    photometric: PhotometricLoss | None = None
    regulariser: Objective | None = None

    def run(self, steps: int, on_progress: Progress | None = None) -> tuple[Descent, tuple[Problem, ...]]:
        """Descend for ``steps`` in all.

        Returns
        -------
        The descent, whose ``best`` is the weighted mean of the stages' best iterates, or the start where that has a lower loss
        by the last objective; and the problems with their last windows.
        """
        windowed, config, counts = self.windowed, self.config, self.windowed.counts
        initial, stages = windowed.initial, config.stages
        evidence = self.evidence
        if evidence is not None:
            # What is truncated in every view stays unknown, however many there are.
            evidence = torch.where(windowed.targets.truncated.to(evidence.device), 1.0, evidence)
        finest = self.fields.with_nodes(max(stage.nodes for stage in stages))
        prior = position_prior(initial, counts, windowed.targets, finest, config, evidence)
        observed = windowed.targets.observed(initial)
        mobility = torch.where(observed, 1.0, config.unobserved_motion).to(initial).unsqueeze(-1)

        parts: list[Descent] = []
        points, done = initial, 0
        for number, stage in enumerate(stages, 1):
            if self.follow:
                previous, windowed = windowed, windowed.around(points, stage.fine_grid)
                if windowed is not previous:
                    prior = position_prior(initial, counts, windowed.targets, finest, config, evidence)
            objective = self._objective(stage, windowed.targets, prior, finest, points)
            field = self.fields.with_nodes(stage.nodes)
            parameter = torch.zeros(field.shape, dtype=initial.dtype, device=initial.device, requires_grad=True)
            forward = partial(_displaced, points, mobility, field, field.smoother(stage.smoothness), parameter)
            rate = stage.learning_rate_scale * self.learning_rate
            optimiser = (UniformAdam if config.per_cloud_adam else Adam)([parameter], rate)
            end = round(steps * number / len(stages))
            report = on_progress and offset_progress(on_progress, done, steps)
            part = descend(forward, objective, optimiser, end - done, report)
            parts.append(part)
            points, done = part.best, end
            if part.interrupted:
                break
        weights = [torch.full_like(initial[:, 0, 0], stage.averaging_weight) for stage in stages]
        weights[-1] = weights[-1] * squared_evidence(evidence, initial)
        return _averaged(parts, torch.stack(weights[: len(parts)]), initial, objective), windowed.problems

    def _objective(
        self, stage: Stage, targets: ViewTargets, prior: PositionPrior, finest: SmoothField, points: Tensor
    ) -> Objective:
        """The sum of all terms for a stage that starts at ``points``."""
        resolvability = targets.resolvability(points, finest) if self.config.use_resolvability else None
        terms: list[Objective] = [MaskChamferObjective(targets, stage.robust_scale, resolvability), prior]
        if self.photometric:
            terms.append(self.photometric.at(points, stage.blur))
        if self.regulariser:
            terms.append(self.regulariser)
        return partial(total_loss, terms)


def network_objective(initial: Tensor, counts: Tensor, targets: ViewTargets) -> Objective:
    """The objective of the preset "best" in the network modes: mask Chamfer loss and position prior."""
    field = SmoothField(initial, counts)
    prior = position_prior(initial, counts, targets, field, NETWORK)
    (stage,) = NETWORK.stages
    mask_chamfer = MaskChamferObjective(targets, stage.robust_scale, targets.resolvability(initial, field))
    return partial(total_loss, [mask_chamfer, prior])


def total_loss(terms: Sequence[Objective], points: Tensor) -> Tensor:
    """The sum [B] of the terms at ``points`` [B, N, 3]."""
    loss = terms[0](points)
    for term in terms[1:]:
        loss = loss + term(points)
    return loss


def _displaced(points: Tensor, mobility: Tensor, field: SmoothField, smoother: Tensor, parameter: Tensor) -> Tensor:
    return points + mobility * field.displacement(smoother, parameter)


def _averaged(parts: list[Descent], weights: Tensor, initial: Tensor, objective: Objective) -> Descent:
    """One descent of its P stages: the mean of their best iterates by ``weights`` [P, B], judged by the last objective."""
    last = parts[-1]
    # Displacements are averaged, not positions, so that unmoved points stay bit-identical.
    displacements = torch.stack([part.best - initial for part in parts])
    mean = initial + ((weights / weights.sum(0)).view(*weights.shape, 1, 1) * displacements).sum(0)
    with torch.no_grad():
        loss_at_start, loss_at_mean = objective(initial).double(), objective(mean).double()
    better = loss_at_mean < loss_at_start
    steps_before = sum(len(part.losses) - 1 for part in parts[:-1])
    return replace(
        last,
        best=torch.where(better.view(-1, 1, 1), mean, initial),
        best_step=np.where(better.cpu().numpy(), last.best_step + steps_before, 0),
        losses=np.concatenate([parts[0].losses, *(part.losses[1:] for part in parts[1:])]),
        first_loss=loss_at_start.cpu().numpy(),
        best_loss=torch.where(better, loss_at_mean, loss_at_start).cpu().numpy(),
    )
