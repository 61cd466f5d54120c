"""One cloud, from its prepared problem to the result."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from ..cloud.cloud import Array
from ..cloud.smooth_field import SmoothField
from ..diagnosis.mistake_check import checked_hint
from ..errors import TsoError
from ..losses.chamfer import ChamferToStart
from ..losses.photometric import Photo, PhotometricTerm
from ..optimisation.adam import Adam
from ..optimisation.camera_correction import corrected_cameras
from ..optimisation.loop import Descent, Parameters, Progress, Term, descend, sum_of
from ..optimisation.objective import SilhouetteObjective, ViewTargets
from ..optimisation.parameters import PointParameters
from ..optimisation.presets import BAD_START, MORE_STEPS, OPTIMISING, Stage
from ..optimisation.prior import start_loss
from ..optimisation.problem import Problem
from ..optimisation.stages import CoarseToFine, network_objective
from ..optimisation.symmetry_check import verified_symmetry
from ..optimisation.view_weights import ViewWeights
from .budget import decisions
from .config import Settings
from .judge import Outcome, judged
from .result import RefineResult, StopReason, result_warnings


class Stopwatch:
    """Wall time of the phases of a run."""

    def __init__(self) -> None:
        self.started = time.perf_counter()
        self.seconds: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A problem whose cameras, view weights and mirror plane are decided."""

    problem: Problem
    view_weights: ViewWeights  # of the views that were given
    loss_weights: list[float]  # of all views
    interrupted: bool  # Ctrl-C came, and nothing moves
    steps: int
    field: SmoothField | None = None  # of the start


def run(
    problem: Problem,
    settings: Settings,
    stopwatch: Stopwatch,
    network: Parameters | None = None,
    on_progress: Progress | None = None,
    interrupted: bool = False,
) -> RefineResult:
    """The result of a problem; ``interrupted`` : Ctrl-C came before, and nothing moves.

    Raises TsoError where the loss of the start, or after the first step, is not a finite number.
    """
    given_views = problem.views
    until = stopwatch.started + OPTIMISING * settings.seconds
    prepared = _prepare(problem, settings, stopwatch, interrupted, until)
    chamfer = ChamferToStart(problem.cloud.normalised())
    settings = replace(settings, steps=prepared.steps)
    with stopwatch.phase("optimise"):
        descent, problem = _optimise(prepared, network, chamfer, settings, on_progress, until)
    with stopwatch.phase("judge"):
        outcome = judged(
            problem, given_views, descent, prepared.field, prepared.view_weights, settings
        )
        chamfer_to_initial = chamfer(chamfer.initial + outcome.moved.displacements)[0]
    return _result(
        problem, outcome, descent, prepared, chamfer_to_initial, settings, stopwatch.seconds
    )


def _prepare(
    problem: Problem, settings: Settings, stopwatch: Stopwatch, interrupted: bool, until: float
) -> _Prepared:
    if problem.agreement and problem.agreement.hint and not interrupted:
        with stopwatch.phase("check mistake"):
            problem, interrupted = checked_hint(problem, settings, until)
    if settings.refine_camera and settings.steps and not interrupted:
        with stopwatch.phase("cameras"):
            half = time.perf_counter() + 0.5 * (until - time.perf_counter())
            problem, interrupted = corrected_cameras(problem, settings, half)
    with stopwatch.phase("prepare"):
        views = len(problem.views)
        weights = ViewWeights.even(views)
        if settings.preset == "best":
            weights = ViewWeights.of(problem.resampled[:views], problem.cloud.normalised())
        field = SmoothField(problem.cloud.normalised()) if settings.staged else None
    checked = settings.symmetry == "auto" and len(problem.resampled) > views
    if checked and settings.steps and not interrupted and field:
        with stopwatch.phase("check symmetry"):
            problem, interrupted = verified_symmetry(problem, weights.loss, settings, field, until)
    loss_weights = weights.loss * (2 if len(problem.resampled) > views else 1)
    with stopwatch.phase("prepare"):
        steps = settings.steps if interrupted else _steps(problem, loss_weights, settings)
    return _Prepared(problem, weights, loss_weights, interrupted, steps, field)


def _steps(problem: Problem, loss_weights: list[float], settings: Settings) -> int:
    """More than the default where the start fits several large masks badly."""
    if (
        not settings.staged
        or settings.full
        or "steps" in settings.given
        or not problem.several_large
    ):
        return settings.steps
    loss, _ = start_loss(
        problem.cloud.normalised(), ViewTargets.of(problem.resampled, loss_weights)
    )
    return settings.steps * (MORE_STEPS if loss > BAD_START else 1)


