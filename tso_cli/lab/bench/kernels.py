"""The kernels of the paper's preset beside other ways in torch and scipy, value and gradient."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from ...geometry.resampling import area_resize
from ...kernels.dispatch import planned
from ...kernels.window import window_radius
from ...losses.chamfer import ChamferToStart
from ...losses.projection import project
from ...losses.silhouette import silhouette_bce
from ...optimisation.loop import Array, Term
from ...optimisation.presets import PAPER_SIGMA_SQ
from ...refinement import RefineConfig, refine
from ..study import Cases
from .refining import chair_views, cloud
from .timing import FORMS, Contestant, Setting, record, timed

# Points and pixels each way; points.
PICTURES, CLOUDS = ((256, 32), (1024, 64), (4096, 128), (16384, 256)), (1024, 4096, 16384)
# Numbers of the paper's steps after which Chamfer is measured: points that have hardly moved need no search.
STEPS = (10, 30, 50)
# torch.cdist holds all pairs at once.
CDIST_UP_TO = 4096


def measure_silhouette(setting: Setting, sizes: Sequence[tuple[int, int]] = PICTURES) -> Cases:
    """Seconds of the loss of points and a mask at every size, on one thread; tso's compiled loops are first."""
    records = []
    for count, side in sizes:
        points_px, mask = scene(count, side, setting.seed)
        ours = partial(
            silhouette_bce, points_px, np.ones(count, bool), mask, 1.0 - mask, PAPER_SIGMA_SQ
        )
        scatter = differentiated(partial(scattered_loss, mask=tensor(mask)))
        samples = {f"tso, {form}": timed(ours, form) for form in FORMS}
        samples["scatter 9x9, torch"] = timed(partial(scatter, points_px))
        fields = {"points": count, "side": side}
        contestants = [Contestant(name, sample, fields) for name, sample in samples.items()]
        records += setting.race("silhouette", contestants, "over_tso")
    return records


def scene(count: int, side: int, seed: int = 0) -> tuple[Array, Array]:
    """``count`` initial points [N, 2] in the picture of the chair at ``side`` x ``side``, and its mask."""
    (view,) = chair_views()
    box = (-0.5, -0.5, view.camera.width - 0.5, view.camera.height - 0.5)
    mask = area_resize(view.mask, box, side, side)[0].clip(0.0, 1.0)
    return project(cloud(count, seed), view.camera.resized(side, side)).points_px, mask


def scattered_loss(points_px: Tensor, mask: Tensor) -> Tensor:
    """The loss in plain torch: all taps by broadcasting, `index_add`, tanh and torch's cross-entropy.

    It lacks the term for mask pixels that no window reaches, so it has less to do than tso's kernels.
    """
    radius, side = window_radius(PAPER_SIGMA_SQ), mask.shape[-1]
    steps = torch.arange(-radius, radius + 1)
    centre = points_px.detach().round().long()
    column, row = (centre[:, axis : axis + 1] + steps for axis in (0, 1))  # [N, k]
    weights_x, weights_y = (
        torch.exp((points_px[:, axis : axis + 1] - index).square() * (-0.5 / PAPER_SIGMA_SQ))
        * ((index >= 0) & (index < side))
        for axis, index in ((0, column), (1, row))
    )
    taps = weights_y.unsqueeze(2) * weights_x.unsqueeze(1)  # [N, k, k]
    flat = row.clamp(0, side - 1).unsqueeze(2) * side + column.clamp(0, side - 1).unsqueeze(1)
    sums = taps.new_zeros(side * side).index_add(0, flat.flatten(), taps.flatten())
    silhouette = torch.tanh(sums).clamp(1e-6, 1.0 - 1e-6).view_as(mask)
    return torch.nn.functional.binary_cross_entropy(silhouette, mask, reduction="sum")


def measure_chamfer(setting: Setting, sizes: Sequence[int] = CLOUDS) -> Cases:
    """Seconds a step of every contestant at every size, on one thread unless its name says otherwise."""
    records = []
    for count in sizes:
        initial, configs = (
            cloud(count, setting.seed),
            [RefineConfig(preset="paper", steps=steps) for steps in STEPS],
        )
        moved = [refine(initial, chair_views(), config=config).points for config in configs]
        contestants, left_out = [], []
        for name, term in terms(initial).items():
            if isinstance(term, str):
                left_out.append(record("chamfer", name, points=count, left_out=term))
            else:
                contestants.append(
                    Contestant(
                        name, timed(partial(_along, term, moved)), {"points": count}, len(moved)
                    )
                )
        records += [*setting.race("chamfer", contestants, "over_tso"), *left_out]
    return records


def _along(term: Term, iterates: Sequence[Array]) -> None:
    for points in iterates:
        term(points)


def terms(initial: Array) -> dict[str, Term | str]:
    """Contestant -> its Chamfer distance to ``initial`` [N, 3], or why it is left out; tso's compiled loops are first."""
    count, start = len(initial), tensor(initial)
    result: dict[str, Term | str] = {}
    for form, work in FORMS.items():
        with planned(work, work):
            result[f"tso, {form}"] = ChamferToStart(initial)
    result["two k-d trees a step, 1 worker"] = partial(_k_d_trees, initial, None, 1)
    result["two k-d trees a step, all workers"] = partial(_k_d_trees, initial, None, -1)
    result["one k-d tree kept, all queried"] = partial(_k_d_trees, initial, cKDTree(initial), 1)
    result["cdist, torch"] = f"{float(count) ** 2:.1e} pairs held at once"
    if count <= CDIST_UP_TO:
        result["cdist, torch"] = differentiated(lambda moved: _cdist(start, moved))
    return result


def _k_d_trees(
    initial: Array, kept: cKDTree | None, workers: int, moved: Array
) -> tuple[float, Array]:
    """Nearest neighbours of all points, both ways; ``kept`` is the tree of the initial points, else built at each call."""
    to_initial = (kept or cKDTree(initial)).query(moved, workers=workers)[1]
    return paired(initial, moved, to_initial, cKDTree(moved).query(initial, workers=workers)[1])


def _cdist(start: Tensor, moved: Tensor) -> Tensor:
    squared = torch.cdist(start, moved).square()
    return squared.amin(0).mean() + squared.amin(1).mean()


def tensor(values: Array) -> Tensor:
    return torch.as_tensor(values, dtype=torch.float32)


def differentiated(loss: Callable[[Tensor], Tensor]) -> Term:
    """Value and gradient of a loss in torch, at points [N, D]."""

    def term(points: Array) -> tuple[float, Array]:
        leaf = tensor(points).requires_grad_()
        value = loss(leaf).sum()
        return value.item(), torch.autograd.grad(value, leaf)[0].numpy()

    return term


def paired(
    initial: Array, moved: Array, to_initial: NDArray[np.int64], to_moved: NDArray[np.int64]
) -> tuple[float, Array]:
    """The Chamfer distance and its gradient, by each moved point's nearest initial point, [N], and the reverse."""
    ahead, back = moved - initial[to_initial], moved[to_moved] - initial
    gradient = ahead.copy()
    np.add.at(gradient, to_moved, back)
    return float(np.square(ahead).sum() + np.square(back).sum()) / len(moved), (
        2.0 / len(moved)
    ) * gradient
