"""Cameras that are moved with the points: whether a view's camera is off, and where it should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from ..losses import ChamferToInitial
from ..objective import MaskObjective
from ..pose.moves import CameraMoves, deviations, moved_camera
from ..scene import View
from .batching import Item
from .config import PAPER_GAMMA, PAPER_LEARNING_RATE, PAPER_STEPS
from .loop import descend
from .starts import PointsStart

# A correction of fewer standard deviations is what the silhouette of a wrong shape asks for of a right camera.
ACCEPTED = 1.5


def settled_views(items: Sequence[Item], start: PointsStart) -> tuple[list[tuple[View, ...]], bool]:
    """The views of each item, with the cameras corrected that need it, and whether Ctrl-C kept them as they were.

    Points and cameras are moved together with the paper's settings, the points held near their start (which pins what a move
    of all points and one of all cameras have in common), the cameras near the given ones. A correction of over 1.5 standard
    deviations is kept, a smaller one dropped. Where the points went on the way is forgotten.

    Parameters
    ----------
    items : each asked by as many views, of the same kinds. start : of their clouds; it is left as it is.
    """
    first = start.produce().detach().clone()
    points = first.clone().requires_grad_()
    chamfer = ChamferToInitial(first, start.counts)
    rate, gamma = PAPER_LEARNING_RATE["points"], PAPER_GAMMA["points"]
    # The mirror image of a wrong camera is wrong as well.
    working = [item.working[: len(item.views)] for item in items]
    moves = CameraMoves([[view.camera for view in own] for own in working], points, rate)
    mask_term = MaskObjective(working, start.counts, points)
    mask_term.moves = moves
    size = points.shape[1]

    def produce() -> Tensor:
        # The corrections are more rows of the cloud: so the loop keeps those of its best iterate.
        return torch.cat([points, moves.parameter], 1)

    def objective(_: Tensor) -> Tensor:
        return mask_term(points) + gamma * chamfer(points) + moves.penalty()

    descent = descend(produce, [points, moves.parameter], objective, PAPER_STEPS, rate)
    if descent.interrupted:
        return [item.views for item in items], True
    values = moves.values_of(descent.best[:, size:]).double().cpu().numpy()
    values = np.where(deviations(values)[..., None] > ACCEPTED, values, 0.0)
    return [
        tuple(
            replace(view, camera=moved_camera(view.camera, by, item.cloud.centre, item.cloud.scale))
            for view, by in zip(item.views, row, strict=True)
        )
        for item, row in zip(items, values, strict=True)
    ], False
