"""The confidence in a result: the features of a refinement, and a model of how they end.

A rising IoU is no proof: where camera or mask are wrong it rises while the cloud gets worse. How
the points moved says more. A wrong camera moves them as one body; a wrong mask moves them far.
"""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np

from ..geometry.arrays import Array
from ..geometry.points import root_mean_square
from ..optimisation.learned_start import Beginning
from ..optimisation.problem import Problem
from .examine import Diagnosis

MODEL = Path(__file__).with_name("confidence.json")
# What is said if the features of a group lower the confidence most.
REASONS = {
    "camera": "the points moved as one body, as a wrong camera would move them; is the camera "
    "right?",
    "motion": "the points moved far, or without their neighbours",
    "prior": "the learned prior is unsure of this object",
    "start": "from starts like this, more results get worse",
    "misfit": "the cloud would not fit the masks afterwards either",
}
# Added to a value, or to a share of contours, before its logarithm is taken.
SMALLEST, LEAST_MISSED = 1e-3, 1e-2
# A standardised feature beyond this is clipped.
MOST_DEVIATIONS = 4.0


def features_of(
    problem: Problem,
    displacements: Array,
    begun: Beginning | None,
    diagnosis: Diagnosis,
    contours: tuple[float, float],
) -> dict[str, float]:
    """What the confidence is computed from, named GROUP: FEATURE.

    displacements : [N, 3], of the control points. begun : where they began, None without the prior.
    contours : shares of the contours that the cloud misses, before and after. Without an answer of
    the learned prior its sureness is left out.
    """
    contours_before, contours_after = contours
    start, moved = problem.cloud.start, displacements
    cameras = [windowed.resampled.camera for windowed in problem.given]
    across = np.concatenate([(moved @ camera.R.T)[:, :2] for camera in cameras])
    of_prior = {}
    if begun is not None and begun.sureness is not None:
        of_prior["prior: sureness"] = begun.sureness
    return {
        "motion: across": _log(root_mean_square(across)),
        "camera: not similar": _not_similar(start, start + moved),
        "motion: shift": _log(float(np.linalg.norm(moved.mean(0)))),
        **of_prior,
        "input: findings": 0.0 if diagnosis.outvoted else float(len(diagnosis.suspicious)),
        "input: views": float(np.log(len(problem.given))),
        "start: contours": float(np.log(contours_before + LEAST_MISSED)),
        "misfit: contours": contours_after**2,
    }


def _not_similar(start: Array, best: Array) -> float:
    """The share of the motion that no similarity explains."""
    x, y = start - start.mean(0), best - best.mean(0)
    u, s, v = np.linalg.svd(x.T @ y)
    handedness = np.sign(np.linalg.det(u @ v))
    s[2], u[:, 2] = handedness * s[2], handedness * u[:, 2]
    left = y - float(s.sum() / np.square(x).sum()) * x @ (u @ v)
    return float(np.square(left).sum() / (np.square(best - start).sum() + 1e-12))


def _log(value: Any) -> float:
    return float(np.log(value + SMALLEST))


@functools.cache
def _model() -> tuple[float, dict[str, tuple[float, float, float]]]:
    """The offset, and of each feature: mean, deviation, and what a deviation adds to the logit."""
    document = json.loads(MODEL.read_text())
    return document["offset"], document["features"]


def confidence_of(features: dict[str, float]) -> tuple[float, str]:
    """The confidence, and the group of features that lowers it most.

    A logistic regression. Features that are not known count as average.
    """
    doubt, terms = _model()
    by_group = dict.fromkeys(REASONS, 0.0)
    for name, (mean, deviation, slope) in terms.items():
        standard = (features.get(name, mean) - mean) / deviation
        term = slope * float(np.clip(standard, -MOST_DEVIATIONS, MOST_DEVIATIONS))
        doubt += term
        # A finding is a reason of its own.
        if (group := name.split(":")[0]) in by_group:
            by_group[group] += term
    # Rounded down, as it is printed: what is printed as 0.80 is not doubtful.
    confidence = np.floor(1e4 / (1.0 + np.exp(doubt))) / 1e4
    return float(confidence), max(by_group, key=by_group.__getitem__)
