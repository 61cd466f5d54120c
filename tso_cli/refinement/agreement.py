"""How well a cloud agrees with its masks, before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..evaluation.footprint import common_window, window_iou
from ..geometry.view import View

Array = NDArray[np.float64]


def view_ious(initial: Array, refined: Array, given: Sequence[View], used: Sequence[View]) -> list[tuple[float, float]]:
    """The IoU in each view (`window_iou`) before and after, both judged on the same pixels.

    Parameters
    ----------
    initial, refined : [N, 3], in the units of their files.
    given, used : the views with the cameras that see the one and the other; they differ where cameras were corrected.
    """
    found = []
    for before, after in zip(given, used, strict=True):
        stages = (initial, before), (refined, after)
        box = common_window(stages)
        found.append((window_iou(*stages[0], box), window_iou(*stages[1], box)))
    return found
