"""Whether a result can be trusted: the features of a refinement, and the confidence they leave.

A rising IoU is no proof: where camera or mask are wrong it rises while the cloud gets worse. How
the points moved says more. A wrong camera moves them as one body; a wrong mask moves them far.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..geometry.arrays import Array
from ..optimisation.loop import Optimised
from ..optimisation.problem import Problem
from .examine import Diagnosis
from .findings import ASSUMED_CAMERA

Verdict = Literal["improved", "unchanged", "doubtful"]

MODEL = Path(__file__).with_name("confidence.json")
# A result with less confidence is doubtful. Both limits were chosen on 1,340 scenes of training
# shapes (`tso lab confidence`), each rated by a fit without its shape. In trouble, with a start of
# another shape, 12 % would get worse without a word at 0.5, 8 % at 0.8, and 4 % at 0.9. Of right
# scenes 4 % are doubtful at 0.5, nearly all for a finding, 12 % at 0.8, and 27 % at 0.9.
LEAST_CONFIDENCE = 0.8
# With less confidence nothing moves. Up to 0.6 this limit costs no right scene its gain; 0.7 costs
# 2 % of them, and 0.8 costs 8 %. With half of the scenes right, the mean log ratio of Chamfer
# distances after / before is -0.63 at 0.3, -0.64 from 0.5 to 0.7, and -0.61 at 0.8. In trouble the
# lowest of the best limits withholds the fewest gains.
LEAST_TO_MOVE = 0.5
# A wrong camera gives the same picture as a cloud that is out of place. So where a cloud moved as
# one, and where nobody gave the camera, a result is at most on the verge of doubt.
MOST_IF_CAMERA_COUNTS = LEAST_CONFIDENCE
# A start with this IoU is probably right already: nine in ten validation clouds of other shapes
# have less. A fall says that it gets worse.
FITS_ALREADY = 0.85
# The confidence of kinds of refinement that the model was not fitted to: the paper's preset and
# photos. Of starts of another shape and right input 98 to 100 % do not get worse by over
# 5 % (`tso lab accuracy`, `tso lab evidence`), of wrong input about half. Four in five are right.
WITHOUT_FEATURES = 0.85
UNSURE = ("unsure-camera", "unsure-place")
"""The notes that say that a pose found in all directions is unsure."""
# The most confidence with one of them: half of these cameras are off by over 15 degrees
# (`tso lab pose`).
MOST_IF_UNSURE = 0.5
# With less IoU, before or after, a cloud hardly touches its mask, and nothing is sure.
LEAST_OVERLAP = 0.1
# With less IoU before, a camera that nobody gave is probably not the right one: of validation
# clouds of other shapes, seen by their own camera, 95 % fit better.
LEAST_IF_ASSUMED = 0.33
# What is said if the features of a group lower the confidence most.
REASONS = {
    "camera": "the points moved as one body, as a wrong camera would move them; is the camera "
    "right?",
    "motion": "the points moved far, or without their neighbours",
    "prior": "the learned prior is unsure of this object",
    "start": "the cloud fitted its masks before, so there was little to gain",
    "misfit": "the cloud does not fit the mask afterwards",
}
FINDING = "finding"
"""The reason of a result that is doubtful because of a suspicious finding."""
# Added to a value, or to a share of contours, before its logarithm is taken.
SMALLEST, LEAST_MISSED = 1e-3, 1e-2
# A standardised feature beyond this is clipped.
MOST_DEVIATIONS = 4.0


@dataclass(frozen=True)
class Trust:
    """What to think of a result.

    verdict : "improved"; "unchanged" where the start is best; "doubtful" where the result may well
        be worse, or the input is suspicious; None if there is no confidence.
    confidence : probability that the displacement does not make the cloud worse by over 5 %
        in Chamfer distance, in [0, 1]; None if it is not known.
    reason : "finding", a group of features (`REASONS`), "unsure-camera", "unsure-place", "overlap"
        or "assumed-camera" if doubtful; else why there is no confidence.
    says : the reason in words; "" if there is none.
    moves : whether the displacement of the shape is taken without `accept_doubtful`. False also
        where the start is best, or where the cloud only moved as one.
    features : what the confidence is computed from.
    """

    verdict: Verdict | None
    confidence: float | None
    reason: str = ""
    says: str = ""
    moves: bool = True
    features: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(
        cls, features: dict[str, float] | None, diagnosis: Diagnosis, explained: bool | None = None
    ) -> Trust:
        """Of a result with ``features``, of an input with this ``diagnosis``.

        features : None for a kind of refinement that the model was not fitted to.
        explained : whether a move as one, before the shape was refined, explains why the cloud did
            not fit; None if nothing moved.
        """
        confidence, group = MOST_IF_UNSURE if diagnosis.suspicious else WITHOUT_FEATURES, ""
        if features:
            confidence, group = confidence_of(features)
        if explained:
            # What the place gained is more than what a shape that fits already could lose.
            confidence = 1.0
        most = 1.0 if explained is None else MOST_IF_CAMERA_COUNTS
        confidence = min(confidence, most, diagnosis.most_confidence)
        moves = confidence >= LEAST_TO_MOVE
        if diagnosis.suspicious:
            # What is wrong with a few views is limited by the others.
            moves = moves and diagnosis.outvoted
            trust = cls("doubtful", confidence, FINDING, words_of(diagnosis), moves)
        elif confidence < LEAST_CONFIDENCE:
            trust = cls("doubtful", confidence, group, REASONS.get(group, ""), moves)
        else:
            trust = cls("improved", confidence)
        return replace(trust, features=features or {})

    @classmethod
    def unchanged(cls, diagnosis: Diagnosis) -> Trust:
        """Of a result that is the start."""
        if diagnosis.suspicious:
            return cls("doubtful", None, FINDING, words_of(diagnosis), False)
        return cls("unchanged", 1.0, moves=False)

    @classmethod
    def placed(cls, explains: bool, diagnosis: Diagnosis) -> Trust:
        """Of a cloud that moved as one and kept its shape.

        explains : whether the move explains why the cloud did not fit.
        """
        if diagnosis.suspicious:
            return cls("doubtful", None, FINDING, words_of(diagnosis), False)
        if not explains:
            says = "only a move that explains the misfit has a confidence"
            return cls(None, None, "move", says, False)
        return cls("improved", MOST_IF_CAMERA_COUNTS, moves=False)

    @classmethod
    def unknown(cls, reason: str, says: str, diagnosis: Diagnosis) -> Trust:
        """Of a result without a confidence, for a ``reason``."""
        if diagnosis.suspicious:
            return cls("doubtful", None, FINDING, words_of(diagnosis), False)
        return cls(None, None, reason, says)

    def limited(
        self, diagnosis: Diagnosis, before: float, after: float, given: float | None = None
    ) -> Trust:
        """The same, with less confidence if a pose is unsure, or the IoU is low or fell.

        ``before`` and ``after`` are the mean IoU of the views, before and after the shape was
        refined. ``given`` is that of the cloud as it was given, if it moved as one before.
        """
        notes = {one.name: one for one in diagnosis.notes}
        if unsure := next((notes[name] for name in UNSURE if name in notes), None):
            return self._unsure(unsure.name, unsure.says)
        if (least := min(before, after)) < LEAST_OVERLAP:
            return self._unsure("overlap", f"cloud and mask hardly overlap (IoU {least:.2f})")
        if ASSUMED_CAMERA in notes and before < LEAST_IF_ASSUMED:
            return self._unsure(ASSUMED_CAMERA, notes[ASSUMED_CAMERA].says)
        given = before if given is None else given
        if after < given and given >= FITS_ALREADY and self.confidence:
            return self._unsure("misfit", "the cloud fitted its mask, and fits it less afterwards")
        if ASSUMED_CAMERA in notes and self.confidence:
            return replace(self, confidence=min(self.confidence, MOST_IF_CAMERA_COUNTS))
        return self

    def _unsure(self, reason: str, says: str) -> Trust:
        confidence = self.confidence and min(self.confidence, MOST_IF_UNSURE)
        changed = replace(self, verdict="doubtful", confidence=confidence, moves=False)
        if self.reason == FINDING:
            return changed
        return replace(changed, reason=reason, says=says)


def words_of(diagnosis: Diagnosis) -> str:
    """What looks wrong, in words."""
    joined = " or ".join if diagnosis.of_input else "; ".join
    return f"it looks as if {joined(finding.says for finding in diagnosis.suspicious)}"


def features_of(
    problem: Problem,
    optimised: Optimised,
    diagnosis: Diagnosis,
    contours: tuple[float, float],
) -> dict[str, float]:
    """What the confidence is computed from, named GROUP: FEATURE.

    ``contours`` has the shares of the contours that the cloud misses, before and after. Without an
    answer of the learned prior its sureness is left out.
    """
    contours_before, contours_after = contours
    start, best = problem.cloud.start, optimised.best
    begun = optimised.begun
    assert begun is not None, "a confidence is of the default preset"
    moved, cameras = best - start, [windowed.resampled.camera for windowed in problem.given]
    across = np.concatenate([(moved @ camera.R.T)[:, :2] for camera in cameras])
    of_prior = {} if begun.sureness is None else {"prior: sureness": begun.sureness}
    return {
        "motion: across": _log(_root_mean_square(across)),
        "camera: not similar": _not_similar(start, best),
        "motion: shift": _log(float(np.linalg.norm(moved.mean(0)))),
        **of_prior,
        "input: findings": 0.0 if diagnosis.outvoted else float(len(diagnosis.suspicious)),
        "start: contours": float(np.log(contours_before + LEAST_MISSED)),
        "misfit: contours": contours_after**2,
    }


def _root_mean_square(vectors: Array) -> float:
    return float(np.sqrt(np.square(vectors).sum(1).mean()))


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
