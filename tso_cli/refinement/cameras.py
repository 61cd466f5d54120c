"""Cameras that are moved with the points: whether a view's camera is off, and where it should be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from torch import Tensor

from ..objective import MaskObjective
from ..pose.moves import LEARNING_RATE, CameraMoves, deviations, moved_camera
from ..scene import View
from .loop import descend
from .starts import Cloud, PointsStart

# A correction of fewer standard deviations is what the silhouette of a wrong shape asks for of a right camera.
ACCEPTED = 1.5


def settled_views(
    clouds: Sequence[Cloud],
    views: Sequence[tuple[View, ...]],
    mask_term: MaskObjective,
    regulariser: Callable[[Tensor], Tensor],
    start: PointsStart,
    steps: int,
    learning_rate: float,
) -> tuple[list[tuple[View, ...]], bool]:
    """The views of each cloud, with the cameras corrected that need it, and whether Ctrl-C kept them as they were.

    Points and cameras are moved together, the points held near their start (which pins what a move of all points and one of
    all cameras have in common), the cameras near the given ones. A correction of over 1.5 standard deviations is kept, a
    smaller one dropped. The points start anew afterwards: no way they went before the camera was right remains.

    Parameters
    ----------
    mask_term : of the cameras as given; it is left as it was.
    regulariser : weighted distance [B] of clouds [B, N, 3] to their start.
    start, steps, learning_rate : of the points.
    """
    first = start.produce().detach().clone()
    moves = CameraMoves(
        [[v.camera.for_normalised(c.centre, c.scale) for v in own] for c, own in zip(clouds, views, strict=True)], first
    )
    mask_term.moves = moves
    points = first.clone().requires_grad_()
    try:
        descent = descend(
            lambda: points,
            [points],
            lambda moved: mask_term(moved) + regulariser(moved) + moves.penalty(),
            steps,
            learning_rate,
            beside=[moves.values],
            beside_rate=LEARNING_RATE,
        )
    finally:
        mask_term.moves = None
    if descent.interrupted:
        return list(views), True
    values = descent.best_beside[0].double().cpu().numpy()
    values = np.where(deviations(values)[..., None] > ACCEPTED, values, 0.0)
    settled = [
        tuple(replace(v, camera=moved_camera(v.camera, by, c.centre, c.scale)) for v, by in zip(own, row, strict=True))
        for c, own, row in zip(clouds, views, values, strict=True)
    ]
    return settled, False
