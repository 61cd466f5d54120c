"""The two losses of the paper's preset and other ways to compute them, value and gradient."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from tso_cli.geometry.resampling import area_resize
from tso_cli.kernels.window import window_radius
from tso_cli.losses.chamfer import ChamferToStart
from tso_cli.losses.projection import project_differentiably
from tso_cli.losses.silhouette import silhouette_bce
from tso_cli.optimisation.loop import Array, Term
from tso_cli.optimisation.presets import SIGMA_SQ
from tso_cli.refinement import RefineConfig, refine

from ..interrupts import uninterrupted
from ..study import Cases
from .refining import chair_views, cloud
from .timing import Contestant, Setting, timed

# (points, pixels each way) of the silhouette, and points of the Chamfer distance.
PICTURES, CLOUDS = ((1024, 64), (16384, 256)), (1024, 16384)
STEPS = (10, 30, 50)
"""Chamfer is measured after these of the paper's steps: hardly moved points need no search."""
CLAMP = 1e-6
"""Of silhouettes in torch's cross-entropy."""


def measure_silhouette(setting: Setting, sizes: Sequence[tuple[int, int]] = PICTURES) -> Cases:
    """Seconds of the loss of points and a mask at every size, on one thread."""
    records = []
    for count, side in sizes:
        points_px, mask = scene(count, side, setting.seed)
        valid = np.ones(count, bool)
        ours = partial(silhouette_bce, points_px, valid, mask, 1.0 - mask, SIGMA_SQ)
        target = torch.as_tensor(mask, dtype=torch.float32)
        scatter = timed(partial(scattered_loss, points_px, target))
        samples = {"tso": timed(ours), "scatter 9x9, torch": scatter}
        fields = {"points": count, "side": side}
        contestants = [Contestant(name, sample, fields) for name, sample in samples.items()]
        records += setting.race("silhouette", contestants, "over_tso")
    return records


def scene(count: int, side: int, seed: int = 0) -> tuple[Array, Array]:
    """Initial points [count, 2] in the picture of the chair, ``side`` x ``side``, and its mask."""
    (view,) = chair_views()
    box = (-0.5, -0.5, view.camera.width - 0.5, view.camera.height - 0.5)
    mask = area_resize(view.mask, box, side, side)[0].clip(0.0, 1.0)
    return project_differentiably(
        cloud(count, seed), view.camera.resized(side, side)
    ).points_px, mask


def scattered_loss(points: Array, mask: Tensor) -> tuple[float, Array]:
    """Value and gradient of the loss in plain torch: all taps, `index_add`, tanh, cross-entropy.

    It has less to do than tso: it lacks the term for mask pixels that no window reaches.
    """
    points_px = torch.as_tensor(points, dtype=torch.float32).requires_grad_()
    radius, side = window_radius(SIGMA_SQ), mask.shape[-1]
    steps = torch.arange(-radius, radius + 1)
    centre = points_px.detach().round().long()
    column, row = (centre[:, axis : axis + 1] + steps for axis in (0, 1))  # [N, k]
    weights_x, weights_y = (
        torch.exp((points_px[:, axis : axis + 1] - index).square() * (-0.5 / SIGMA_SQ))
        * ((index >= 0) & (index < side))
        for axis, index in ((0, column), (1, row))
    )
    taps = weights_y.unsqueeze(2) * weights_x.unsqueeze(1)  # [N, k, k]
    flat = row.clamp(0, side - 1).unsqueeze(2) * side + column.clamp(0, side - 1).unsqueeze(1)
    sums = taps.new_zeros(side * side).index_add(0, flat.flatten(), taps.flatten())
    silhouette = torch.tanh(sums).clamp(CLAMP, 1.0 - CLAMP).view_as(mask)
    loss = torch.nn.functional.binary_cross_entropy(silhouette, mask, reduction="sum")
    return loss.item(), torch.autograd.grad(loss, points_px)[0].numpy()


def measure_chamfer(setting: Setting, sizes: Sequence[int] = CLOUDS) -> Cases:
    """Seconds a step of every contestant, on one thread unless its name says otherwise."""
    records = []
    for count in sizes:
        initial = cloud(count, setting.seed)
        configs = [RefineConfig(preset="paper", steps=steps) for steps in STEPS]
        moved = [
            uninterrupted(refine(initial, chair_views(), config=config)).points
            for config in configs
        ]
        contestants = [
            Contestant(name, timed(partial(_along, term, moved)), {"points": count}, len(moved))
            for name, term in terms(initial).items()
        ]
        records += setting.race("chamfer", contestants, "over_tso")
    return records


def _along(term: Term, iterates: Sequence[Array]) -> None:
    for points in iterates:
        term(points)


def terms(initial: Array) -> dict[str, Term]:
    """Contestant -> its Chamfer distance to ``initial`` [N, 3]; tso's is first."""
    result: dict[str, Term] = {"tso": ChamferToStart(initial)}
    for workers, name in ((1, "1 worker"), (-1, "all workers")):
        result[f"two k-d trees a step, {name}"] = partial(_k_d_trees, initial, workers)
    return result


def _k_d_trees(initial: Array, workers: int, moved: Array) -> tuple[float, Array]:
    """Value and gradient by nearest neighbours of all points, both ways."""
    ahead = moved - initial[cKDTree(initial).query(moved, workers=workers)[1]]
    nearest = cKDTree(moved).query(initial, workers=workers)[1]
    back = moved[nearest] - initial
    gradient = ahead.copy()
    np.add.at(gradient, nearest, back)
    value = float(np.square(ahead).sum() + np.square(back).sum()) / len(moved)
    return value, (2.0 / len(moved)) * gradient
