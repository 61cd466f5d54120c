"""One batch, from prepared problems to results."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from ..device import one_thread
from ..errors import TsoError
from ..evaluation.footprint import common_window, window_iou
from ..geometry.view import View
from ..silhouette.chamfer import ChamferToInitial
from .adam import Adam
from .camera_correction import corrected_cameras
from .cloud import Array, MovedCloud
from .coarse_to_fine import CoarseToFine, SmoothFields, WindowedTargets, network_objective, total_loss
from .config import Settings
from .objective import SilhouetteObjective, ViewTargets
from .optimise import Descent, Objective, Progress, descend
from .parameters import NetworkParameters, PointParameters
from .photometric import PhotometricLoss
from .problem import Problem
from .result import RefineResult, StopReason, result_warnings
from .symmetry_check import verified_symmetry
from .view_weights import ViewWeights

# Clouds up to this size run on one CPU thread, alone or in a batch: threads would wait for one another.
SMALL_CLOUD = 8192
ONE_THREAD_MODES = ("points", "latent")
# A start of lower IoU hardly touches its mask, as a pole beside its own: coming nearer need not raise the IoU.
FEEBLE_IOU = 0.1


class Stopwatch:
    """Wall time of the phases of a run."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A batch whose cameras, view weights and mirror planes are decided."""

    problems: Sequence[Problem]
    initial: Tensor  # [B, N, 3], normalised
    view_weights: ViewWeights  # of the views that were given
    loss_weights: Tensor  # [B, V or 2 V], of all views
    fields: SmoothFields  # of ``initial``
    interrupted: bool  # Ctrl-C came, and nothing moves


def run_batch(
    problems: Sequence[Problem],
    parameters: PointParameters | NetworkParameters,
    settings: Settings,
    stopwatch: Stopwatch,
    on_progress: Progress | None = None,
    interrupted: bool = False,
) -> list[RefineResult | TsoError]:
    """The results of B problems of one batch; ``interrupted`` : Ctrl-C came before, and nothing moves."""
    given_views = [problem.views for problem in problems]
    small = int(parameters.counts.max()) <= SMALL_CLOUD
    with one_thread(small and settings.mode in ONE_THREAD_MODES):
        prepared = _prepare(problems, parameters, settings, stopwatch, interrupted)
        chamfer = ChamferToInitial(prepared.initial, parameters.counts)
        with stopwatch.phase("optimise"):
            descent, problems = _optimise(prepared, parameters, chamfer, settings, on_progress)
    with stopwatch.phase("judge"), one_thread(small):
        displacements = descent.best.double() - prepared.initial.double()
        outcomes = _judge(problems, given_views, displacements, prepared.view_weights, settings)
        for row, outcome in zip(displacements, outcomes, strict=True):
            row[: len(outcome.moved.displacements)] = torch.from_numpy(outcome.moved.displacements)
        chamfer_to_initial = chamfer((prepared.initial.double() + displacements).to(prepared.initial)).tolist()
    seconds = {phase: value / len(problems) for phase, value in stopwatch.seconds.items()}
    return [
        _result(number, problem, outcome, descent, prepared, chamfer_to_initial[number], settings, seconds)
        for number, (problem, outcome) in enumerate(zip(problems, outcomes, strict=True))
    ]


def _prepare(
    problems: Sequence[Problem],
    parameters: PointParameters | NetworkParameters,
    settings: Settings,
    stopwatch: Stopwatch,
    interrupted: bool,
) -> _Prepared:
    counts = parameters.counts
    initial = parameters.forward().detach().clone()
    if settings.refine_camera and settings.steps and not interrupted:
        with stopwatch.phase("cameras"):
            problems, interrupted = corrected_cameras(problems, initial, counts, settings)
    with stopwatch.phase("prepare"):
        views = len(problems[0].views)
        weights = ViewWeights.even(len(problems), views)
        if settings.preset == "best" and settings.coarse_to_fine.weigh_views:
            weights = ViewWeights.of([problem.resampled[:views] for problem in problems], counts, initial)
        loss_weights, fields = weights.loss, SmoothFields(initial, counts)
        if len(problems[0].resampled) > views:  # flipped views
            if settings.symmetry == "auto" and settings.steps and not interrupted:
                problems, loss_weights, interrupted = verified_symmetry(
                    problems, counts, initial, weights.loss, settings, fields
                )
            else:
                loss_weights = weights.loss.repeat(1, 2)
    return _Prepared(problems, initial, weights, loss_weights, fields, interrupted)


