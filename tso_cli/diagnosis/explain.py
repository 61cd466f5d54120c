"""Which hypothesis explains cloud, cameras and masks, if they do not agree as given: one rule.

Every candidate has an IoU with every view, in coarse cells. A candidate is named if it raises the
mean IoU of the views that it is about by `Margin.FOUND`, to at least `Margin.LEAST_IOU`, and the
mean of all views more than others do.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..geometry.arrays import Array, Bits, Indices
from ..geometry.camera import Camera
from .assumptions import Assumption
from .cells import FEWEST_CELLS, Outline, visible_in
from .findings import Finding
from .hypotheses import (
    FOCAL_UNITS,
    HYPOTHESES,
    OF_AXES,
    OF_WIDTH,
    UPRIGHT,
    focal_in_pixels,
    hypothesis_called,
    of_width,
)


class Margin:
    """How much better silhouettes agree, as IoU, if a hypothesis is right."""

    FOUND = 0.16  # by this a mistake is found, by one view ...
    WEAK = 0.04  # ... and by this it is weak: short optimisations verify it
    LEAST_IOU = 0.4  # and silhouettes agree at least so far
    SIMILAR = 0.03  # hypotheses that differ by less agree about as well
    BELOW_OTHERS = 0.1  # a single view may be wrong if it is so far below the median of the others


# Of several views chance agrees less: the margin falls with the root of their number, up to this
# one. The views share the error of the start's shape.
MOST_INDEPENDENT = 4
# Two mistakes at once fit by chance more often than one does.
PRIOR_OF_TWO = 0.06
# A hypothesis that turns the object must explain the views better, by this, than a cloud of other
# proportions does: a stretched can looks like a can whose axes are exchanged. Of 240 stretched
# bodies none is named so, of validation shapes 0.5 % fewer mistakes are named.
BETTER_THAN_STRETCHED = 0.04
# A width that K may be of differs from the width of the picture by this share.
OTHER_WIDTH = 0.05
# Widths that are tried: those of the most views.
MOST_WIDTHS = 3
# Hypotheses that are named, if they agree about as well as the best.
MOST_ALTERNATIVES = 3
# More views are not compared with the masks of others.
MOST_PAIRED = 64
# What is wrong with less than this share of the views is outvoted by the others.
OUTVOTED_SHARE = 0.5


@dataclass(frozen=True)
class Explanation:
    """How far cloud and masks agree, as mean IoU in coarse cells, and what explains it.

    as_given : of the input as it is.
    of_input : alternatives that explain the whole input, likeliest first.
    of_views : what explains single views, where the input as a whole looks right.
    weak : alternatives under which silhouettes agree somewhat better; () if anything is found.
    """

    as_given: float
    of_input: tuple[Finding, ...] = ()
    of_views: tuple[Finding, ...] = ()
    weak: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Candidate:
    """The given assumptions with ``changed`` left out (``without``), or with ``changed`` added."""

    assumptions: tuple[Assumption, ...]
    changed: tuple[Assumption, ...] = ()
    without: bool = False

    @property
    def prior(self) -> float:
        if self.without:
            return 0.0
        of_two = PRIOR_OF_TWO if len(self.changed) > 1 else 0.0
        return of_two + sum(one.hypothesis.prior for one in self.changed)

    @property
    def of_cloud(self) -> bool:
        return any(one.hypothesis.of_cloud for one in self.changed)

    @property
    def turns(self) -> bool:
        return any(one.hypothesis.turns for one in self.changed)

    def found(self, views: Sequence[int], score: float, before: float) -> Finding:
        """The finding that this is right."""
        name = "+".join(one.hypothesis.name for one in self.changed)
        without = self.changed[0] if self.without else None
        return Finding(name, tuple(views), score, score - before, without)


class Table:
    """The IoU of each candidate [C] with each view [V]; candidate 0 is the input as given.

    ``stretched`` [V] is the IoU of the input as given, if the box of the cloud were that of the
    mask.
    """

    def __init__(
        self, points: Array, outlines: Sequence[Outline], given: Sequence[Assumption]
    ) -> None:
        cameras = [outline.view.camera for outline in outlines]
        self.candidates = list(_candidates(tuple(given), cameras))
        options = [candidate.assumptions for candidate in self.candidates]
        found = [outline.ious(points, options) for outline in outlines]
        self.ious = np.stack([ious for ious, _ in found], axis=1)
        self.stretched = np.array([stretched for _, stretched in found])
        self.turns = np.array([candidate.turns for candidate in self.candidates])
        self.priors = np.array([candidate.prior for candidate in self.candidates])
        self.of_cloud = np.array([candidate.of_cloud for candidate in self.candidates])

    def scores(self, views: Indices, better_than_stretched: float = BETTER_THAN_STRETCHED) -> Array:
        """[C], the mean IoU of ``views`` less the prior; 0 if other proportions explain as much."""
        ious = self.ious[:, views].mean(1)
        scores = ious - self.priors
        stretched = self.stretched[views].mean()
        scores[self.turns & (ious < stretched + better_than_stretched)] = 0.0
        scores[0] = 0.0
        return scores

    def likely(self, views: Indices, scores: Array, margin: float = Margin.FOUND) -> list[Finding]:
        """Candidates that explain ``views``, likeliest first.

        If leaving an assumption out explains them, none is added.
        """
        before = float(self.ious[0, views].mean())
        if scores.max() < max(before + _margin_of(len(views), margin), Margin.LEAST_IOU):
            return []
        order = np.argsort(-scores, kind="stable")
        likely = [i for i in order if scores[i] >= scores.max() - Margin.SIMILAR]
        chosen = [i for i in likely if self.candidates[i].without] or likely
        return [
            self.candidates[i].found(views.tolist(), float(self.ious[i, views].mean()), before)
            for i in chosen[:MOST_ALTERNATIVES]
        ]


def _margin_of(views: int, margin: float = Margin.FOUND) -> float:
    """The margin by which ``views`` together must agree better."""
    return margin / float(np.sqrt(min(views, MOST_INDEPENDENT)))


def explain(
    points: Array,
    outlines: Sequence[Outline],
    given: Sequence[Assumption],
    boxes: Bits,
    mispaired: bool = True,
) -> Explanation:
    """What explains ``points`` [N, 3] and the views; a few milliseconds a view.

    ``boxes`` [V] : which masks are bounding boxes, which show nothing of the object's shape.
    ``mispaired`` : whether the masks may be in another order than their cameras.
    """
    large = np.array([outline.foreground_cells >= FEWEST_CELLS for outline in outlines])
    table = Table(points, outlines, given)
    as_given = float(table.ious[0].mean())
    shown = np.flatnonzero(large & ~boxes)
    if not len(shown):
        return Explanation(as_given)
    scores = table.scores(shown)
    pairs: list[Finding] = []
    if mispaired:
        pairs = _mispaired(points, outlines, given, shown, float(scores.max()))
    if pairs and len(pairs[0].views) >= OUTVOTED_SHARE * len(outlines):
        return Explanation(as_given, tuple(pairs))
    if not pairs and (found := table.likely(shown, scores)):
        return Explanation(as_given, tuple(_about_all(found, len(outlines))))
    of_views = pairs or _of_views(table, shown)
    weak: list[Finding] = []
    if large.all() and not of_views:
        # Cells may take a turned object for a stretched one; short optimisations see more.
        scores = table.scores(shown, better_than_stretched=-BETTER_THAN_STRETCHED)
        weak = _about_all(table.likely(shown, scores, Margin.WEAK), len(outlines))
    return Explanation(as_given, of_views=tuple(of_views), weak=tuple(weak))


def _about_all(found: Sequence[Finding], views: int) -> list[Finding]:
    """What explains the views whose masks show the shape is about the others too."""
    return [replace(one, views=tuple(range(views))) for one in found]


def _candidates(given: tuple[Assumption, ...], cameras: Sequence[Camera]) -> Iterator[Candidate]:
    yield Candidate(given)
    for one in given:
        yield Candidate(tuple(other for other in given if other is not one), (one,), True)
    alone = [one for one in HYPOTHESES.values() if all(map(one.applies, cameras))]
    if not any(one.hypothesis.name.startswith(OF_WIDTH) for one in given):
        alone += [of_width(*size) for size in _widths(cameras)]
    two = list(product(OF_AXES, UPRIGHT))
    if not any(map(focal_in_pixels, cameras)):
        two += product(FOCAL_UNITS, OF_AXES)
    for hypotheses in ((one,) for one in alone), two:
        for changed in (tuple(map(Assumption, names)) for names in hypotheses):
            if not set(changed) & set(given):
                yield Candidate((*given, *changed), changed)


def _widths(cameras: Sequence[Camera]) -> list[tuple[int, ...]]:
    """Widths, or widths and heights, of other images that K may be of.

    The principal point lies in the middle of such an image. Half and twice the width are tried too.
    """
    found: Counter[tuple[int, ...]] = Counter()
    for camera in cameras:
        size = np.array([camera.width, camera.height])
        of_K = 2.0 * camera.K[:2, 2] + 1.0
        found.update({(round(camera.width / 2),): 1, (2 * camera.width,): 1})
        if (of_K < 2.0).any() or (np.abs(of_K / size - 1.0) < OTHER_WIDTH).all():
            continue
        width, height = (int(length) for length in np.rint(of_K))
        kept = abs(of_K[0] * size[1] / (of_K[1] * size[0]) - 1.0) < OTHER_WIDTH
        found[(width,) if kept else (width, height)] += 2
    # A width of 0 has no name, and neither has one of seven digits.
    named = [size for size, _ in found.most_common() if hypothesis_called(of_width(*size).name)]
    return named[:MOST_WIDTHS]


def _of_views(table: Table, shown: Indices) -> list[Finding]:
    """What is right for one view that disagrees with the cloud, and not for the others."""
    found = []
    as_given = table.ious[0]
    for view in shown.tolist():
        others = shown[shown != view]
        # By the median, so that another bad view does not hide this one.
        if not len(others) or np.median(as_given[others]) < as_given[view] + Margin.BELOW_OTHERS:
            continue
        before = as_given[others].mean()
        alone = ~table.of_cloud & (table.ious[:, others].mean(1) < before + Margin.SIMILAR)
        scores = np.where(alone, table.scores(np.array([view])), 0.0)
        found += table.likely(np.array([view]), scores)[:1]
    return found


def _mispaired(
    points: Array,
    outlines: Sequence[Outline],
    given: Sequence[Assumption],
    shown: Indices,
    otherwise: float,
) -> list[Finding]:
    """The finding that cameras see other masks than their own, or nothing.

    Another order of the masks is one more hypothesis: the mean IoU of the best pairing must be
    better than the best IoU ``otherwise``.
    """
    if not 2 <= len(shown) <= MOST_PAIRED:
        return []
    compared = [outlines[int(view)] for view in shown]
    # [camera, mask]
    ious = np.zeros((len(shown), len(shown)))
    for i, of_camera in enumerate(compared):
        x, y, (inverted,) = of_camera.project(points, [given])
        for k, of_mask in enumerate(compared):
            cells = of_mask.cells.get(inverted)
            if cells and of_mask.view.mask.shape == of_camera.view.mask.shape:
                ious[i, k] = cells.ious(x, y, visible_in(of_mask.view, x, y))[0]
    if (ious.max(1) - ious.diagonal()).max() < _margin_of(len(shown)):
        return []
    # It takes as long to import as a tenth of a refinement.
    from scipy.optimize import linear_sum_assignment

    best = linear_sum_assignment(ious, maximize=True)[1]
    # The best pairing may exchange views that look alike too.
    paired = ious[np.arange(len(shown)), best]
    moved = np.flatnonzero(paired > ious.diagonal() + Margin.SIMILAR)
    if not len(moved):
        return []
    before, score = float(ious.diagonal()[moved].mean()), float(paired[moved].mean())
    enough = score >= max(before + _margin_of(len(moved)), Margin.LEAST_IOU)
    if not enough or paired.mean() < otherwise + Margin.SIMILAR:
        return []
    pairs = tuple((int(shown[best[i]]), int(shown[i])) for i in moved)
    views = tuple(sorted(camera for _, camera in pairs))
    return [Finding("mispaired", views, score, score - before, pairs=pairs)]
