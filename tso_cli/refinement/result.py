"""What a refinement results in, and the warnings that go with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..cloud.cloud import outlier_warnings
from ..diagnosis.confidence import shown
from ..diagnosis.hypotheses import Suspect
from ..diagnosis.placement import mask_doubts
from ..geometry.camera import Camera
from ..geometry.view import View
from ..geometry.window import Box
from ..optimisation.symmetry import SymmetryOutcome
from .budget import Decision

Array = NDArray[np.float64]
StopReason = Literal[
    "max_steps",
    "interrupted",
    "non_finite",
    "out_of_time",
    "nothing_to_do",
    "not_improved",
    "doubtful",
]

# A view with a lower inlier weight is warned of.
DOUBTFUL_INLIER_WEIGHT = 0.5
# A largest displacement under this share of the object's size is warned of.
SMALL_DISPLACEMENT = 1e-3


@dataclass(frozen=True, eq=False)
class RefineResult:
    """The refined cloud, and how it was reached.

    Attributes
    ----------
    points, initial : [N, 3] float64, in the frame and units of the input (network modes: of the network's output); of a mesh
        its vertices.
    steps : steps done; best_step : the step that the result is from, 0 where the start was best. With the preset "best" of
        points mode, whose result is a mean over the stages, the best step of the last stage.
    stop_reason : "max_steps"; "interrupted" (Ctrl-C), "out_of_time" (of the budget) or "non_finite" (the loss became NaN or
        infinite), after which the best so far is kept; or, where the result is the start, "nothing_to_do" (its loss is 0),
        "not_improved" (no step had a lower loss) or "doubtful" (the step was likely to make the cloud worse).
    warnings : one sentence each, to read before the result is used.
    losses : the objective at the start and after every step. loss_before, loss_after : of the start and of the result. With
        the preset "best" the objective changes from stage to stage: these two are both by the last.
    iou_before, iou_after : of the mask (> 0.5) and the cloud's silhouette, whose footprints follow the cloud's spacing
        (evaluation/footprint.py), in the square around both; mean over views.
    view_ious : the two of each view. inlier_weights : of each view, under 1 where the other views contradict it.
        view_weights : of its loss in the objective: the inlier weight, divided among views of the same side.
    moved_mean, moved_max : length of the points' displacements, in longest sides of the start.
    chamfer_to_initial : squared distances, mean over points, both directions summed, for a cloud of longest side 1.
    surface : of a mesh the points [S, 3] sampled from its surface before and after, which IoU is of; None of a cloud.
    moving : how many points moved by themselves, which moved_mean and chamfer_to_initial are of: samples of a mesh's faces,
        or some points of a large cloud, which all others follow.
    outliers : [N] bool, points far from the rest: they stay where they are, and no measure is of them.
    symmetry : a, b, c, d of the mirror plane ax + by + cz = d that was used, in the frame of the input, or None.
    symmetry_outcome : "used" (a plane that was found), "given", or without a plane "not_asked", "none_found" (the cloud has
        none), "contradicted" (the cloud has one, the views contradict it) or "unchecked" (there was no time to ask the views).
        symmetry_reason : the measurement, in words.
    suspects : what may be wrong with the input, likeliest first.
    verdict : "improved", "unchanged", or "doubtful": the whole step is likely to make the cloud worse, or a mistake in the
        input is suspected, for the ``reason``; None where it is not judged, for the ``reason``. confidence : in [0, 1], that
        the whole step does not make it worse by over 5 % in Chamfer distance; None as before. signs : what it is from.
        step_taken : share of the step that was taken, under 1 where it is doubtful, 0 where nothing moved.
    sigma_sq : squared cells. budget : what was decided from the scene, why, and what that saved.
    view_windows : left, top, right, bottom edges of the window of each mask, px, that the cloud was compared with at last,
        and cells along its side.
    cameras : with ``refine_camera`` the corrected ones.
    seconds : wall time of each phase.
    """

    points: Array
    initial: Array
    mode: str
    steps: int
    best_step: int
    stop_reason: StopReason
    losses: list[float]
    loss_before: float
    loss_after: float
    iou_before: float
    iou_after: float
    view_ious: list[tuple[float, float]]
    inlier_weights: list[float]
    view_weights: list[float]
    view_windows: list[tuple[Box, int]]
    moved_mean: float
    moved_max: float
    chamfer_to_initial: float
    symmetry: tuple[float, float, float, float] | None
    symmetry_outcome: SymmetryOutcome
    symmetry_reason: str
    preset: str
    learning_rate: float
    gamma: float
    sigma_sq: float
    device: str
    cameras: tuple[Camera, ...]
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    surface: tuple[Array, Array] | None = None
    moving: int = 0
    outliers: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    suspects: tuple[Suspect, ...] = ()
    verdict: str | None = None
    confidence: float | None = None
    reason: str = ""
    step_taken: float = 1.0
    signs: dict[str, float] = field(default_factory=dict)
    budget: tuple[Decision, ...] = ()

    @property
    def judged(self) -> tuple[Array, Array]:
        """The points that measures are of, before and after: those of a cloud but outliers, or samples [S, 3] of a surface."""
        if self.surface or not self.outliers.any():
            return self.surface or (self.initial, self.points)
        return self.initial[~self.outliers], self.points[~self.outliers]

    @property
    def averaged(self) -> bool:
        """Whether the points are a mean over stages, not one iterate."""
        return self.preset == "best" and self.mode == "points"

    @property
    def objective(self) -> str:
        chamfer = f"{self.gamma:g} x Chamfer to the start"
        if self.preset == "paper":
            return f"BCE + {chamfer}"
        return "mask Chamfer loss + position prior" + (f" + {chamfer}" if self.gamma else "")


def why_unmoved(result: RefineResult) -> str | None:
    """Why no point moved, in words; None where points did."""
    if result.best_step:
        return None
    shows = "the mask shows" if len(result.cameras) == 1 else "the masks show"
    return {
        "max_steps": "no steps were asked for",
        "interrupted": f"interrupted at step {result.steps}, before one lowered the loss",
        "non_finite": f"the loss was no number after step {result.steps}, and none before was lower than that of the start",
        "out_of_time": f"the budget's seconds were over after {result.steps} steps, before one agreed better with what {shows}",
        "nothing_to_do": f"the cloud already agrees with all that {shows}",
        "not_improved": f"none of {result.steps} steps agrees better with what {shows} than the start does",
        "doubtful": "the step is doubtful (--accept-doubtful takes it all the same)",
    }["doubtful" if refused(result) else result.stop_reason]


def refused(result: RefineResult) -> bool:
    """Whether there was a step, and it is too doubtful to be taken; not where the start was best and a mistake is suspected."""
    return bool(result.signs) and not result.step_taken


def result_warnings(
    result: RefineResult, views: Sequence[View], steps: int, suspicion: str | None
) -> tuple[str, ...]:
    """The ``warnings`` of a result that lacks them; ``steps`` : how many were asked for; ``suspicion`` : of the input."""
    messages = []
    reason = why_unmoved(result)
    unjudged = "" if result.verdict else ": the result is not judged"
    if reason and not refused(result):
        what = "nothing to do" if result.stop_reason == "nothing_to_do" else "nothing moved"
        messages.append(f"{what}: {reason}; the cloud is as it was")
    elif result.stop_reason == "interrupted":
        best = "start" if reason else "best so far"
        messages.append(f"interrupted at step {result.steps} of {steps}: the result is the {best}")
    elif result.stop_reason == "out_of_time":
        messages.append(f"the budget ended after {result.steps} of {steps} steps{unjudged}")
    elif result.symmetry_outcome == "unchecked":
        messages.append(f"the budget left no time for the symmetry check{unjudged}")
    elif result.stop_reason == "non_finite":
        messages.append(
            f"the loss was no number after step {result.steps}: the result is the best before that"
        )
    elif not reason and result.moved_max < SMALL_DISPLACEMENT:
        messages.append(
            f"hardly anything moved: no point by more than {100.0 * SMALL_DISPLACEMENT:g} % of the object's size"
        )
    if result.verdict == "doubtful":
        # A suspected mistake makes it doubtful whatever the confidence.
        sure = (
            f" (confidence {shown(result.confidence)})"
            if result.confidence is not None and not suspicion
            else ""
        )
        taken = ", so the cloud is left as it was" if refused(result) else ""
        if 0.0 < result.step_taken < 1.0:
            taken = f", so only {100.0 * result.step_taken:.0f} % of the step is taken"
        messages.append(f"the result is doubtful{sure}{taken}: {result.reason}")
    elif suspicion:
        messages.append(suspicion)
    messages += outlier_warnings(int(result.outliers.sum()))
    for view in views:
        messages += mask_doubts(view, result.moving)
    messages += [
        f"{view.name}: the other views contradict it, so it counts for little (inlier weight {weight:.2f} of 1); is its "
        "mask or camera wrong?"
        for view, weight in zip(views, result.inlier_weights, strict=True)
        if weight < DOUBTFUL_INLIER_WEIGHT
    ]
    return tuple(messages)
