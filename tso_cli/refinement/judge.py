"""What an optimisation comes to: whether the displacement is taken, and how sure it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..cloud.cloud import MovedCloud
from ..diagnosis.confidence import confidence_of, features_of
from ..diagnosis.determined import all_blocks, shares_fixed
from ..diagnosis.examine import Diagnosis
from ..diagnosis.findings import Finding
from ..diagnosis.trust import NO_REASON, Facts, Trust, Why, trust_of
from ..errors import TsoError
from ..evaluation.footprint import common_window, window_iou
from ..geometry.points import root_mean_square
from ..geometry.view import View
from ..losses.chamfer import ChamferToStart
from ..optimisation.config import Settings
from ..optimisation.loop import Optimised
from ..optimisation.optimise import WeighedProblem
from ..optimisation.presets import FEWEST_CONTROL_POINTS
from ..optimisation.problem import Problem
from ..pose.move import Move
from ..pose.placing import missed_by
from .result import Cost, Fit, RefineResult, StopReason, ViewFit

# A view with a lower inlier weight is a finding.
CONTRADICTED_WEIGHT = 0.5


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
    problem, cloud, weights = weighed.problem, weighed.problem.cloud, weighed.weights
    diagnosis = _outvoted(diagnosis, weights)
    start = moved = cloud.moved(np.zeros_like(cloud.start))
    # The learned prior may have moved a cloud that no step improved.
    by_prior = optimised.begun is not None and bool((optimised.best != cloud.start).any())
    improved = not diagnosis.fits and (optimised.best_step > 0 or by_prior)
    if improved:
        moved = cloud.moved(optimised.best - cloud.start)
    of_shape = _ious(problem, problem.views, moved)
    before, after = np.average(np.array(of_shape), axis=0, weights=weights)
    if settings.smooth and problem.masks_alone and after < before:
        # The loss counts distances, and may fall while the IoU falls too.
        improved, moved = False, start
        of_shape = [(iou, iou) for iou, _ in of_shape]
    ious = of_shape if move.kind == "nothing" else _ious(problem, given, moved)
    trust = _trust(problem, optimised, moved, improved, move, diagnosis, settings, of_shape)
    doubtful = trust.verdict == "doubtful" and not (trust.moves or settings.accept_doubtful)
    if doubtful:
        move, moved = move.taken_back("the result is doubtful"), start
        ious = [(before, before) for before, _ in ious]
    accepted = improved and not doubtful
    at = cloud.start + moved.displacements
    lengths = np.linalg.norm(moved.displacements, axis=1)
    begun = cloud.start if optimised.begun is None else optimised.begun.points
    iou_before, iou_after = np.mean(ious, 0).tolist()
    fit = Fit(
        outcome="moved" if accepted else "left",
        steps=optimised.steps,
        best_step=optimised.best_step if accepted else 0,
        stop_reason=_stop_reason(optimised, settings, diagnosis.fits, doubtful, improved),
        losses=losses,
        loss_before=optimised.first_loss,
        loss_after=optimised.best_loss if accepted else optimised.first_loss,
        iou_before=iou_before,
        iou_after=iou_after,
        moved_by_prior=float(np.linalg.norm(begun - cloud.start, axis=1).mean()),
        moved_mean=float(lengths.mean()),
        moved_max=float(lengths.max()),
        chamfer_to_initial=ChamferToStart(cloud.start)(at)[0],
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
            given, problem.given, ious, weights, strict=True
        )
    )
    determined = confidence = None
    if settings.smooth:
        of_points = shares_fixed(at, all_blocks(at, problem, weights))
        determined = float(of_points.mean())
        if settings.point_confidence:
            confidence = cloud.spread(of_points)
    return RefineResult(
        points=move.apply(moved.points),
        initial=cloud.source.points,
        measured=(cloud.measured, move.apply(moved.measured)),
        solids=(cloud.solid, moved.solid._replace(points=move.apply(moved.solid.points))),
        outliers=cloud.outliers,
        control_points=len(cloud.control_points),
        of_mesh=cloud.source.surface is not None,
        settings=settings,
        fit=fit,
        move=move,
        views=views,
        symmetry=problem.symmetry,
        trust=trust,
        cost=Cost(seconds),
        findings=(*diagnosis.findings, *_contradicted(weights)),
        determined=determined,
        point_confidence=confidence,
    )


def _trust(
    problem: Problem,
    optimised: Optimised,
    moved: MovedCloud,
    improved: bool,
    move: Move,
    diagnosis: Diagnosis,
    settings: Settings,
    ious: Sequence[tuple[float, float]],
) -> Trust:
    """What to think of the ``moved`` cloud. ``ious`` : of each view, after the ``move``."""
    cloud, placed = problem.cloud, move.kind != "nothing"
    before, after = missed_by(cloud.body, problem.views, moved.measured)
    of_run = problem, moved.displacements, optimised.begun, diagnosis
    features = features_of(*of_run, (before, after))
    confidence, group = confidence_of(features)
    far = root_mean_square(move.apply(moved.points) - cloud.source.points) / cloud.scale
    overlap = np.mean(ious, 0).tolist()
    facts = Facts(
        diagnosis,
        improved,
        placed,
        asked=settings.move != "auto",
        explains=move.explains,
        far=far,
        missed=(move.missed_before if placed else before, after),
        overlap=(overlap[0], overlap[1]),
        confidence=confidence,
        group=group,
        unknown=_why_unknown(problem, optimised, settings) if improved else NO_REASON,
    )
    return trust_of(facts, features)


def _outvoted(diagnosis: Diagnosis, weights: Sequence[float]) -> Diagnosis:
    """The diagnosis; views that something is wrong with are outvoted only if they count little."""
    wrong = {view for finding in diagnosis.of_views for view in finding.views}
    little = all(weights[view] < CONTRADICTED_WEIGHT for view in wrong)
    return replace(diagnosis, outvoted=diagnosis.outvoted and little)


def _why_unknown(problem: Problem, optimised: Optimised, settings: Settings) -> Why:
    """Why there is no confidence, if there is none."""
    points = len(problem.cloud.control_points)
    if points < FEWEST_CONTROL_POINTS:
        return "points", f"{points} points are too few"
    # An optimisation that ended because no loss was left is whole; what is left undone looks like a
    # mistake.
    steps = settings.steps if optimised.losses[-1] == 0.0 else optimised.steps
    if steps >= max(1.0, settings.steps / 2):
        return NO_REASON
    if optimised.interrupted:
        return "interrupted", "it was interrupted"
    return "steps", f"{steps} steps are too few"


def _ious(problem: Problem, before: Sequence[View], moved: MovedCloud) -> list[tuple[float, float]]:
    """The IoU of the start in each view of ``before``, and of the ``moved`` cloud afterwards.

    Both are in the same window.
    """
    ious = []
    for first, last in zip(before, problem.views, strict=True):
        stages = (problem.cloud.solid, first), (moved.solid, last)
        box = common_window(stages)
        ious.append((window_iou(*stages[0], box), window_iou(*stages[1], box)))
    return ious


def _stop_reason(
    optimised: Optimised, settings: Settings, fits: bool, doubtful: bool, improved: bool
) -> StopReason:
    if optimised.steps + 1 < len(optimised.losses):
        return "non_finite"
    if optimised.interrupted:
        return "interrupted"
    if doubtful and settings.steps:
        return "doubtful"
    if fits:
        return "fits"
    return "max_steps" if improved or not settings.steps else "not_improved"


def _contradicted(inlier_weights: Sequence[float]) -> list[Finding]:
    return [
        Finding("contradicted", (number,), values={"weight": weight})
        for number, weight in enumerate(inlier_weights)
        if weight < CONTRADICTED_WEIGHT
    ]
