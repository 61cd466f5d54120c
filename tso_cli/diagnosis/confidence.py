"""Whether a result can be trusted: the features of a refinement, and the confidence they leave.

A rising IoU is no proof: where camera or mask are wrong it rises while the cloud gets worse. How
the points moved says more. A wrong camera moves them as one body; a wrong mask moves them far.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..cloud.smooth_field import SmoothField
from ..geometry.arrays import Array, Bits
from ..geometry.camera import Camera
from ..losses.projection import pixels_under, project_differentiably
from ..optimisation.learned_start import Beginning
from ..optimisation.loop import Optimised
from ..optimisation.objective import MaskChamferObjective
from ..optimisation.position_prior import START_ROBUST_SCALE
from ..optimisation.presets import BEST
from ..optimisation.problem import Problem
from .examine import Diagnosis
from .placement import place

Verdict = Literal["improved", "unchanged", "doubtful"]

MODEL = Path(__file__).with_name("confidence.json")
# A result with less confidence is doubtful.
LEAST_CONFIDENCE = 0.5
# With less confidence nothing moves. Of four right scenes and one wrong one, validation shapes that
# the model had not seen, the mean log ratio of Chamfer distances after / before is lowest at 0.15:
# -0.536, and -0.507 where everything moves. Right scenes alone lose 0.007 of 0.655 by it.
LEAST_TAKEN = 0.15

UNSURE = ("unsure-camera", "unsure-place")
"""The notes that say that a pose found in all directions is unsure."""
# The most confidence with one of them: half of these cameras are off by over 15 degrees
# (`tso lab pose`).
MOST_CONFIDENCE_IF_UNSURE = 0.49
# With less IoU, before or after, a cloud hardly touches its mask, and nothing is sure.
LEAST_OVERLAP = 0.1
# What is said if the features of a group lower the confidence most.
REASONS = {
    "camera": "the points moved as one body, as a wrong camera would move them; is the camera "
    "right?",
    "motion": "the points moved far, or without their neighbours",
    "prior": "the learned prior is unsure of this object",
    "misfit": "cloud and mask agree too little, before or after",
    "input": "the silhouettes differ in a way that another camera or mask might explain",
    "symmetry": "the mask and its mirror image contradict each other more than a right camera "
    "lets them",
    "views": "the views contradict each other",
}
FINDING = "finding"
"""The reason of a result that is doubtful because of a suspicious finding."""
# Of 150 validation clouds that stood wrong and were moved by the default, 145 did not get worse by
# over 5 %. The confidence is lower: rendered scenes are cleaner than photos.
CONFIDENCE_OF_A_MOVE = 0.9
# Added to a value before its logarithm is taken.
SMALLEST = 1e-3
# Motion is rough if a field of this smoothness does not have it. The optimisation has its factors.
SMOOTHNESS = BEST.smoothness
# A standardised feature beyond this is clipped, and so is a ratio of losses.
MOST_DEVIATIONS, MOST_LOSS_RATIO = 4.0, 5.0


@dataclass(frozen=True)
class Trust:
    """What to think of a result.

    verdict : "improved"; "unchanged" where the start is best; "doubtful" where the result may well
        be worse, or the input is suspicious; None if there is no confidence.
    confidence : probability that the whole displacement does not make the cloud worse by over 5 %
        in Chamfer distance, in [0, 1]; None if it is not known.
    reason : "finding", a group of features (`REASONS`), "unsure-camera" or "unsure-place" if
        doubtful; else why there is no confidence.
    says : the reason in words; "" if there is none.
    displacement_taken : 1 if the displacement is taken, 0 if nothing moves.
    features : what the confidence is computed from.
    """

    verdict: Verdict | None
    confidence: float | None
    reason: str = ""
    says: str = ""
    displacement_taken: float = 1.0
    features: dict[str, float] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(
        cls, features: dict[str, float], diagnosis: Diagnosis, explained: bool | None = None
    ) -> Trust:
        """Of a result with ``features``, of an input with this ``diagnosis``.

        explained : whether a move as one, before the shape was refined, explains why the cloud did
            not fit; None if nothing moved.
        """
        confidence, group = confidence_of(features)
        if explained:
            # What the place gained is more than what a shape that fits already could lose.
            confidence = 1.0
        if explained is not None:
            confidence *= CONFIDENCE_OF_A_MOVE
        confidence = min(confidence, diagnosis.most_confidence)
        if diagnosis.suspicious:
            # What is wrong with a few views is limited by the others.
            taken = float(diagnosis.outvoted and confidence >= LEAST_CONFIDENCE)
            return cls("doubtful", confidence, FINDING, words_of(diagnosis), taken, features)
        if confidence < LEAST_CONFIDENCE:
            taken = float(confidence >= LEAST_TAKEN)
            return cls("doubtful", confidence, group, REASONS[group], taken, features)
        return cls("improved", confidence, features=features)

    @classmethod
    def unchanged(cls, diagnosis: Diagnosis) -> Trust:
        """Of a result that is the start."""
        if diagnosis.suspicious:
            return cls("doubtful", 1.0, FINDING, words_of(diagnosis), 0.0)
        return cls("unchanged", 1.0, displacement_taken=0.0)

    @classmethod
    def placed(cls, explains: bool, diagnosis: Diagnosis) -> Trust:
        """Of a cloud that moved as one and kept its shape.

        explains : whether the move explains why the cloud did not fit.
        """
        if diagnosis.suspicious:
            return cls("doubtful", 1.0, FINDING, words_of(diagnosis), 0.0)
        if not explains:
            says = "only a move that explains the misfit has a confidence"
            return cls(None, None, "move", says, 0.0)
        return cls("improved", CONFIDENCE_OF_A_MOVE, displacement_taken=0.0)

    @classmethod
    def unknown(cls, reason: str, says: str, diagnosis: Diagnosis) -> Trust:
        """Of a result without a confidence, for a ``reason``."""
        if diagnosis.suspicious:
            return cls("doubtful", None, FINDING, words_of(diagnosis), 0.0)
        return cls(None, None, reason, says)

    def with_pose(self, diagnosis: Diagnosis) -> Trust:
        """The same, with less confidence if the fitted camera or the place found is unsure."""
        unsure = next((one for one in diagnosis.notes if one.name in UNSURE), None)
        return self._unsure(unsure.name, unsure.says) if unsure else self

    def with_overlap(self, iou: float) -> Trust:
        """The same, doubtful if the lower ``iou`` of before and after shows no overlap."""
        if iou >= LEAST_OVERLAP:
            return self
        return self._unsure("overlap", f"cloud and mask hardly overlap (IoU {iou:.2f})")

    def _unsure(self, reason: str, says: str) -> Trust:
        confidence = self.confidence and min(self.confidence, MOST_CONFIDENCE_IF_UNSURE)
        changed = dataclasses.replace(self, verdict="doubtful", confidence=confidence)
        if self.reason == FINDING:
            return changed
        return dataclasses.replace(changed, reason=reason, says=says)


def words_of(diagnosis: Diagnosis) -> str:
    """What looks wrong, in words."""
    joined = " or ".join if len(diagnosis.suspicious[0].views) > 1 else "; ".join
    return f"it looks as if {joined(finding.says for finding in diagnosis.suspicious)}"


def features_of(
    problem: Problem,
    field: SmoothField,
    optimised: Optimised,
    ious: Sequence[tuple[float, float]],
    inlier_weights: Sequence[float],
    diagnosis: Diagnosis,
) -> dict[str, float]:
    """What the confidence is computed from, named GROUP: FEATURE.

    ``problem`` has the windows of the optimisation; ``field`` is of the start. ``ious`` [V] before
    and after, and ``inlier_weights`` [V], are of the given views.
    """
    start, best = problem.cloud.start, optimised.best
    begun = optimised.begun
    assert begun is not None, "a confidence is of a displacement field"
    views = len(problem.given)
    truncated = all(windowed.resampled.target.truncated for windowed in problem.given)
    return {
        **_motion(problem, field, start, best),
        **_rigidity(start, best),
        **_of_prior(start, begun),
        "motion: after the prior": _log(_apart(begun.points, best)),
        **_misfit(problem, start, best, ious),
        **_input(problem, diagnosis),
        "input: truncated": float(truncated),
        "symmetry: used": float(problem.symmetry.plane is not None),
        "symmetry: contradicted": float(problem.symmetry.outcome == "contradicted"),
        "symmetry: loss ratio": _loss_ratio(problem),
        "views: number": _log(views),
        "views: inlier weight": min(inlier_weights),
    }


def _of_prior(start: Array, begun: Beginning) -> dict[str, float]:
    """What the learned prior said of the start; nothing where it gave no answer."""
    if begun.asked is None or begun.sureness is None:
        return {}
    return {
        "motion: by the prior": _log(_apart(start, begun.points)),
        "prior: asked": _log(begun.asked),
        "prior: sureness": begun.sureness,
    }


def _motion(problem: Problem, field: SmoothField, start: Array, best: Array) -> dict[str, float]:
    moved = best - start
    lengths = np.linalg.norm(moved, axis=1)
    camera = problem.given[0].resampled.camera
    axes = np.sqrt(np.square(moved @ camera.R.T).mean(0))
    of_nodes = moved[field.nodes]
    unsmooth = np.square(of_nodes - field.smoothed(of_nodes, SMOOTHNESS)).sum()
    return {
        "motion: mean": _log(lengths.mean()),
        "motion: most": _log(lengths.max()),
        "motion: along": _log(axes[2]),
        "motion: across": _log(float(np.hypot(*axes[:2]))),
        "motion: rough": float(unsmooth / (np.square(of_nodes).sum() + 1e-12)),
    }


def _rigidity(start: Array, best: Array) -> dict[str, float]:
    """Shares of the motion that no rigid, similar or affine map explains, and the rigid map."""
    x, y = start - start.mean(0), best - best.mean(0)
    u, s, v = np.linalg.svd(x.T @ y)
    handedness = np.sign(np.linalg.det(u @ v))
    s[2], u[:, 2] = handedness * s[2], handedness * u[:, 2]
    turn, scale = u @ v, float(s.sum() / np.square(x).sum())
    affine = np.linalg.lstsq(x, y, rcond=None)[0]
    total = np.square(best - start).sum() + 1e-12
    mapped = {"rigid": x @ turn, "similar": scale * x @ turn, "affine": x @ affine}
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
    return {
        **{
            f"camera: not {name}": float(np.square(y - image).sum() / total)
            for name, image in mapped.items()
        },
        "camera: turn": _log(angle),
        "camera: scale": _log(abs(np.log(max(scale, SMALLEST)))),
        "camera: shift": _log(float(np.linalg.norm((best - start).mean(0)))),
    }


def _apart(one: Array, other: Array) -> float:
    """The root mean square distance of the points of two clouds [N, 3]."""
    return float(np.sqrt(np.square(other - one).sum(1).mean()))


def _misfit(
    problem: Problem, start: Array, best: Array, ious: Sequence[tuple[float, float]]
) -> dict[str, float]:
    """Of the given views, equally weighted."""
    views = len(problem.given)
    targets = problem.without_flipped().targets([1.0 / views] * views)
    objective = MaskChamferObjective(targets, START_ROBUST_SCALE)
    features = {}
    for name, points in (("before", start), ("after", best)):
        features[f"misfit: {name}"] = _log(objective(points)[0] / targets.pixels)
        outside = [_outside(points, view.camera, view.mask.inside) for view in targets.views]
        features[f"misfit: outside {name}"] = float(np.mean(outside))
    before, after = np.mean(ious, 0).tolist()
    return {**features, "misfit: IoU before": before, "misfit: IoU after": after}


def _outside(points: Array, camera: Camera, inside: Bits) -> float:
    """The share of the points that do not fall on ``inside`` [H, W]."""
    projected = project_differentiably(points, camera)
    pixel, within = pixels_under(projected.points_px, projected.valid, *inside.shape)
    return 1.0 - np.count_nonzero(within & inside.ravel()[pixel]) / len(points)


def _input(problem: Problem, diagnosis: Diagnosis) -> dict[str, float]:
    explanation = diagnosis.explanation
    assert explanation is not None
    # In the cells that the cloud was compared with: an object in a large picture looks like an
    # object in a small one there.
    inside = problem.given[0].resampled.target.inside
    down = np.count_nonzero(inside[1:] != inside[:-1])
    border = down + np.count_nonzero(inside[:, 1:] != inside[:, :-1])
    boxes = [place(problem.cloud.control_points, view).box_iou for view in problem.views]
    return {
        "input: IoU of boxes": float(np.mean(boxes)),
        "input: IoU of cells": explanation.as_given,
        "input: IoU of cells explained": explanation.best,
        "input: findings": float(len(diagnosis.suspicious)),
        "input: border": _log(border / np.sqrt(np.count_nonzero(inside))),
        "input: pixels": _log(np.count_nonzero(inside)),
    }


def _loss_ratio(problem: Problem) -> float:
    check = problem.symmetry.check
    return min(check.loss_ratio or 1.0, MOST_LOSS_RATIO) if check else 1.0


def _log(value: Any) -> float:
    return float(np.log(value + SMALLEST))


@functools.cache
def _model() -> tuple[list[str], tuple[Array, ...]]:
    document = json.loads(MODEL.read_text())
    parts = ("mean", "deviation", "hidden", "offset", "output")
    return document["features"], tuple(np.array(document[name]) for name in parts)


def confidence_of(features: dict[str, float]) -> tuple[float, str]:
    """The confidence, and the group of features that lowers it most.

    Without the features of that group (at their means) the confidence would be highest. Features
    that are not known are at their means too.
    """
    names, (mean, deviation, hidden, offset, output) = _model()
    values = [features.get(name, of_mean) for name, of_mean in zip(names, mean, strict=True)]
    standard = (np.array(values) - mean) / deviation
    standard = np.clip(standard, -MOST_DEVIATIONS, MOST_DEVIATIONS)
    groups = np.array([name.split(":")[0] for name in names])
    rows = np.stack([standard, *(np.where(groups == group, 0.0, standard) for group in REASONS)])
    logits = np.tanh(rows @ hidden + offset) @ output[:-1] + output[-1]
    # Rounded down, as it is printed: what is printed as 0.50 is not doubtful.
    confidence = np.floor(1e4 / (1.0 + np.exp(logits[0]))) / 1e4
    return float(confidence), list(REASONS)[int(logits[1:].argmin())]