def _optimise(
    prepared: _Prepared,
    parameters: PointParameters | NetworkParameters,
    chamfer: ChamferToInitial,
    settings: Settings,
    on_progress: Progress | None,
) -> tuple[Descent, Sequence[Problem]]:
    """The descent, and the problems with their last windows."""
    problems, initial, counts, weights = prepared.problems, prepared.initial, parameters.counts, prepared.loss_weights
    steps = 0 if prepared.interrupted else settings.steps
    on_progress = None if prepared.interrupted else on_progress
    regulariser = partial(_weighted, settings.gamma, chamfer) if settings.gamma else None
    if settings.staged:
        per_cloud = prepared.view_weights.loss.tolist()
        evidence = torch.tensor([problem.evidence(row) for problem, row in zip(problems, per_cloud, strict=True)])
        coarse_to_fine = CoarseToFine(
            WindowedTargets.of(problems, initial, counts, weights),
            prepared.fields,
            settings.coarse_to_fine,
            settings.learning_rate,
            evidence=evidence,
            photometric=_photometric(problems[0], per_cloud[0], initial),
            regulariser=regulariser,
        )
        descent, problems = coarse_to_fine.run(steps, on_progress)
    else:
        views = [problem.resampled for problem in problems]
        term: Objective
        if settings.preset == "best":
            term = network_objective(initial, counts, ViewTargets(views, counts, initial, weights))
        else:
            term = SilhouetteObjective(views, counts, initial, weights)
        objective = partial(total_loss, [term, regulariser]) if regulariser else term
        optimiser = Adam(parameters.parameters, settings.learning_rate)
        descent = descend(parameters.forward, objective, optimiser, steps, on_progress)
    return replace(descent, interrupted=descent.interrupted or prepared.interrupted), problems


def _weighted(weight: float, term: Objective, points: Tensor) -> Tensor:
    return weight * term(points)


def _photometric(problem: Problem, weights: list[float], initial: Tensor) -> PhotometricLoss | None:
    """Of a single cloud with colours, by its own views: paint, lettering above all, is not symmetric where the shape is."""
    if problem.cloud.colours is None:
        return None
    own_views = problem.resampled[: len(problem.views)]
    return PhotometricLoss.of(own_views, weights, torch.from_numpy(problem.cloud.colours), initial)


@dataclass(frozen=True, eq=False)
class _Outcome:
    moved: MovedCloud
    ious: list[tuple[float, float]]  # of each view, before and after
    reverted: bool = False  # to the start, because the IoU would have fallen


def _judge(
    problems: Sequence[Problem],
    given_views: Sequence[tuple[View, ...]],
    displacements: Tensor,
    view_weights: ViewWeights,
    settings: Settings,
) -> list[_Outcome]:
    outcomes = []
    for problem, views, displacement, weights in zip(
        problems, given_views, displacements.cpu().numpy(), view_weights.loss.tolist(), strict=True
    ):
        moved = problem.cloud.moved(displacement)
        outcome = _Outcome(moved, view_ious(problem.cloud.judged, moved.judged, views, problem.views))
        # Corrected cameras may lower the IoU rightly.
        if settings.staged and problem.views == views and _agrees_less(problem, outcome.ious, weights):
            unmoved = problem.cloud.moved(np.zeros_like(moved.displacements))
            outcome = _Outcome(unmoved, [(before, before) for before, _ in outcome.ious], reverted=True)
        outcomes.append(outcome)
    return outcomes


