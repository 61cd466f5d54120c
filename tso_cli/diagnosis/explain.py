"""Which hypothesis explains cloud, cameras and masks best, if they do not agree as given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..geometry.arrays import Array, Bits
from .cells import Outline
from .findings import Finding
from .hypotheses import HYPOTHESES, Assumption, focal_in_pixels


class Margin:
    """How much better silhouettes agree, as IoU, if a hypothesis is right."""

    FOUND = 0.16  # by this a mistake is found ...
    WEAK = 0.04  # ... and by this it is weak: short optimisations verify it
    LEAST_IOU = 0.4  # and silhouettes agree at least so far
    SIMILAR = 0.03  # hypotheses that differ by less agree about as well
    BELOW_OTHERS = 0.1  # a single view may be wrong if it is so far below the median of the others


class Pairing:
    """Views whose cameras may belong to other masks."""

    PAIRED_IOU = 0.8  # views of at least this IoU are paired rightly
    MOST_VIEWS = 64  # more mispaired views are not compared
    MARGIN_OF_TWO = 0.12  # two views have one other order, so a smaller margin is enough


# Hypotheses that are named, if they agree about as well as the best.
MOST_ALTERNATIVES = 3
# A mask of fewer cells matches too much by chance, as does a cloud that shrinks to a point.
FEWEST_CELLS = 10
# What is wrong with at most this share of the views is outvoted by the others.
OUTVOTED_SHARE = 0.5


@dataclass(frozen=True)
class Explanation:
    """How far cloud and masks agree, as mean IoU in coarse cells, and what explains it.

    as_given : of the input as it is. best : under the best hypothesis, less its prior.
    of_input : alternatives that explain the whole input, likeliest first.
    of_views : what explains single views, where the input as a whole looks right.
    weak : a hypothesis under which silhouettes agree somewhat better; None unless nothing was
        assumed and nothing is found.
    """

    as_given: float
    best: float
    of_input: tuple[Finding, ...] = ()
    of_views: tuple[Finding, ...] = ()
    weak: Finding | None = None


class Candidate(NamedTuple):
    """The given assumptions with one of them left out, or with one more."""

    assumptions: tuple[Assumption, ...]
    changed: Assumption
    without: bool

    @property
    def prior(self) -> float:
        return 0.0 if self.without else self.changed.hypothesis.prior

    def found(self, views: tuple[int, ...], score: float, before: float) -> Finding:
        """The finding that this is right."""
        without = self.changed if self.without else None
        name = self.changed.hypothesis.name
        return Finding(name, views, score, score - before, without)


def explain(
    points: Array, outlines: Sequence[Outline], given: Sequence[Assumption], boxes: Bits
) -> Explanation:
    """What explains ``points`` [N, 3] and the views; a few milliseconds a view.

    ``boxes`` [V] : which masks are bounding boxes, which show nothing of the object's shape.
    """
    not_in_pixels = not any(focal_in_pixels(outline.view.camera) for outline in outlines)
    candidates = _candidates(tuple(given), not_in_pixels)
    as_given = np.array([outline.iou(points, given) for outline in outlines])
    ious = np.array(
        [[outline.iou(points, one.assumptions) for outline in outlines] for one in candidates]
    )
    priors = np.array([candidate.prior for candidate in candidates])
    scores = ious.mean(1) - priors
    meaningful = np.array([outline.foreground_cells >= FEWEST_CELLS for outline in outlines])
    found = Explanation(float(as_given.mean()), float(scores.max()))
    if boxes.all():
        of_views = _of_views(outlines, candidates, ious, as_given, meaningful)
        return replace(found, of_views=of_views)
    everything = tuple(range(len(outlines)))
    of_input: tuple[Finding, ...] = ()
    pairs: tuple[Finding, ...] = ()
    if meaningful.any():
        of_meaningful = ious[:, meaningful].mean(1) - priors
        # A mistake in all views may look as wrong pairs do, if the object is symmetric.
        pairs = _mispaired(points, outlines, as_given, meaningful, float(of_meaningful.max()))
        if pairs and len(pairs[0].views) > OUTVOTED_SHARE * len(outlines):
            of_input = pairs
        elif not pairs:
            before = float(as_given[meaningful].mean())
            of_input = _of_input(candidates, of_meaningful, before, everything)
    if of_input:
        return replace(found, of_input=of_input)
    of_views = pairs or _of_views(outlines, candidates, ious, as_given, meaningful)
    weak = None
    if meaningful.all() and not given:
        best = int(np.argmax(scores))
        if scores[best] >= max(found.as_given + Margin.WEAK, Margin.LEAST_IOU):
            score = float(scores[best]) + candidates[best].prior
            weak = candidates[best].found(everything, score, found.as_given)
    return replace(found, of_views=of_views, weak=weak)


def _candidates(given: tuple[Assumption, ...], not_in_pixels: bool) -> list[Candidate]:
    """The given assumptions without one of them, and with one that was not given.

    ``not_in_pixels`` : whether the focal lengths, as read, cannot be in pixels.
    """
    fewer = [Candidate(tuple(o for o in given if o is not one), one, True) for one in given]
    more = [
        Assumption(hypothesis)
        for hypothesis in HYPOTHESES.values()
        if not_in_pixels or not hypothesis.unit_of_focal
    ]
    return fewer + [Candidate((*given, one), one, False) for one in more if one not in given]


def _of_input(
    candidates: Sequence[Candidate], scores: Array, before: float, views: tuple[int, ...]
) -> tuple[Finding, ...]:
    """Candidates that may be right. If leaving an assumption out explains it, none is added."""
    if scores.max() < max(before + Margin.FOUND, Margin.LEAST_IOU):
        return ()
    order = np.argsort(-scores, kind="stable")
    likely = [i for i in order if scores[i] >= scores.max() - Margin.SIMILAR]
    chosen = [i for i in likely if candidates[i].without] or likely
    return tuple(
        candidates[i].found(views, float(scores[i]) + candidates[i].prior, before)
        for i in chosen[:MOST_ALTERNATIVES]
    )


def _of_views(
    outlines: Sequence[Outline],
    candidates: Sequence[Candidate],
    ious: Array,
    as_given: Array,
    meaningful: Bits,
) -> tuple[Finding, ...]:
    """What is right for one view that disagrees with the cloud, and not for the others."""
    found = []
    for view in np.flatnonzero(meaningful).tolist():
        others = meaningful & (np.arange(len(outlines)) != view)
        # By the median, so that another bad view does not hide this one.
        if not others.any() or np.median(as_given[others]) < as_given[view] + Margin.BELOW_OTHERS:
            continue
        # Of two views either may be the wrong one, unless one shows nothing of the cloud.
        known = others.sum() > 1 or as_given[view] == 0.0
        before = as_given[others].mean()
        scores = [
            ious[k, view]
            if _fits_one_view(one, known) and ious[k, others].mean() < before + Margin.SIMILAR
            else 0.0
            for k, one in enumerate(candidates)
        ]
        best = int(np.argmax(scores))
        if scores[best] >= max(as_given[view] + Margin.FOUND, Margin.LEAST_IOU):
            score, before = float(scores[best]), float(as_given[view])
            found.append(candidates[best].found((view,), score, before))
    return tuple(found)


def _fits_one_view(candidate: Candidate, known: bool) -> bool:
    """Whether it can be said of a single view.

    The cloud is the same for all views. A mistake needs a wrong view that is ``known``, but an
    inverted mask is known by its border.
    """
    hypothesis = candidate.changed.hypothesis
    return not hypothesis.of_cloud and (known or hypothesis.mask == "inverted")


def _mispaired(
    points: Array,
    outlines: Sequence[Outline],
    as_given: Array,
    meaningful: Bits,
    otherwise: float,
) -> tuple[Finding, ...]:
    """The finding that cameras see other masks than their own, or nothing.

    The mean IoU of the best pairing must be better than the best IoU ``otherwise``.
    """
    numbers = np.flatnonzero(meaningful & (as_given < Pairing.PAIRED_IOU))
    if not 2 <= len(numbers) <= Pairing.MOST_VIEWS:
        return ()
    low = [outlines[int(i)] for i in numbers]
    # [camera, mask]
    ious = np.array([outline.ious(points, outline.given, low) for outline in low])
    margin = Pairing.MARGIN_OF_TWO if len(low) == 2 else Margin.FOUND
    if (ious.max(1) - ious.diagonal()).max() < margin:
        return ()
    # It takes as long to import as a tenth of a refinement.
    from scipy.optimize import linear_sum_assignment

    best = linear_sum_assignment(ious, maximize=True)[1]
    moved = np.flatnonzero(best != np.arange(len(low)))
    if not len(moved):
        return ()
    now, paired = ious.diagonal()[moved], ious[moved, best[moved]]
    gained = (paired - now).sum() / np.count_nonzero(meaningful)
    enough = paired.mean() >= max(now.mean() + margin, Margin.LEAST_IOU)
    if not enough or as_given[meaningful].mean() + gained < otherwise + Margin.SIMILAR:
        return ()
    score, gain = float(paired.mean()), float(paired.mean() - now.mean())
    # The best pairing may exchange views that look alike too.
    moved = moved[paired - now > Margin.SIMILAR]
    pairs = tuple((int(numbers[best[i]]), int(numbers[i])) for i in moved)
    views = tuple(sorted(camera for _, camera in pairs))
    return (Finding("mispaired", views, score, gain, pairs=pairs),)
