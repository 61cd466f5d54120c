"""Which hypotheses may explain cloud, cameras and masks, if they do not agree as given.

Every candidate has an IoU with every view, in coarse cells. It may be right if it raises the mean
IoU of the views that it is about. The contours decide (`verification.py`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..geometry.arrays import Array, Bits, Indices
from ..geometry.camera import Camera
from ..geometry.view import View
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

# A hypothesis may be right if silhouettes then agree better by this IoU ...
GAIN = 0.04
# ... and at least so far.
LEAST_IOU = 0.4
# Hypotheses that differ by less agree about as well.
SIMILAR = 0.03
# A single view may be wrong if its IoU is lower than the median of the others by this, and higher
# by this under a hypothesis.
BELOW_OTHERS = 0.15
# A hypothesis that turns the cloud may explain the views less well, by this IoU, than a cloud of
# other proportions does, and no worse: a stretched can looks like a can whose axes are exchanged.
BELOW_STRETCHED = 0.04
# An image that K may be of is larger or smaller than the picture by these factors, with the same
# proportions to a share, and with others: a picture that was cropped is less off, or in one
# direction only.
RESIZED, SAME_PROPORTIONS, SQUASHED = 1.2, 0.05, 1.5
# Widths that are tried: those of the most views.
MOST_WIDTHS = 3
# Candidates that are verified, likeliest first.
MOST_CANDIDATES = 3
# More views are not compared with the masks of others.
MOST_PAIRED = 64


@dataclass(frozen=True)
class Candidates:
    """What may explain cloud and masks, by coarse silhouettes.

    pairs : another order of the masks, or nothing. of_input : what may be wrong with all views,
    likeliest first. of_views : what may be wrong with single views.
    """

    pairs: tuple[Finding, ...] = ()
    of_input: tuple[Finding, ...] = ()
    of_views: tuple[Finding, ...] = ()


class Table:
    """The IoU of each of C candidates with each view: [1 + C + 1, V].

    The first row is of the input as given, and so is the last, if the box of the cloud were that of
    the mask.
    """

    def __init__(
        self, points: Array, outlines: Sequence[Outline], given: Sequence[Assumption]
    ) -> None:
        cameras = [outline.view.camera for outline in outlines]
        self.candidates = list(_candidates(given, cameras))
        options = [given, *(candidate.assumed(given) for candidate in self.candidates)]
        self.ious = np.stack([outline.ious(points, options) for outline in outlines], axis=1)

    def likely(self, views: Sequence[int], of_cloud: bool = True) -> list[Finding]:
        """Candidates that may explain ``views``, likeliest first; ``of_cloud`` : also those.

        If leaving an assumption out explains them, none is added.
        """
        before, *scores, stretched = self.ious[:, views].mean(1).tolist()
        least = max(before + GAIN, LEAST_IOU)
        if_turned = max(least, stretched - BELOW_STRETCHED)
        findings: list[Finding] = []
        for score, candidate in zip(scores, self.candidates, strict=True):
            hypotheses = candidate.hypotheses
            turns = any(hypothesis.turns for hypothesis in hypotheses)
            about_cloud = any(hypothesis.of_cloud for hypothesis in hypotheses)
            if score >= (if_turned if turns else least) and (of_cloud or not about_cloud):
                gain = score - before
                findings.append(replace(candidate, views=tuple(views), score=score, gain=gain))
        findings.sort(key=lambda finding: -finding.score)
        least = max((finding.score for finding in findings), default=0.0) - SIMILAR
        simpler = [finding for finding in findings if finding.without and finding.score >= least]
        return (simpler or findings)[:MOST_CANDIDATES]


def agreement(points: Array, views: Sequence[View]) -> float:
    """Mean IoU, in coarse cells, of ``points`` [N, 3] and masks as they are."""
    return float(np.mean([Outline(view).ious(points, [()])[0] for view in views]))


def explain(
    points: Array, outlines: Sequence[Outline], given: Sequence[Assumption], boxes: Bits
) -> Candidates:
    """What may explain ``points`` [N, 3] and the views; a few milliseconds a view.

    ``boxes`` [V] : which masks are bounding boxes, which show nothing of the object's shape.
    """
    large = np.array([outline.foreground_cells >= FEWEST_CELLS for outline in outlines])
    table = Table(points, outlines, given)
    telling = np.flatnonzero(large & ~boxes)
    if not len(telling):
        return Candidates()
    of_input = table.likely(telling.tolist())
    best = max((finding.score for finding in of_input), default=0.0)
    pairs = _mispaired(points, outlines, given, telling, best)
    return Candidates(tuple(pairs), tuple(of_input), tuple(_of_views(table, telling)))


def _candidates(given: Sequence[Assumption], cameras: Sequence[Camera]) -> Iterator[Finding]:
    for assumption in given:
        yield Finding(assumption.hypothesis.name, without=assumption)
    single = [
        hypothesis for hypothesis in HYPOTHESES.values() if all(map(hypothesis.applies, cameras))
    ]
    if not any(assumption.hypothesis.name.startswith(OF_WIDTH) for assumption in given):
        single += [of_width(*size) for size in _widths(cameras)]
    pairs = list(product(OF_AXES, UPRIGHT))
    if not any(map(focal_in_pixels, cameras)):
        pairs += product(FOCAL_UNITS, OF_AXES)
    for hypotheses in (*product(single), *pairs):
        if not set(map(Assumption, hypotheses)) & set(given):
            yield Finding("+".join(hypothesis.name for hypothesis in hypotheses))


def _widths(cameras: Sequence[Camera]) -> list[tuple[int, ...]]:
    """Widths, or widths and heights, of other images that K may be of.

    The principal point lies in the middle of such an image.
    """
    sizes: Counter[tuple[int, ...]] = Counter()
    for camera in cameras:
        size = np.array([camera.width, camera.height])
        of_K = 2.0 * camera.K[:2, 2] + 1.0
        if (of_K < 2.0).any():
            continue
        across, down = of_K / size
        resized = abs(across / down - 1.0) < SAME_PROPORTIONS
        if max(across, down, 1.0 / across, 1.0 / down) < (RESIZED if resized else SQUASHED):
            continue
        width, height = (int(length) for length in np.rint(of_K))
        sizes[(width,) if resized else (width, height)] += 1
    # A width of 0 has no name, and neither has one of seven digits.
    named = [size for size, _ in sizes.most_common() if hypothesis_called(of_width(*size).name)]
    return named[:MOST_WIDTHS]


def _of_views(table: Table, views: Indices) -> list[Finding]:
    """What may be right for one view that disagrees with the cloud, and not for the others."""
    findings = []
    for view in views.tolist():
        ious = table.ious[0, views[views != view]]
        # By the median, so that another bad view does not hide this one.
        if len(ious) and np.median(ious) >= table.ious[0, view] + BELOW_OTHERS:
            candidates = table.likely([view], of_cloud=False)
            findings += [finding for finding in candidates if finding.gain >= BELOW_OTHERS]
    return findings


def _mispaired(
    points: Array,
    outlines: Sequence[Outline],
    given: Sequence[Assumption],
    views: Indices,
    otherwise: float,
) -> list[Finding]:
    """The finding that cameras see other masks than their own, or nothing.

    Another order of the masks is one more hypothesis: the mean IoU of the best pairing must be
    better than the best IoU ``otherwise``.
    """
    if not 2 <= len(views) <= MOST_PAIRED:
        return []
    compared = [outlines[int(view)] for view in views]
    # [camera, mask]
    ious = np.zeros((len(views), len(views)))
    for i, of_camera in enumerate(compared):
        x, y, (inverted,) = of_camera.project(points, [given])
        for k, of_mask in enumerate(compared):
            cells = of_mask.cells.get(inverted)
            if cells and of_mask.view.mask.shape == of_camera.view.mask.shape:
                ious[i, k] = cells.ious(x, y, visible_in(of_mask.view, x, y))[0]
    if (ious.max(1) - ious.diagonal()).max() < GAIN:
        return []
    # It takes as long to import as a tenth of a refinement.
    from scipy.optimize import linear_sum_assignment

    best = linear_sum_assignment(ious, maximize=True)[1]
    # The best pairing may exchange views that look alike too.
    paired = ious[np.arange(len(views)), best]
    gaining = np.flatnonzero(paired > ious.diagonal() + SIMILAR)
    if not len(gaining):
        return []
    before, score = float(ious.diagonal()[gaining].mean()), float(paired[gaining].mean())
    if score < max(before + GAIN, LEAST_IOU) or paired.mean() < otherwise + SIMILAR:
        return []
    pairs = tuple((int(views[best[i]]), int(views[i])) for i in gaining)
    exchanged = tuple(sorted(camera for _, camera in pairs))
    return [Finding("mispaired", exchanged, score, score - before, pairs=pairs)]
