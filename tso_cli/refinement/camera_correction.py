"""Corrections of given cameras, found together with the points and kept where they explain a misfit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from ..geometry.view import View
from ..geometry.window import window_around, window_of
from ..silhouette.chamfer import ChamferToInitial
from .adam import Adam
from .camera_moves import CameraMoves, moved_camera
from .config import Settings
from .objective import MaskChamferObjective, SilhouetteObjective, ViewTargets
from .optimise import descend
from .presets import PAPER_GAMMA, PAPER_LEARNING_RATE, PAPER_STEPS
from .problem import Problem
from .resampled_view import resample_view

# A correction is kept if it alone reduces the start's misfit in its view to less than this share: the silhouette of a wrong
# shape asks for corrections of a right camera too, but no camera makes a wrong shape fit.
MISFIT_LEFT = 0.38
# The misfit is the mask Chamfer loss at this robust scale, cells; unlike the silhouette's it is near 0 for a cloud that fits.
ROBUST_SCALE = 4.0


def corrected_cameras(
    problems: Sequence[Problem], initial: Tensor, counts: Tensor, settings: Settings
) -> tuple[list[Problem], bool]:
    """The problems with the cameras corrected that need it, and whether Ctrl-C left them as they were.

    Points and cameras move together with the paper's settings. The points are held near their start, which separates a motion
    of all points from one of the camera; the cameras near the given ones. A correction is kept if with it the start
    itself fits the view's mask far better (`MISFIT_LEFT`). The points' motion is discarded.
    """
    points = initial.clone().requires_grad_()
    chamfer = ChamferToInitial(initial, counts)
    rate = PAPER_LEARNING_RATE["points"]
    # Without the flipped views: the mirror image of a wrong camera is wrong as well.
    resampled = [problem.resampled[: len(problem.views)] for problem in problems]
    moves = CameraMoves([[view.camera for view in views] for views in resampled], points, rate)
    silhouettes = SilhouetteObjective(resampled, counts, points, camera_moves=moves)
    # The corrections are more rows of the clouds, so that the loop keeps those of its best iterate.
    descent = descend(
        lambda: torch.cat([points, moves.parameter], 1),
        lambda _: silhouettes(points) + PAPER_GAMMA["points"] * chamfer(points) + moves.penalty(),
        Adam([points, moves.parameter], rate),
        PAPER_STEPS,
    )
    if descent.interrupted:
        return list(problems), True
    values = moves.values_of(descent.best[:, points.shape[1] :]).double().cpu().numpy()
    corrected = [
        tuple(
            replace(view, camera=moved_camera(view.camera, correction, problem.cloud.centre, problem.cloud.scale))
            for view, correction in zip(problem.views, row, strict=True)
        )
        for problem, row in zip(problems, values, strict=True)
    ]
    before, after = _misfits(problems, corrected, counts, initial)
    chosen = [
        tuple(new if better else old for old, new, better in zip(problem.views, views, row, strict=True))
        for problem, views, row in zip(problems, corrected, (after < MISFIT_LEFT * before).tolist(), strict=True)
    ]
    return [problem.with_views(views, settings) for problem, views in zip(problems, chosen, strict=True)], False


def _misfits(
    problems: Sequence[Problem], corrected: Sequence[tuple[View, ...]], counts: Tensor, points: Tensor
) -> tuple[Tensor, ...]:
    """The misfit [B, V] of ``points`` [B, N, 3] by the given views and by the corrected ones.

    Both in one window that holds the cloud as either camera sees it, since the misfit is in cells.
    """
    misfits = []
    for number in range(len(problems[0].views)):
        pairs = []
        for problem, views in zip(problems, corrected, strict=True):
            cloud, given, new = problem.cloud, problem.resampled[number], views[number]
            box = window_around(given.box, window_of(new, cloud.initial))
            pairs.append(
                [resample_view(view, given.sigma_sq, cloud.centre, cloud.scale, box) for view in (problem.views[number], new)]
            )
        columns = [ViewTargets([[view] for view in column], counts, points) for column in zip(*pairs, strict=True)]
        misfits.append(torch.stack([MaskChamferObjective(targets, ROBUST_SCALE)(points) for targets in columns]))
    return torch.stack(misfits, 2).unbind()
