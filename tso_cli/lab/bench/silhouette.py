"""From projected points to the gradient by them: sums of Gaussians and cross-entropy, forward and backward."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ...kernels.dispatch import triton_runs
from ...kernels.splat import window_radius
from ...silhouette.bce import PixelWeights, mask_loss
from . import peers
from .material import SIGMA_SQ, Projection, projection
from .timing import Setting, Work, gradient, slope

Sizes = Sequence[tuple[int, int]]
WHAT = "silhouette"
SIZES: Sizes = ((256, 32), (1024, 64), (4096, 128), (16384, 256))
LARGE: Sizes = ((65536, 512), (262144, 512), (1_000_000, 1024))
# Cost against the number of points at one size of picture, and against the picture at one number of points.
GROWTH: dict[str, Sizes] = {
    "points": ((1024, 256), (4096, 256), (16384, 256), (65536, 256)),
    "pixels": ((4096, 64), (4096, 128), (4096, 256), (4096, 512)),
}
# The paper's sigma^2 reaches four pixels; a window of seven leaves out what is under 5e-6.
RADII = {"scatter 9x9": 4, "scatter 7x7": 3}
# More is left out: of the exact product a minute's work, of the scatter some gigabytes of taps.
EXACT_LIMIT, TAPS_LIMIT = 1e11, 3e7
# Peers draw the silhouette from the points themselves, projection included. On the CPU the largest would take them minutes.
PEERS_UP_TO = 16384
# Multiply-adds of a tap: forward its weight is added up; backward, the gradient by the sum goes into two derivatives.
FORWARD, BACKWARD = 1, 2


def kernels(device: torch.device) -> list[str]:
    """Those of the program that run on ``device``, the fastest first."""
    if device.type == "cpu":
        return ["compiled", "windowed", "exact"]
    return [*(["triton"] if triton_runs(torch.empty(0, device=device)) else []), "windowed", "exact"]


def too_much(name: str, count: int, side: int) -> str | None:
    """Why a contestant is left out at this size, None where it is not."""
    if name == "exact" and (needed := (FORWARD + BACKWARD) * float(count) * side * side) > EXACT_LIMIT:
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
    """The same loss as one writes it first: every tap by broadcasting, `index_add`, tanh, torch's cross-entropy.

    Nothing pulls pixels that no window reaches, so it has less to do than what it is compared with.
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


def limit(count: int, side: int, radius: int, rates: dict[str, float]) -> dict[str, float]:
    """The least seconds that forward and backward can take here, by what they must do.

    "arithmetic": N (2 r + 1)^2 taps, one multiply-add forward and two backward, over the rate in registers. "scatter": the
    forward taps over the rate of load, multiply-add and store, the others over that in registers. "memory", where the rate of a
    copy is known: the points and their gradient, and four passes over the picture, over that.
    """
    taps = float(count) * (2 * radius + 1) ** 2
    found = {"arithmetic": (FORWARD + BACKWARD) * taps / rates["multiply-add"]}
    if (store := rates.get("load, multiply-add, store")) is not None:
        found["scatter"] = FORWARD * taps / store + BACKWARD * taps / rates["multiply-add"]
    if (copied := rates.get("copy")) is not None:
        found["memory"] = (4.0 * 4 * count + 4.0 * 4 * side * side) / copied
    return found


def measure(setting: Setting, rates: dict[str, float], sizes: Sizes | None = None) -> list[dict[str, Any]]:
    """Every contestant at every size, the limits beside them (their seconds are computed, and so have no runs)."""
    records: list[dict[str, Any]] = []
    absent: set[str] = set()
    if sizes is None:
        sizes = (*SIZES, *LARGE) if setting.full else SIZES
    for count, side in sizes:
        setting.report(f"silhouette {count:,}@{side}")
        scene = projection(count, side, setting.device, setting.seed)
        at: dict[str, Any] = {"points": count, "side": side}
        names = [*kernels(setting.device), *RADII]
        reasons = {name: reason for name in names if (reason := too_much(name, count, side))}
        contestants = {name: work(name, scene) for name in names if name not in reasons}
        for name, make in peers.splatters(scene).items() if count <= PEERS_UP_TO else ():
            made = make()
            if isinstance(made, str):
                reasons[name] = made
            else:
                contestants[name] = gradient(made, scene.points)
        timings = setting.race(contestants)
        limits = limit(count, side, window_radius(SIGMA_SQ), rates)
        own = timings[names[0]].median
        records += [
            setting.record(
                WHAT, name, timing, **at, over_tso=timing.median / own, over_limit=timing.median / max(limits.values())
            )
            for name, timing in timings.items()
        ]
        absent |= {name for name, reason in reasons.items() if reason == peers.NOT_INSTALLED}
        records += [setting.record(WHAT, name, **at, left_out=reasons[name]) for name in reasons if name not in absent]
        records += [
            setting.record("limit", name, **at, seconds={"median": value, "low": value, "high": value})
            for name, value in limits.items()
        ]
    return records + [setting.record(WHAT, name, left_out=peers.NOT_INSTALLED) for name in sorted(absent)]


def growth(setting: Setting, growing: dict[str, Sizes] | None = None) -> list[dict[str, Any]]:
    """The fastest kernel at growing sizes, and the slope of its cost in log-log against points, and against pixels.

    "slope" is that of the straight line through all sizes, "steepest" that between two neighbouring ones.
    """
    kernel = kernels(setting.device)[0]
    records = []
    for by, sizes in (GROWTH if growing is None else growing).items():
        setting.report(f"silhouette against {by}")
        scenes = {size: projection(*size, setting.device, setting.seed) for size in sizes}
        timings = setting.race({f"{n}@{side}": work(kernel, scene) for (n, side), scene in scenes.items()})
        medians = [timing.median for timing in timings.values()]
        grown = [n if by == "points" else side * side for n, side in sizes]
        slopes = {
            "slope": slope(grown, medians),
            "steepest": max(slope(grown[i : i + 2], medians[i : i + 2]) for i in range(len(grown) - 1)),
        }
        records += [
            setting.record(f"growth, {by}", kernel, timing, points=n, side=side, **slopes)
            for (n, side), timing in zip(sizes, timings.values(), strict=True)
        ]
    return records