def view_ious(initial: Array, refined: Array, given: Sequence[View], corrected: Sequence[View]) -> list[tuple[float, float]]:
    """IoU of each view before, by the given camera, and after, by the corrected one; both in the same window."""
    ious = []
    for before, after in zip(given, corrected, strict=True):
        stages = (initial, before), (refined, after)
        box = common_window(stages)
        ious.append((window_iou(*stages[0], box), window_iou(*stages[1], box)))
    return ious


def _agrees_less(problem: Problem, ious: list[tuple[float, float]], weights: list[float]) -> bool:
    """Whether masks are all there is, and the IoU fell.

    The mask Chamfer loss counts distances, and may fall while the IoU falls too, as for a right start and a coarse mask.
    """
    if any(view.depth is not None or view.image is not None for view in problem.views):
        return False
    before, after = np.average(ious, axis=0, weights=weights)
    return bool(after < before and before >= FEEBLE_IOU)


def _result(
    number: int,
    problem: Problem,
    outcome: _Outcome,
    descent: Descent,
    prepared: _Prepared,
    chamfer_to_initial: float,
    settings: Settings,
    seconds: dict[str, float],
) -> RefineResult | TsoError:
    losses = descent.losses[:, number]
    finite = np.isfinite(losses)
    steps = int(finite.sum()) - 1
    if steps < 0:
        return TsoError("the loss of the start is no finite number")
    if steps == 0 and not finite.all():
        return TsoError("the loss is no finite number after the first step (a smaller learning rate?)")
    cloud, moved, plane = problem.cloud, outcome.moved, problem.symmetry.plane
    best_step = 0 if outcome.reverted else int(descent.best_step[number])
    first_loss = float(descent.first_loss[number])
    iou_before, iou_after = np.mean(outcome.ious, 0).tolist()
    lengths = np.linalg.norm(moved.displacements, axis=1)
    result = RefineResult(
        points=moved.points,
        initial=cloud.given,
        mode=settings.mode,
        steps=steps,
        best_step=best_step,
        stop_reason=_stop_reason(bool(finite.all()), descent.interrupted, best_step, first_loss, settings.steps),
        losses=losses[finite].tolist(),
        loss_before=first_loss,
        loss_after=first_loss if outcome.reverted else float(descent.best_loss[number]),
        iou_before=iou_before,
        iou_after=iou_after,
        view_ious=outcome.ious,
        view_trust=prepared.view_weights.inlier[number].tolist(),
        view_weights=prepared.view_weights.loss[number].tolist(),
        view_windows=[(view.box, view.camera.width) for view in problem.resampled[: len(problem.views)]],
        moved_mean=float(lengths.mean()),
        moved_max=float(lengths.max()),
        chamfer_to_initial=chamfer_to_initial,
        symmetry=None if plane is None else (*plane.normal.tolist(), plane.offset),
        symmetry_outcome=problem.symmetry.outcome,
        symmetry_reason=problem.symmetry.reason,
        preset=settings.preset,
        learning_rate=settings.learning_rate,
        gamma=settings.gamma,
        sigma_sq=settings.sigma_sq,
        device=str(prepared.initial.device),
        seed=settings.seed,
        cameras=tuple(view.camera for view in problem.views),
        seconds=seconds,
        surface=(cloud.judged, moved.judged) if cloud.surface else None,
        surface_samples=len(moved.displacements) if cloud.surface else None,
    )
    return replace(result, warnings=result_warnings(result, problem.views, settings.steps))


def _stop_reason(finite: bool, interrupted: bool, best_step: int, first_loss: float, steps: int) -> StopReason:
    if not finite:
        return "non_finite"
    if interrupted:
        return "interrupted"
    if steps == 0 or best_step > 0:
        return "max_steps"
    return "nothing_to_do" if first_loss == 0.0 else "not_improved"
