"""Cameras that are moved with the points: whether a view's camera is off, and where it should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from ..geometry.view import View
from ..geometry.window import window_around, window_of
from ..silhouette.chamfer import ChamferToInitial
from .camera_moves import CameraMoves, moved_camera
from .config import PAPER_GAMMA, PAPER_LEARNING_RATE, PAPER_STEPS, Settings
from .objective import MaskChamferObjective, SilhouetteObjective, resample_view
from .optimise import descend
from .parameters import PointParameters
from .problem import Problem

# A correction is accepted if it alone takes the misfit of the start in that view to under this share: the silhouette of a
# wrong shape asks for corrections of a right camera too, but no camera makes a wrong shape fit.
LEFT = 0.38
# The misfit is `mask_chamfer_loss` with this reach, cells: unlike the silhouette's it is near 0 for a cloud that fits.
REACH = 4.0


def settled(items: Sequence[Problem], start: PointParameters, settings: Settings) -> tuple[list[Problem], bool]:
    """The items with the cameras corrected that need it, and whether Ctrl-C kept them as they were.

    Points and cameras are moved together with the paper's settings, the points held near their start (which pins what a move
    of all points and one of all cameras have in common), the cameras near the given ones. A correction is kept if with it
    the start itself, not moved, fits the view's mask far better (`LEFT`), else dropped. Where the points went on the way
    is forgotten.

    Parameters
    ----------
    items : each asked by as many views, of the same kinds. start : of their clouds; it is left as it is.
    """
    first = start.forward().detach().clone()
    points = first.clone().requires_grad_()
    chamfer = ChamferToInitial(first, start.counts)
    rate, gamma = PAPER_LEARNING_RATE["points"], PAPER_GAMMA["points"]
    # The mirror image of a wrong camera is wrong as well.
    working = [item.working[: len(item.views)] for item in items]
    moves = CameraMoves([[view.camera for view in own] for own in working], points, rate)
    mask_term = SilhouetteObjective(working, start.counts, points)
    mask_term.moves = moves
    size = points.shape[1]

    def produce() -> Tensor:
        # The corrections are more rows of the cloud: so the loop keeps those of its best iterate.
        return torch.cat([points, moves.parameter], 1)

    def objective(_: Tensor) -> Tensor:
        return mask_term(points) + gamma * chamfer(points) + moves.penalty()

    descent = descend(produce, [points, moves.parameter], objective, PAPER_STEPS, rate)
    if descent.interrupted:
        return list(items), True
    values = moves.values_of(descent.best[:, size:]).double().cpu().numpy()
    corrected = [
        tuple(
            replace(view, camera=moved_camera(view.camera, by, item.cloud.centre, item.cloud.scale))
            for view, by in zip(item.views, row, strict=True)
        )
        for item, row in zip(items, values, strict=True)
    ]
    before, after = _misfits(items, corrected, start.counts, first)
    chosen = [
        tuple(other if better else view for view, other, better in zip(item.views, views, row, strict=True))
        for item, views, row in zip(items, corrected, (after < LEFT * before).tolist(), strict=True)
    ]
    return [item.seen_by(own, settings) for item, own in zip(items, chosen, strict=True)], False


def _misfits(
    items: Sequence[Problem], corrected: Sequence[tuple[View, ...]], counts: Tensor, points: Tensor
) -> tuple[Tensor, ...]:
    """How far ``points`` [B, N, 3] are from what each view asks, [B, V] as it is and as it is corrected.

    Both in one window that holds the cloud as either camera sees it: the misfit counts cells, and these are to be as large.
    """
    found = []
    for number in range(len(items[0].views)):
        pairs = []
        for item, others in zip(items, corrected, strict=True):
            seen, other, cloud = item.working[number], others[number], item.cloud
            box = window_around(seen.box, window_of(other, cloud.initial))
            pairs.append(
                [resample_view(view, seen.sigma_sq, cloud.centre, cloud.scale, box) for view in (item.views[number], other)]
            )
        own = [MaskChamferObjective([[view] for view in column], counts, points) for column in zip(*pairs, strict=True)]
        found.append(torch.stack([pull(points, REACH) for pull in own]))
    return torch.stack(found, 2).unbind()
