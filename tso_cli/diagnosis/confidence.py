"""Whether a result can be trusted: signs of a refinement that went wrong, and the confidence that they leave.

IoU is no sign: where camera or mask are wrong it rises while the cloud gets worse. How the points moved is one: a camera that
is off moves them as one body, a wrong mask moves them far, or otherwise from stage to stage.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..cloud.smooth_field import SmoothField
from ..geometry.camera import Camera
from ..losses.projection import pixels_under, project
from ..optimisation.loop import Descent
from ..optimisation.objective import MaskChamferObjective, ViewTargets
from ..optimisation.presets import STAGES
from ..optimisation.prior import ROBUST_SCALE
from ..optimisation.problem import Problem
from .agreement import Agreement
from .placement import place

Array = NDArray[np.float64]
Name = Literal["improved", "unchanged", "doubtful"]

MODEL = Path(__file__).with_name("confidence.json")
# A result of less confidence is doubtful.
LEAST_CONFIDENCE = 0.5
# Where silhouettes show a common mistake, no step up to the first confidence is taken, and a part of it up to the second. Where
# descents alone tell of it the start may as well be another shape, which gains by the whole step. Where few of the views are
# suspected the others lead, so that less confidence is enough. Both as validation shapes say.
# Elsewhere doubt is not enough: a cloud far off its mask looks as a wrong camera does, and so does a box that was stretched.
SUSPECT_STEP, OUTVOTED_STEP = (0.7, 0.8), (0.1, 0.3)
# What is said where signs of this group took most of the confidence.
REASONS = {
    "camera": "the points moved as one body, as a camera that is off would move them; is the camera right? (--refine-camera)",
    "motion": "the points moved far, or without their neighbours",
    "stages": "the coarse and the fine stages of the descent disagree",
    "misfit": "cloud and mask agree too little, before or after",
    "input": "the silhouettes differ in a way that another camera or mask might explain",
    "symmetry": "the mask and its mirror image contradict each other more than a right camera lets them",
    "views": "the views contradict each other",
}
# Added to what is taken the logarithm of.
SMALLEST = 1e-3
# Of a field without which motion is rough: that of the last stage, whose factors are there.
SMOOTHNESS = STAGES[-1].smoothness


@dataclass(frozen=True)
class Verdict:
    """What to think of a result.

    name : "unchanged" where the start is best; "doubtful" where it may well be worse, or a mistake in the input is
        suspected; "improved"; None if not judged.
    confidence : that it is not worse by over 5 %, in [0, 1]; None if not judged. reason : why it is doubtful, or not judged.
    step : share of it that should be taken.
    """

    name: Name | None
    confidence: float | None
    reason: str = ""
    step: float = 1.0

    @classmethod
    def of(cls, signs: dict[str, float], agreement: Agreement) -> Verdict:
        """Of a refinement with ``signs``, of input that agrees so."""
        confidence, group = _judged(signs)
        confidence, suspicion = min(confidence, agreement.most_confidence), agreement.suspicion
        if confidence < LEAST_CONFIDENCE or suspicion:
            between = OUTVOTED_STEP if agreement.outvoted else SUSPECT_STEP
            step = (
                float(np.interp(confidence, between, (0.0, 1.0)))
                if suspicion and not agreement.confirmed
                else 1.0
            )
            return cls("doubtful", confidence, suspicion or REASONS[group], step)
        return cls("improved", confidence)

    @classmethod
    def unchanged(cls, suspicion: str | None) -> Verdict:
        """Of a result that is the start."""
        return cls("doubtful" if suspicion else "unchanged", 1.0, suspicion or "", 0.0)


UNJUDGED = Verdict(None, None)


def shown(confidence: float) -> str:
    """With two places, rounded down: what is shown as 0.50 is not doubtful."""
    return f"{confidence:.4f}"[:4]


def signs_of(
    problem: Problem,
    field: SmoothField,
    descent: Descent,
    ious: list[tuple[float, float]],
    inlier: list[float],
) -> dict[str, float]:
    """What the confidence depends on, named GROUP: SIGN.

    ``problem`` has its last windows; ``field`` is of the start; ``ious`` and ``inlier`` weights are of the views.
    """
    initial, refined, stages = problem.cloud.normalised(), descent.best, descent.stages
    moved = refined - initial
    lengths = np.linalg.norm(moved, axis=1)
    signs = {"motion: mean": _log(lengths.mean()), "motion: most": _log(lengths.max())}
    camera = problem.resampled[0].camera
    axes = np.sqrt(np.square(moved @ camera.R.T).mean(0))
    signs |= {"motion: along": _log(axes[2]), "motion: across": _log(float(np.hypot(*axes[:2])))}
    of_nodes = moved[field.nodes]
    rough = np.square(of_nodes - field.smoothed(of_nodes, SMOOTHNESS)).sum() / (
        np.square(of_nodes).sum() + 1e-12
    )
    signs |= {"motion: rough": float(rough), **_explained(initial, refined)}
    for i, j in ((0, 1), (0, 2), (1, 2)):
        signs[f"stages: {i + 1} to {j + 1}"] = _log(
            np.sqrt(np.square(stages[j] - stages[i]).sum(1).mean())
        )

    views = len(problem.views)
    targets = ViewTargets.of(problem.resampled[:views], [1.0 / views] * views)
    objective = MaskChamferObjective(targets, ROBUST_SCALE)
    for name, points in (("before", initial), ("after", refined)):
        signs[f"misfit: {name}"] = _log(objective(points)[0] / targets.pixels)
        beside = [_beside(points, view.camera, view.mask.inside) for view in targets.views]
        signs[f"misfit: beside {name}"] = float(np.mean(beside))
    signs["misfit: IoU before"], signs["misfit: IoU after"] = np.mean(ious, 0).tolist()

    assert problem.agreement is not None
    # In the cells that the cloud was compared with: there an object in a large picture looks like one in a small.
    inside = targets.views[0].mask.inside
    border = np.count_nonzero(inside[1:] != inside[:-1]) + np.count_nonzero(
        inside[:, 1:] != inside[:, :-1]
    )
    signs |= {
        "input: IoU of boxes": float(
            np.mean([place(problem.cloud.initial, view).box_iou for view in problem.views])
        ),
        "input: IoU of cells": problem.agreement.as_given,
        "input: IoU of cells as assumed": problem.agreement.best,
        "input: suspects": float(len(problem.agreement.named)),
        "input: border": _log(border / np.sqrt(np.count_nonzero(inside))),
        "input: pixels": _log(np.count_nonzero(inside)),
        "input: truncated": float(targets.truncated),
        "symmetry: used": float(problem.symmetry.plane is not None),
        "symmetry: contradicted": float(problem.symmetry.outcome == "contradicted"),
        "symmetry: loss ratio": min(problem.symmetry.loss_ratio or 1.0, 5.0),
        "views: number": _log(views),
        "views: inlier weight": min(inlier),
    }
    return signs


def _explained(initial: Array, refined: Array) -> dict[str, float]:
    """Shares of the motion that no rigid, similar, or affine map explains, and the parts of the rigid one."""
    x, y = initial - initial.mean(0), refined - refined.mean(0)
    u, s, v = np.linalg.svd(x.T @ y)
    handedness = np.sign(np.linalg.det(u @ v))
    s[2], u[:, 2] = handedness * s[2], handedness * u[:, 2]
    turn, scale = u @ v, float(s.sum() / np.square(x).sum())
    affine = np.linalg.lstsq(x, y, rcond=None)[0]
    total = np.square(refined - initial).sum() + 1e-12
    left = {"rigid": x @ turn, "similar": scale * x @ turn, "affine": x @ affine}
    return {
        **{
            f"camera: not {name}": float(np.square(y - mapped).sum() / total)
            for name, mapped in left.items()
        },
        "camera: turn": _log(
            np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
        ),
        "camera: scale": _log(abs(np.log(max(scale, SMALLEST)))),
        "camera: shift": _log(float(np.linalg.norm((refined - initial).mean(0)))),
    }


def _beside(points: Array, camera: Camera, inside: NDArray[np.bool_]) -> float:
    """Share of the points that do not fall on ``inside`` [H, W]."""
    projected = project(points, camera)
    pixel, within = pixels_under(projected.points_px, projected.valid, *inside.shape)
    return 1.0 - np.count_nonzero(within & inside.ravel()[pixel]) / len(points)


def _log(value: Any) -> float:
    return float(np.log(value + SMALLEST))


@functools.cache
def _model() -> tuple[list[str], tuple[Array, ...]]:
    document = json.loads(MODEL.read_text())
    return document["signs"], tuple(
        np.array(document[name]) for name in ("mean", "deviation", "hidden", "offset", "output")
    )


def _judged(signs: dict[str, float]) -> tuple[float, str]:
    """The confidence, and the group of signs that takes most of it: without them (at their means) it would be highest."""
    names, (mean, deviation, hidden, offset, output) = _model()
    standard = np.clip((np.array([signs[name] for name in names]) - mean) / deviation, -4.0, 4.0)
    groups = np.array([name.split(":")[0] for name in names])
    rows = np.stack([standard, *(np.where(groups == group, 0.0, standard) for group in REASONS)])
    doubt = np.tanh(rows @ hidden + offset) @ output[:-1] + output[-1]
    # Rounded down, as it is shown.
    confidence = np.floor(1e4 / (1.0 + np.exp(doubt[0]))) / 1e4
    return float(confidence), list(REASONS)[int(doubt[1:].argmin())]
