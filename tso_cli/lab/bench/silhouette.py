"""The silhouette loss from projected points, forward and backward: sums of Gaussians and cross-entropy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ...kernels.dispatch import triton_runs
from ...silhouette.bce import PixelWeights, mask_loss
from .material import SIGMA_SQ, Projection, projection
from .timing import Setting, Work, gradient

Sizes = Sequence[tuple[int, int]]
SIZES: Sizes = ((256, 32), (1024, 64), (4096, 128), (16384, 256))
LARGE: Sizes = ((65536, 512), (262144, 512), (1_000_000, 1024))
# The paper's sigma^2 reaches four pixels; a window of 7x7 drops weights below 5e-6.
RADII = {"scatter 9x9": 4, "scatter 7x7": 3}
# Beyond these the exact product takes a minute and the scatter some gigabytes.
EXACT_LIMIT, TAPS_LIMIT = 1e11, 3e7


def kernels(device: torch.device) -> list[str]:
    """tso's kernels for ``device``, the fastest first."""
    if device.type == "cpu":
        return ["compiled", "windowed", "exact"]
    return [*(["triton"] if triton_runs(torch.empty(0, device=device)) else []), "windowed", "exact"]


def too_much(name: str, count: int, side: int) -> str | None:
    """Why a contestant is left out at this size, None where it is not."""
    # One multiply-add for each point and pixel forward, two backward.
    if name == "exact" and (needed := 3.0 * count * side * side) > EXACT_LIMIT:
        return f"{needed:.1e} multiply-adds"
    if name in RADII and (taps := float(count) * (2 * RADII[name] + 1) ** 2) > TAPS_LIMIT:
        return f"{taps:.1e} taps, about {50 * taps / 2**30:.0f} GiB"
    return None


def work(name: str, scene: Projection) -> Work:
    """Forward and backward of one contestant."""
    if name in RADII:
        return gradient(lambda points_px: scattered_loss(points_px, scene.mask, RADII[name]), scene.points_px)
    target = PixelWeights.of(scene.mask)
    return gradient(lambda points_px: mask_loss(points_px, scene.valid, target, SIGMA_SQ, name), scene.points_px)


def scattered_loss(points_px: Tensor, mask: Tensor, radius: int) -> Tensor:
    """The loss in plain torch: all taps by broadcasting, `index_add`, tanh and torch's cross-entropy.

    It lacks the term for mask pixels that no window reaches, so it has less to do than tso's kernels.
    """
    side = mask.shape[-1]
    steps = torch.arange(-radius, radius + 1, device=points_px.device)
    centre = points_px[0].detach().round().long()
    column, row = (centre[:, axis : axis + 1] + steps for axis in (0, 1))  # [N, k]
    weights_x, weights_y = (
        torch.exp((points_px[0, :, axis : axis + 1] - index).square() * (-0.5 / SIGMA_SQ)) * ((index >= 0) & (index < side))
        for axis, index in ((0, column), (1, row))
    )
    taps = weights_y.unsqueeze(2) * weights_x.unsqueeze(1)  # [N, k, k]
    flat = row.clamp(0, side - 1).unsqueeze(2) * side + column.clamp(0, side - 1).unsqueeze(1)
    sums = taps.new_zeros(side * side).index_add(0, flat.flatten(), taps.flatten())
    silhouette = torch.tanh(sums).clamp(1e-6, 1.0 - 1e-6).view_as(mask)
    return torch.nn.functional.binary_cross_entropy(silhouette, mask, reduction="sum")


def measure(setting: Setting, sizes: Sizes | None = None) -> list[dict[str, Any]]:
    """Seconds of every contestant at every size."""
    records: list[dict[str, Any]] = []
    for count, side in sizes or ((*SIZES, *LARGE) if setting.full else SIZES):
        setting.report(f"silhouette {count:,}@{side}")
        scene = projection(count, side, setting.device, setting.seed)
        works = {name: too_much(name, count, side) or work(name, scene) for name in (*kernels(setting.device), *RADII)}
        timings = setting.race({name: work for name, work in works.items() if not isinstance(work, str)})
        records += setting.records("silhouette", timings, "over_tso", points=count, side=side)
        records += setting.left_out("silhouette", works, points=count, side=side)
    return records
