"""What an optimisation comes to: whether the displacement is taken, and how sure it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..cloud.cloud import MovedCloud
from ..diagnosis.confidence import confidence_of, features_of
from ..diagnosis.determined import all_blocks, shares_fixed
from ..diagnosis.examine import Diagnosis
from ..diagnosis.findings import Finding
from ..diagnosis.trust import LEAST_OVERLAP, NO_REASON, Facts, Trust, Why, trust_of
from ..errors import TsoError
from ..evaluation.footprint import common_window, window_iou
from ..geometry.arrays import Array
from ..geometry.points import CANDIDATES, root_mean_square, scattered
from ..geometry.view import View
from ..losses.chamfer import ChamferToStart
from ..optimisation.loop import Optimised
from ..optimisation.optimise import WeighedProblem
from ..optimisation.presets import FEWEST_CONTROL_POINTS
from ..optimisation.problem import Problem
from ..optimisation.settings import Settings
from ..pose.move import Move
from ..pose.placing import missed_by
from .decisions import decisions
from .result import Cost, Fit, Outcome, RefineResult, StopReason, ViewFit

Ious = list[tuple[float, float]]  # of each view, before and after

# A view with a lower inlier weight is a finding.
CONTRADICTED_WEIGHT = 0.5
# Samples of a surface by which before and after are compared. In 75 refinements of the shipped
# meshes ten times as many decided alike.
SAMPLES_OF_A_MESH = 1536


@dataclass(frozen=True, eq=False)
class _Ending:
    """What becomes of a displacement."""

    moved: MovedCloud
    ious: Ious
    trust: Trust
    outcome: Outcome
    stop_reason: StopReason | None = None  # why the start is kept


def judge(
    weighed: WeighedProblem,
    optimised: Optimised,
    given: Sequence[View],
    move: Move,
    diagnosis: Diagnosis,
    settings: Settings,
    seconds: dict[str, float],
) -> RefineResult:
    """The result of an optimisation.

    The displacement is taken, or left where it is likely to make the cloud worse. The problem has
    the views after the ``move``. ``given`` are the views that were given.

    Raises TsoError where the loss of the start, or after the first step, is not a finite number.
    """
    losses = [loss for loss in optimised.losses if np.isfinite(loss)]
    if not losses:
        raise TsoError("the loss of the start is not a finite number")
    if len(losses) == 1 and len(optimised.losses) > 1:
        raise TsoError(
            "the loss is not a finite number after the first step (a smaller learning rate?)"
        )
    problem = weighed.problem
    ending = _ending(weighed, problem, optimised, given, move, diagnosis, settings)
    if ending.stop_reason == "doubtful":
        move = move.taken_back("the result is doubtful")
    cloud, moved, weights = problem.cloud, ending.moved, weighed.weights
    lengths = np.linalg.norm(moved.displacements, axis=1)
    begun = cloud.start if optimised.begun is None else optimised.begun.points
    chamfer, _ = ChamferToStart(cloud.start)(cloud.start + moved.displacements)
    iou_before, iou_after = np.mean(ending.ious, 0).tolist()
    fit = Fit(
        outcome=ending.outcome,
        steps=optimised.steps,
        best_step=optimised.best_step if ending.outcome == "moved" else 0,
        stop_reason=_stop_reason(optimised, ending, settings.steps),
        losses=losses,
        loss_before=0.0 if ending.stop_reason == "nothing_to_do" else optimised.first_loss,
        loss_after=_loss_after(optimised, ending),
        iou_before=iou_before,
        iou_after=iou_after,
        moved_by_prior=float(np.linalg.norm(begun - cloud.start, axis=1).mean()),
        moved_mean=float(lengths.mean()),
        moved_max=float(lengths.max()),
        chamfer_to_initial=chamfer,
    )
    views = tuple(
        ViewFit(
            name=view.name,
            camera=windowed.view.camera if move.kind == "camera" else view.camera,
            iou_before=before,
            iou_after=after,
            inlier_weight=weight,
            window=windowed.resampled.box,
            cells=windowed.resampled.camera.width,
        )
        for view, windowed, (before, after), weight in zip(
            given, problem.given, ending.ious, weights, strict=True
        )
    )
    determined = confidence = None
    if settings.smooth:
        at = cloud.start + moved.displacements
        of_points = shares_fixed(at, all_blocks(at, problem, weights))
        determined = float(of_points.mean())
        if settings.point_confidence:
            confidence = cloud.spread(of_points)
    return RefineResult(
        points=move.apply(moved.points),
        initial=cloud.source.points,
        measured=(cloud.measured, move.apply(moved.measured)),
        outliers=cloud.outliers,
        control_points=len(cloud.control_points),
        of_mesh=cloud.source.surface is not None,
        settings=settings,
        fit=fit,
        move=move,
        views=views,
        symmetry=problem.symmetry,
        trust=ending.trust,
        cost=Cost(seconds, decisions(problem, settings, optimised)),
        findings=(*diagnosis.findings, *_contradicted(weights)),
        determined=determined,
        point_confidence=confidence,
    )


def _ending(
    weighed: WeighedProblem,
    problem: Problem,
    optimised: Optimised,
    given: Sequence[View],
    move: Move,
    diagnosis: Diagnosis,
    settings: Settings,
) -> _Ending:
    diagnosis = _outvoted(diagnosis, weighed)
    cloud = problem.cloud
    displacements = optimised.best - cloud.start
    moved, of_shape = _moved(problem, displacements)
    # The learned prior may have moved a cloud that no step improved.
    improved = optimised.best_step > 0 or (optimised.begun is not None and displacements.any())
    kept: StopReason | None = None if improved else "not_improved"
    if kept and diagnosis.fits:
        kept = "fits"
    elif settings.smooth and problem.masks_alone:
        kept = _why_start_is_kept(problem, moved, of_shape, weighed.weights) or kept
    start = cloud.moved(np.zeros_like(displacements))
    if kept:
        moved, displacements = start, np.zeros_like(displacements)
        of_shape = [(before, before) for before, _ in of_shape]
    unknown = NO_REASON if kept else _why_unknown(problem, optimised, settings)
    of_run = problem, optimised, displacements, moved, of_shape, move, diagnosis
    facts, features = _facts(*of_run, not kept, settings.move != "auto", unknown)
    trust = trust_of(facts, features)
    ious = of_shape if move.kind == "nothing" else _ious(problem, given, moved)
    if trust.verdict == "doubtful" and not (trust.moves or settings.accept_doubtful):
        return _Ending(start, [(before, before) for before, _ in ious], trust, "left", "doubtful")
    return _Ending(moved, ious, trust, "left" if kept else "moved", kept)


def _facts(
    problem: Problem,
    optimised: Optimised,
    displacements: Array,
    moved: MovedCloud,
    ious: Ious,
    move: Move,
    diagnosis: Diagnosis,
    improved: bool,
    asked: bool,
    unknown: Why,
) -> tuple[Facts, dict[str, float]]:
    """What is known of a displaced cloud, and the features of its confidence."""
    cloud = problem.cloud
    before, after = missed_by(cloud.body, problem.views, moved.measured)
    features = features_of(problem, displacements, optimised.begun, diagnosis, (before, after))
    confidence, group = confidence_of(features)
    far = move.apply(moved.points) - cloud.source.points
    overlap = np.mean(ious, 0).tolist()
    placed = move.kind != "nothing"
    facts = Facts(
        diagnosis,
        improved,
        placed,
        asked,
        explains=move.explains,
        far=root_mean_square(far) / cloud.scale,
        missed=(move.missed_before if placed else before, after),
        overlap=(overlap[0], overlap[1]),
        confidence=confidence,
        group=group,
        unknown=unknown,
    )
    return facts, features


def _outvoted(diagnosis: Diagnosis, weighed: WeighedProblem) -> Diagnosis:
    """The diagnosis; views that something is wrong with are outvoted only if they count little."""
    wrong = {view for finding in diagnosis.of_views for view in finding.views}
    little = all(weighed.weights[view] < CONTRADICTED_WEIGHT for view in wrong)
    return replace(diagnosis, outvoted=diagnosis.outvoted and little)


def _why_unknown(problem: Problem, optimised: Optimised, settings: Settings) -> Why:
    """Why there is no confidence, if there is none."""
    # An optimisation that ended because no loss was left is whole.
    steps = settings.steps if optimised.losses[-1] == 0.0 else optimised.steps
    points = len(problem.cloud.control_points)
    # What is left undone looks like a mistake.
    few = steps < max(1.0, settings.steps / 2)
    reasons = (
        ("points", f"{points} points are too few", points < FEWEST_CONTROL_POINTS),
        ("interrupted", "it was interrupted", few and optimised.interrupted),
        ("steps", f"{steps} steps are too few", few),
    )
    return next(((name, says) for name, says, holds in reasons if holds), NO_REASON)


def _moved(problem: Problem, displacements: Array) -> tuple[MovedCloud, Ious]:
    """The cloud after ``displacements``, and the IoU of each view before and after them."""
    moved = problem.cloud.moved(displacements)
    return moved, _ious(problem, problem.views, moved)


def _ious(problem: Problem, before: Sequence[View], moved: MovedCloud) -> Ious:
    """The IoU of the start in each view of ``before``, and of the ``moved`` cloud afterwards.

    Both are in the same window.
    """
    ious = []
    for first, last in zip(before, problem.views, strict=True):
        stages = (problem.cloud.measured, first), (moved.measured, last)
        box = common_window(stages)
        ious.append((window_iou(*stages[0], box), window_iou(*stages[1], box)))
    return ious


def _why_start_is_kept(
    problem: Problem, moved: MovedCloud, ious: Ious, weights: Sequence[float]
) -> StopReason | None:
    """Why the start is better than the ``moved`` cloud by masks alone; None if it is not."""
    if problem.cloud.partial:
        before, after = _misfits(problem, moved, weights)
        if after >= before:
            return "not_improved" if before else "nothing_to_do"
    return "not_improved" if _agrees_less(ious, weights) else None


def _agrees_less(ious: Ious, weights: Sequence[float]) -> bool:
    """Whether the IoU fell.

    The mask Chamfer loss counts distances, and may fall while the IoU falls too, as for a right
    start and a coarse mask.
    """
    before, after = np.average(ious, axis=0, weights=weights)
    # Coming nearer to a mask that is hardly touched, as a pole to another, need not raise the IoU.
    return bool(after < before and before >= LEAST_OVERLAP)


def _misfits(problem: Problem, moved: MovedCloud, weights: Sequence[float]) -> tuple[float, float]:
    """The mask Chamfer loss of all measured points, before and after.

    Between few control points there are gaps, which ask for a motion that the whole cloud does not
    need.
    """
    loss = problem.without_flipped().targets(weights).loss
    most = SAMPLES_OF_A_MESH if problem.cloud.source.surface else CANDIDATES
    before, after = (
        loss(problem.cloud.normalise(scattered(points, most)))[0]
        for points in (problem.cloud.measured, moved.measured)
    )
    return before, after


def _loss_after(optimised: Optimised, ending: _Ending) -> float:
    """By the objective without the position prior."""
    if ending.outcome != "moved":
        return 0.0 if ending.stop_reason == "nothing_to_do" else optimised.first_loss
    return optimised.best_loss


def _stop_reason(optimised: Optimised, ending: _Ending, steps: int) -> StopReason:
    if optimised.steps + 1 < len(optimised.losses):
        return "non_finite"
    if optimised.interrupted:
        return "interrupted"
    kept = ending.stop_reason
    if not kept or (steps == 0 and kept != "fits"):
        return "max_steps"
    return "nothing_to_do" if optimised.first_loss == 0.0 and kept != "fits" else kept


def _contradicted(inlier_weights: Sequence[float]) -> list[Finding]:
    return [
        Finding("contradicted", (number,), values={"weight": weight})
        for number, weight in enumerate(inlier_weights)
        if weight < CONTRADICTED_WEIGHT
    ]
