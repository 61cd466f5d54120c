"""The silhouette loss from projected points, value and gradient: sums of Gaussians and cross-entropy."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import torch
from torch import Tensor

from ...geometry.resampling import area_resize
from ...kernels.window import window_radius
from ...losses.projection import project
from ...losses.silhouette import silhouette_bce
from ...refinement.optimise import Array
from ...refinement.presets import PAPER_SIGMA_SQ
from . import peers
from .material import chair_views, cloud
from .timing import FORMS, Records, Sample, Setting, timed

Sizes = Sequence[tuple[int, int]]
SIZES: Sizes = ((256, 32), (1024, 64), (4096, 128), (16384, 256))
LARGE: Sizes = ((65536, 512), (262144, 512))
SCATTER = "scatter 9x9, torch"
# The matrix product of numpy holds a number for each point and column, the scatter one for each point and pixel of its window.
MOST_NUMBERS = {"tso, numpy": 5e7, SCATTER: 3e7}


def measure(setting: Setting, sizes: Sizes = ()) -> Records:
    """Seconds of every contestant at every size, on one thread."""
    records = []
    for count, side in sizes or ((*SIZES, *LARGE) if setting.full else SIZES):
        samples = contestants(*scene(count, side, setting.seed))
        records += peers.race(setting, "silhouette", samples, points=count, side=side)
    return records


def contestants(points_px: Array, mask: Array) -> dict[str, Sample | str]:
    """Name -> its loss of points [N, 2] and a mask [H, W], or why it is left out; tso's compiled loops are first."""
    count, side = len(points_px), mask.shape[-1]
    ours = partial(silhouette_bce, points_px, np.ones(count, bool), mask, 1.0 - mask, PAPER_SIGMA_SQ)
    scatter = peers.differentiated(partial(scattered_loss, mask=peers.tensor(mask)))
    samples: dict[str, Sample | str] = {f"tso, {form}": timed(ours, form) for form in FORMS}
    samples[SCATTER] = timed(partial(scatter, points_px))
    numbers = {"tso, numpy": float(count * side), SCATTER: count * (2.0 * window_radius(PAPER_SIGMA_SQ) + 1.0) ** 2}
    held = {name: number for name, number in numbers.items() if number > MOST_NUMBERS[name]}
    return samples | {name: f"{number:.1e} numbers held at once" for name, number in held.items()}


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
        torch.exp((points_px[:, axis : axis + 1] - index).square() * (-0.5 / PAPER_SIGMA_SQ)) * ((index >= 0) & (index < side))
        for axis, index in ((0, column), (1, row))
    )
    taps = weights_y.unsqueeze(2) * weights_x.unsqueeze(1)  # [N, k, k]
    flat = row.clamp(0, side - 1).unsqueeze(2) * side + column.clamp(0, side - 1).unsqueeze(1)
    sums = taps.new_zeros(side * side).index_add(0, flat.flatten(), taps.flatten())
    silhouette = torch.tanh(sums).clamp(1e-6, 1.0 - 1e-6).view_as(mask)
    return torch.nn.functional.binary_cross_entropy(silhouette, mask, reduction="sum")
