"""The parts of a refinement and of training: each loss, one step, many clouds in one call, more threads."""

from __future__ import annotations

import os
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
from ...silhouette.bce import UNCOVERED, PixelWeights, mask_loss, silhouette_bce
from ...silhouette.chamfer import ChamferToInitial
from ...silhouette.projection import project, silhouette_sums
from ...train.config import PRECISIONS, TrainConfig
from ...train.loop import start
from ...train.sources import shipped_examples
from ...train.speed import ROUNDS, images_per_second
from . import silhouette
from .material import SIGMA_SQ, chair_view, cloud, mask_objective, projection, trajectory
from .timing import Setting, Work, gradient, threads

BATCHES, LARGE_BATCHES = (1, 4, 16), (64, 256, 1024)
THREADED_SIZE, THREADED_CLOUDS = (65536, 512), 64
# A step is measured halfway through a refinement; of a network, once its cloud has left the initial one.
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


def points_step(setting: Setting, count: int) -> list[dict[str, Any]]:
    """One step of points mode at the working resolution of `tso refine`, and its parts.

    The learning rate is 0: every measured step is the same one.
    """
    setting.report(f"step {count:,}")
    iterates = trajectory(count, setting.device, setting.seed, HALFWAY)
    moving, leaf = (iterates[-1].clone().requires_grad_() for _ in range(2))
    mask_term, chamfer = mask_objective(moving), ChamferToInitial(iterates[0])
    optimiser, adam = Adam([moving], 0.0), Adam([leaf], 0.0)
    (view,) = mask_term.views
    points_px, valid = (part[:, 0].detach() for part in project(moving, view.cameras))
    target, slope = PixelWeights.of(view.mask, view.known), torch.ones_like(leaf)
    timings = setting.race(
        {
            "whole step": lambda: optimiser.step((mask_term(moving) + PAPER_GAMMA["points"] * chamfer(moving)).sum()),
            "projection": gradient(lambda points: project(points, view.cameras).points_px, moving),
            "sums and cross-entropy": gradient(lambda p: mask_loss(p, valid, target, view.sigma_sq), points_px),
            "Chamfer to the start": gradient(chamfer, moving),
            "Adam": lambda: adam.step((leaf * slope).sum()),
        }
    )
    return setting.records("step", timings, "share", points=count, side=view.cameras.width)


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
    records = []
    for preset in PRESETS:
        setting.report(f"{preset}: batches of {batches[0]} to {batches[-1]}")
        config = RefineConfig(steps=steps, device=str(setting.device), seed=setting.seed, preset=preset)
        alone = partial(refine, cloud(count, setting.seed), chair_view(256), config=config)
        works = {str(size): _many_clouds(config, size, count) for size in batches}
        for name, timing in setting.race({"refine": alone, **works}).items():
            size = 1 if name == "refine" else int(name)
            each = timing.scaled(1.0 / size)
            if name == "refine":
                seconds = each.median
            fields = {"points": count, "side": 256, "batch": size, "preset": preset}
            fields |= {"clouds_per_second": 1.0 / each.median, "times_refine": seconds / each.median}
            records.append(setting.record("batch", "refine" if name == "refine" else "refine_batch", each, **fields))
    return records


def _many_clouds(config: RefineConfig, size: int, count: int) -> Work:
    """One call of `refine_batch` on ``size`` clouds of ``count`` points, all in the picture of the chair."""
    view = chair_view(256)
    scenes = [(cloud(count, config.seed + i), view) for i in range(size)]

    def work() -> None:
        for result in refine_batch(scenes, config):
            if isinstance(result, TsoError):
                raise result

    return work


def more_threads(
    setting: Setting,
    size: tuple[int, int] = THREADED_SIZE,
    clouds: int = THREADED_CLOUDS,
    most: int = os.cpu_count() or 1,
    steps: int | None = None,
) -> list[dict[str, Any]]:
    """A large cloud's silhouette and Chamfer distance, and a batch of clouds, on one CPU thread and on ``most``."""
    if setting.device.type != "cpu":
        return []
    counts = sorted({1, most})
    setting.report(f"threads {', '.join(map(str, counts))}")
    count, side = size
    kernel = silhouette.kernels(setting.device)[0]
    iterates = trajectory(count, setting.device, setting.seed, HALFWAY)
    config = RefineConfig(steps=steps, device="cpu", seed=setting.seed, preset="paper")
    scene = projection(count, side, setting.device, setting.seed)
    works: dict[str, tuple[Work, dict[str, int]]] = {
        f"silhouette, {kernel}": (silhouette.work(kernel, scene), {"points": count, "side": side}),
        "Chamfer to the start": (gradient(ChamferToInitial(iterates[0]), iterates[-1]), {"points": count}),
        f"refine_batch of {clouds}": (_many_clouds(config, clouds, 1024), {"points": 1024, "side": 256, "batch": clouds}),
    }
    records = []
    for name, (work, fields) in works.items():
        timings = setting.race({str(number): threads(number)(work) for number in counts})
        for number, timing in timings.items():
            over_first = timings["1"].median / timing.median
            records.append(setting.record("threads", name, timing, **fields, threads=int(number), over_first=over_first))
    return records


def training_steps(setting: Setting, batch: int = 16) -> list[dict[str, Any]]:
    """Images a second of a step and of the bare network, by supervision and precision, on the shipped examples.

    "waiting" is the share of a step in which the network waits for its batch; see `images_per_second`.
    """
    data = shipped_examples()
    records = []
    for supervision in ("points", "masks"):
        for precision in PRECISIONS:
            setting.report(f"training on {supervision}, {precision}")
            config = TrainConfig(
                supervision=supervision, batch_size=batch, precision=precision, seed=setting.seed, device=str(setting.device)
            )
            speed = images_per_second(start(data, config), config, data)
            for name, key in (("bare network", "bare"), ("step", "step")):
                fields: dict[str, Any] = {"points": config.points, "side": 64, "batch": batch, "precision": precision}
                fields |= {"images_per_second": speed[key], "added": speed["added"], "waiting": speed["waiting"]}
                seconds = {"median": batch / speed[key], "low": None, "high": None}
                records.append(setting.record(f"training, {supervision}", name, **fields, seconds=seconds, runs=ROUNDS))
    return records
