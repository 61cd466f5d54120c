"""The parts of a refinement: each loss, one step of a network, many clouds in one call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ...errors import TsoError
from ...network.model import build_network
from ...refinement import PRESETS, RefineConfig, refine, refine_batch
from ...refinement.adam import Adam
from ...refinement.parameters import NetworkParameters
from ...refinement.presets import PAPER_GAMMA, PAPER_LEARNING_RATE
from ...silhouette.affinity import affinity
from ...silhouette.bce import UNCOVERED, silhouette_bce
from ...silhouette.chamfer import ChamferToInitial
from ...silhouette.projection import project, silhouette_sums
from .material import SIGMA_SQ, chair_view, cloud, mask_objective, projection, trajectory
from .timing import Setting, Work, gradient

BATCHES, LARGE_BATCHES = (1, 4, 16), (64, 256, 1024)
# Losses are measured halfway through a refinement; steps of a network once its cloud has left the initial one.
HALFWAY, NETWORK_HALFWAY = 25, 5


def terms(setting: Setting, count: int, side: int) -> list[dict[str, Any]]:
    """Value and gradient of each loss beside the projector's: from points to the sums of the silhouette, and back."""
    setting.report(f"terms {count:,}@{side}")
    scene = projection(count, side, setting.device, setting.seed)
    iterates = trajectory(count, setting.device, setting.seed, HALFWAY)
    mask, valid = scene.mask, scene.valid

    def projector(points: Tensor) -> Tensor:
        return silhouette_sums(project(points, scene.cameras), scene.cameras, SIGMA_SQ)

    with torch.no_grad():
        sums = projector(scene.points)[:, 0]
    # The mask without the pixels that no point covers.
    covered = mask * (sums > UNCOVERED)

    def by_sums_and_points(loss: Callable[[Tensor, Tensor], Tensor]) -> Work:
        leaves = [values.clone().requires_grad_() for values in (sums, scene.points_px)]
        return lambda: torch.autograd.grad(loss(*leaves).sum(), leaves, allow_unused=True)

    timings = setting.race(
        {
            "projector": gradient(projector, scene.points),
            "cross-entropy and far pixels": by_sums_and_points(lambda s, p: silhouette_bce(s, mask, p, valid, SIGMA_SQ)),
            "cross-entropy alone": by_sums_and_points(lambda s, p: silhouette_bce(s, covered, p, valid, SIGMA_SQ)),
            "affinity, points": by_sums_and_points(lambda s, p: affinity(s, mask, p, valid, "points")),
            "affinity, paper": by_sums_and_points(lambda s, p: affinity(s, mask, p, valid, "paper")),
            "Chamfer to the start": gradient(ChamferToInitial(iterates[0]), iterates[-1]),
        }
    )
    return setting.records("terms", timings, "over_projector", points=count, side=side)


def network_step(setting: Setting, mode: str) -> list[dict[str, Any]]:
    """One step of a network mode beside forward, backward and Adam of the bare network."""
    setting.report(f"step, {mode}")
    image = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(setting.seed))
    network = build_network(seed=setting.seed)
    bare, whole = (NetworkParameters(network, image, mode, setting.device) for _ in range(2))
    with torch.no_grad():
        initial = whole.forward()
    mask_term, chamfer, gamma = mask_objective(initial), ChamferToInitial(initial), PAPER_GAMMA[mode]

    def step(optimiser: Adam) -> None:
        points = whole.forward()
        loss = mask_term(points)
        optimiser.step((loss + gamma * chamfer(points) if gamma else loss).sum())

    moving = Adam(whole.parameters, PAPER_LEARNING_RATE[mode])
    for _ in range(NETWORK_HALFWAY):
        step(moving)
    bare_optimiser, optimiser = Adam(bare.parameters, 0.0), Adam(whole.parameters, 0.0)
    timings = setting.race(
        {"bare network": lambda: bare_optimiser.step(bare.forward().sum()), "whole step": lambda: step(optimiser)}
    )
    added = timings["whole step"].median / timings["bare network"].median - 1.0
    fields = {"points": initial.shape[1], "side": 64, "precision": "float32", "added": added}
    return [setting.record(f"step, {mode}", name, timing, **fields) for name, timing in timings.items()]


def batch(
    setting: Setting, batches: Sequence[int] | None = None, count: int = 1024, steps: int | None = None
) -> list[dict[str, Any]]:
    """Seconds a cloud, and clouds a second, of `refine` and of `refine_batch` on growing batches."""
    batches = batches or ((*BATCHES, *LARGE_BATCHES) if setting.device.type == "cuda" else BATCHES)
    view, records = chair_view(256), []

    def refine_all(config: RefineConfig, size: int) -> None:
        for result in refine_batch([(cloud(count, setting.seed + i), view) for i in range(size)], config):
            if isinstance(result, TsoError):
                raise result

    for preset in PRESETS:
        setting.report(f"{preset}: batches of {batches[0]} to {batches[-1]}")
        config = RefineConfig(steps=steps, device=str(setting.device), seed=setting.seed, preset=preset)
        alone = partial(refine, cloud(count, setting.seed), view, config=config)
        works = {str(size): partial(refine_all, config, size) for size in batches}
        for name, timing in setting.race({"refine": alone, **works}).items():
            size = 1 if name == "refine" else int(name)
            each = timing.scaled(1.0 / size)
            if name == "refine":
                seconds = each.median
            fields = {"points": count, "side": 256, "batch": size, "preset": preset}
            fields |= {"clouds_per_second": 1.0 / each.median, "times_refine": seconds / each.median}
            records.append(setting.record("batch", "refine" if name == "refine" else "refine_batch", each, **fields))
    return records
