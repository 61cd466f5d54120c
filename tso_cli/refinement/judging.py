"""How well clouds agree with masks: the silhouette's IoU, of many at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..metrics import iou
from ..projection import silhouettes_of
from ..scene import View

# Silhouettes judged at once hold no more pixels than this together; bounds memory.
PIXELS_AT_ONCE = 1 << 22


def view_ious(
    clouds: Sequence[NDArray[np.float64]], views: Sequence[tuple[View, ...]], sigma_sq: float | None, device: torch.device
) -> list[list[float]]:
    """The IoU of each cloud [N, 3] in each of its views, at the resolution of its mask.

    Parameters
    ----------
    clouds, views : in the units of their files.
    sigma_sq : px^2; None for the default of each view.
    """
    groups: dict[Any, list[tuple[int, int, View]]] = {}
    for number, own in enumerate(views):
        for index, view in enumerate(own):
            groups.setdefault((view.camera.width, view.camera.height, view.camera.model), []).append((number, index, view))
    found = [[0.0] * len(own) for own in views]
    for (width, height, _), group in groups.items():
        size = max(1, PIXELS_AT_ONCE // (width * height))
        for part in (group[i : i + size] for i in range(0, len(group), size)):
            cameras = [view.camera for *_, view in part]
            silhouettes = silhouettes_of([clouds[n] for n, *_ in part], cameras, sigma_sq, device)
            for (number, index, view), silhouette in zip(part, silhouettes, strict=True):
                found[number][index] = iou(silhouette, view.mask, view.known)
    return found