def _optimise(
    prepared: _Prepared,
    network: Parameters | None,
    chamfer: ChamferToStart,
    settings: Settings,
    on_progress: Progress | None,
    until: float,
) -> tuple[Descent, Problem]:
    """The descent, and the problem with its last windows."""
    problem, initial, weights = prepared.problem, chamfer.initial, prepared.loss_weights
    steps = 0 if prepared.interrupted else settings.steps
    on_progress = None if prepared.interrupted else on_progress
    regulariser: list[Term] = [_Weighted(settings.gamma, chamfer)] if settings.gamma else []
    if prepared.field:
        photos, colours = (
            _photos(problem, prepared.view_weights.loss),
            np.asarray(problem.cloud.colours, dtype=np.float64),
        )

        def stage_terms(points: Array, stage: Stage) -> list[Term]:
            return [
                *regulariser,
                *(PhotometricTerm.at(photo, colours, points, stage.blur) for photo in photos),
            ]

        coarse_to_fine = CoarseToFine(
            problem,
            weights,
            prepared.field,
            settings.coarse_to_fine,
            settings.learning_rate,
            evidence=problem.evidence(prepared.view_weights.loss),
            stage_terms=stage_terms,
        )
        descent, problem = coarse_to_fine.run(steps, on_progress, until)
    else:
        term: Term = SilhouetteObjective(problem.resampled, weights)
        if settings.preset == "best":
            term = network_objective(initial, ViewTargets.of(problem.resampled, weights))
        parameters = network or PointParameters(initial, Adam(settings.learning_rate))
        descent = descend(parameters, sum_of([term, *regulariser]), steps, on_progress, until)
    return replace(descent, interrupted=descent.interrupted or prepared.interrupted), problem


@dataclass(frozen=True, eq=False)
class _Weighted:
    weight: float
    term: Term

    def __call__(self, points: Array) -> tuple[float, Array]:
        value, gradient = self.term(points)
        return self.weight * value, self.weight * gradient


def _photos(problem: Problem, weights: list[float]) -> list[Photo]:
    """Of a cloud with colours, by its own views: paint, lettering above all, is not symmetric where the shape is."""
    if problem.cloud.colours is None:
        return []
    return [
        Photo(view.image, view.target.inside, view.camera, weight)
        for view, weight in zip(problem.resampled, weights, strict=False)
        if view.image is not None
    ]


def _result(
    problem: Problem,
    outcome: Outcome,
    descent: Descent,
    prepared: _Prepared,
    chamfer_to_initial: float,
    settings: Settings,
    seconds: dict[str, float],
) -> RefineResult:
    losses = [loss for loss in descent.losses if np.isfinite(loss)]
    finite = len(losses) == len(descent.losses)
    if not losses:
        raise TsoError("the loss of the start is no finite number")
    if len(losses) == 1 and not finite:
        raise TsoError(
            "the loss is no finite number after the first step (a smaller learning rate?)"
        )
    cloud, moved, plane = problem.cloud, outcome.moved, problem.symmetry.plane
    best_step = 0 if outcome.unmoved else descent.best_step
    iou_before, iou_after = np.mean(outcome.ious, 0).tolist()
    lengths = np.linalg.norm(moved.displacements, axis=1)
    result = RefineResult(
        points=moved.points,
        initial=cloud.given,
        mode=settings.mode,
        steps=len(losses) - 1,
        best_step=best_step,
        stop_reason=_stop_reason(finite, descent, outcome.unmoved, settings.steps),
        losses=losses,
        loss_before=0.0 if outcome.unmoved == "nothing_to_do" else descent.first_loss,
        loss_after=outcome.loss(problem.cloud.normalised(), descent),
        iou_before=iou_before,
        iou_after=iou_after,
        view_ious=outcome.ious,
        inlier_weights=prepared.view_weights.inlier,
        view_weights=prepared.view_weights.loss,
        view_windows=[
            (view.box, view.camera.width) for view in problem.resampled[: len(problem.views)]
        ],
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
        device=settings.device,
        cameras=tuple(view.camera for view in problem.views),
        seconds=seconds,
        surface=(cloud.judged, moved.judged) if cloud.surface else None,
        moving=len(moved.displacements),
        outliers=cloud.outliers,
        suspects=problem.agreement.named if problem.agreement else (),
        verdict=outcome.verdict.name,
        confidence=outcome.verdict.confidence,
        reason=outcome.verdict.reason,
        step_taken=outcome.taken,
        signs=outcome.signs,
        budget=decisions(problem, settings, descent),
    )
    return replace(
        result, warnings=result_warnings(result, problem.views, settings.steps, problem.suspicion)
    )


def _stop_reason(
    finite: bool, descent: Descent, unmoved: StopReason | None, steps: int
) -> StopReason:
    if not finite:
        return "non_finite"
    if descent.interrupted:
        return "interrupted"
    if descent.out_of_time and unmoved in (None, "not_improved"):
        return "out_of_time"
    if steps == 0 or not unmoved:
        return "max_steps"
    return "nothing_to_do" if descent.first_loss == 0.0 else unmoved
