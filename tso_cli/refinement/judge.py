"""What a descent comes to: how far its step is taken, and how far the result agrees with the views."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..cloud.cloud import Array, MovedCloud
from ..cloud.smooth_field import SmoothField
from ..diagnosis.confidence import UNJUDGED, Verdict, signs_of
from ..evaluation.footprint import common_window, window_iou
from ..geometry.points import CANDIDATES, scattered
from ..geometry.view import View
from ..optimisation.loop import Descent
from ..optimisation.objective import MaskChamferObjective, ViewTargets
from ..optimisation.presets import BEST_STEPS, FEWEST_POINTS, STAGES
from ..optimisation.problem import Problem
from ..optimisation.view_weights import ViewWeights
from .config import Settings
from .result import StopReason

# A start of lower IoU hardly touches its mask, as a pole beside its own: coming nearer need not raise the IoU.
FEEBLE_IOU = 0.1
# Results of fewer steps are not judged.
FEWEST_STEPS = BEST_STEPS["points"] // 4


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a descent comes to. taken : share of its step that is; unmoved : why none is."""

    moved: MovedCloud
    ious: list[tuple[float, float]]  # of each view, before and after
    verdict: Verdict = UNJUDGED
    taken: float = 1.0
    unmoved: StopReason | None = None
    signs: dict[str, float] = dataclasses.field(default_factory=dict)

    def loss(self, start: Array, descent: Descent) -> float:
        """By the last objective of the ``descent`` from ``start`` [N, 3]."""
        if self.unmoved:
            return 0.0 if self.unmoved == "nothing_to_do" else descent.first_loss
        if self.taken == 1.0 or descent.objective is None:
            return descent.best_loss
        return descent.objective(start + self.taken * (descent.best - start))[0]


def judged(
    problem: Problem,
    given_views: Sequence[View],
    descent: Descent,
    field: SmoothField | None,
    view_weights: ViewWeights,
    settings: Settings,
) -> Outcome:
    """The step of a descent, taken whole, or in part or not at all where it is likely to make the cloud worse.

    ``problem`` has its last windows; ``field`` is of the start; ``view_weights`` are of the views that were given.
    """
    step = descent.best - problem.cloud.normalised()
    outcome = _after(problem, given_views, step)
    # Corrected cameras may lower the IoU rightly.
    compared = settings.staged and problem.views == given_views
    fits = problem.cloud.partial and compared and problem.masks_alone
    before, after = _misfits(problem, outcome.moved, view_weights.loss) if fits else (1.0, 0.0)
    if (
        descent.best_step == 0
        or after >= before
        or (compared and _agrees_less(problem, outcome.ious, view_weights.loss))
    ):
        unmoved = problem.cloud.moved(np.zeros_like(step))
        ious = [(start, start if descent.best_step else end) for start, end in outcome.ious]
        reason: StopReason = "not_improved" if before else "nothing_to_do"
        return Outcome(
            unmoved, ious, Verdict.unchanged(problem.suspicion), taken=0.0, unmoved=reason
        )
    signs: dict[str, float] = {}
    unjudged = _why_unjudged(problem, descent, settings)
    if unjudged is not None:
        verdict = (
            Verdict("doubtful", None, problem.suspicion)
            if problem.suspicion
            else Verdict(None, None, unjudged)
        )
    else:
        assert field is not None
        assert problem.agreement is not None
        signs = signs_of(problem, field, descent, outcome.ious, view_weights.inlier)
        verdict = Verdict.of(signs, problem.agreement)
    taken = 1.0 if settings.accept_doubtful else verdict.step
    if taken < 1.0:
        outcome = _after(problem, given_views, taken * step)
    return replace(
        outcome, verdict=verdict, taken=taken, unmoved=None if taken else "doubtful", signs=signs
    )


def _why_unjudged(problem: Problem, descent: Descent, settings: Settings) -> str | None:
    """Why there is no confidence, None where there is one."""
    # What a few steps leave undone looks like a mistake.
    steps = len(descent.losses) - 1 if descent.out_of_time else settings.steps
    few = len(descent.stages) < len(STAGES) or steps < FEWEST_STEPS
    reasons = {
        "only mode points with preset best is": not settings.staged,
        "none with a depth map or a photo is": not problem.masks_alone,
        f"{len(problem.cloud.initial)} points are too few": len(problem.cloud.initial)
        < FEWEST_POINTS,
        "it was interrupted": few and descent.interrupted,
        # The confidence counts on a symmetry check of a cloud that has a mirror plane.
        f"{settings.seconds:g} s were too few": descent.out_of_time
        and few
        or problem.symmetry.outcome == "unchecked",
        f"{steps} steps are too few": few,
    }
    return next((reason for reason, holds in reasons.items() if holds), None)


def _after(problem: Problem, given_views: Sequence[View], displacements: Array) -> Outcome:
    moved = problem.cloud.moved(displacements)
    return Outcome(moved, view_ious(problem.cloud.judged, moved.judged, given_views, problem.views))


def view_ious(
    initial: Array, refined: Array, given: Sequence[View], corrected: Sequence[View]
) -> list[tuple[float, float]]:
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
    if not problem.masks_alone:
        return False
    before, after = np.average(ious, axis=0, weights=weights)
    return bool(after < before and before >= FEEBLE_IOU)


def _misfits(problem: Problem, moved: MovedCloud, weights: list[float]) -> tuple[float, float]:
    """The mask Chamfer loss of all points that are judged, before and after, not of those alone that moved by themselves.

    Between few points there are gaps, which ask for a motion that the whole cloud does not need.
    """
    targets = ViewTargets.of(problem.resampled[: len(problem.views)], weights)
    objective = MaskChamferObjective(targets, STAGES[-1].robust_scale)
    clouds = (scattered(points, CANDIDATES) for points in (problem.cloud.judged, moved.judged))
    before, after = (objective(problem.cloud.normalise(points))[0] for points in clouds)
    return before, after
