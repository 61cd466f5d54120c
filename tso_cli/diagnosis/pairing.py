"""Whether views fit one another's masks better than their own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Array
from .hypotheses import Suspect
from .outline import LEAST_IOU, MARGIN, SIMILAR, Outline

# Views of less IoU may have each the mask of another, if there are not too many of them.
MISPAIRED, MOST_MISPAIRED = 0.8, 64
# Of two views, of which there is one other order, so much gain of the IoU is enough.
MARGIN_OF_TWO = 0.12
# At most so many pairs are named.
MOST_PAIRS = 3


def mispaired_views(
    points: Array,
    outlines: Sequence[Outline],
    as_given: Array,
    tells: NDArray[np.bool_],
    otherwise: float,
) -> tuple[tuple[Suspect, ...], int]:
    """What is said where views fit one another's masks better than their own, and how many do.

    Of the views whose mask ``tells`` [V] enough; the mean IoU must be better than the best ``otherwise``.
    """
    numbers = np.flatnonzero(tells & (as_given < MISPAIRED))
    if not 2 <= len(numbers) <= MOST_MISPAIRED:
        return (), 0
    low = [outlines[int(i)] for i in numbers]
    # [seen by the camera, in the mask]
    ious = np.array([camera.ious(points, camera.given, low) for camera in low])
    margin = MARGIN_OF_TWO if len(low) == 2 else MARGIN
    if (ious.max(1) - ious.diagonal()).max() < margin:
        return (), 0
    # It takes as long to import as a tenth of a run.
    from scipy.optimize import linear_sum_assignment

    best = linear_sum_assignment(ious, maximize=True)[1]
    moved = np.flatnonzero(best != np.arange(len(low)))
    if not len(moved):
        return (), 0
    given, paired = ious.diagonal()[moved], ious[moved, best[moved]]
    of_all = as_given[tells].mean() + (paired - given).sum() / np.count_nonzero(tells)
    if paired.mean() < max(given.mean() + margin, LEAST_IOU) or of_all < otherwise + SIMILAR:
        return (), 0
    # The best pairing may exchange views that look alike too.
    moved = moved[paired - given > SIMILAR]
    names = [outline.view.name for outline in outlines]
    if len(set(names)) < len(names):
        names = [f"view {number}" for number in range(1, len(names) + 1)]
    pairs = [
        f"{names[numbers[best[i]]]} with the camera that {names[numbers[i]]} has now"
        for i in moved[:MOST_PAIRS]
    ]
    more = f", and so on, {len(moved)} in all" * (len(moved) > MOST_PAIRS)
    # All views of a cloud that is turned show what others show of a right one.
    what = "masks and cameras are paired wrongly" + ", or the cloud is turned" * (
        len(moved) == len(outlines)
    )
    return (Suspect(what, ", ".join(pairs) + more, float(paired.mean())),), len(moved)
