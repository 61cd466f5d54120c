"""Where the time of the compiled silhouette goes: its stages, measured alone."""

from __future__ import annotations

from typing import Any

import torch

from ...kernels.jit import PrecomputedGradient
from ...kernels.losses_numba import cross_entropy, pixels_to_points
from ...kernels.splat import NEGLIGIBLE, splat
from ...silhouette.bce import PixelWeights, mask_loss
from .material import SIGMA_SQ, Projection, projection
from .silhouette import Sizes
from .timing import Setting, Work, gradient

WHAT = "profile"
SIZES: Sizes = ((1024, 64), (16384, 256))


def measure(setting: Setting, sizes: Sizes = SIZES) -> list[dict[str, Any]]:
    """The whole, its stages, and an empty function of torch's autograd; nothing where the compiled loops do not run.

    Stages that are called alone have a call's fixed cost each, so together they are more than the whole.
    """
    if setting.device.type != "cpu":
        return []
    records = []
    for count, side in sizes:
        setting.report(f"profile of the silhouette {count:,}@{side}")
        timings = setting.race(_stages(projection(count, side, setting.device, setting.seed)))
        whole = timings["whole"].median
        records += [
            setting.record(WHAT, name, timing, points=count, side=side, share=timing.median / whole)
            for name, timing in timings.items()
        ]
    return records


def _stages(scene: Projection) -> dict[str, Work]:
    target, side = PixelWeights.of(scene.mask), scene.side
    points_px, valid = scene.points_px, scene.valid
    leaf = points_px.detach().clone().requires_grad_()
    drawn = splat(leaf, valid, side, side, SIGMA_SQ, "compiled")
    sums, ones = drawn.detach(), torch.ones_like(drawn)
    waiting = (sums <= NEGLIGIBLE) & (target.foreground > 0.0)
    return {
        "whole": gradient(lambda p: mask_loss(p, valid, target, SIGMA_SQ, "compiled"), points_px),
        "sums": lambda: splat(points_px, valid, side, side, SIGMA_SQ, "compiled"),
        "cross-entropy": lambda: cross_entropy(sums, *target, NEGLIGIBLE),
        "far pixels": lambda: pixels_to_points(waiting, target.foreground, points_px, valid, 1.0),
        "back to the points": lambda: torch.autograd.grad(drawn, leaf, ones, retain_graph=True),
        "empty function": gradient(lambda p: PrecomputedGradient.apply(p, p.new_zeros(1), points_px), points_px),
    }
