"""The parts of a refinement: each term beside the projector, one step taken apart, many clouds in one call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ... import device as devices
from ...errors import TsoError
from ...network.model import build_network
from ...refinement import PRESETS, RefineConfig, refine, refine_batch
from ...refinement.adam import Adam
from ...refinement.api import SMALL_CLOUD
from ...refinement.config import PAPER_GAMMA, PAPER_LEARNING_RATE
from ...refinement.parameters import NetworkParameters
from ...silhouette.affinity import affinity
from ...silhouette.bce import UNCOVERED, PixelWeights, mask_loss, silhouette_bce
from ...silhouette.chamfer import ChamferToInitial
from ...silhouette.projection import project, silhouette_sums
from .material import SIGMA_SQ, chair_view, cloud, mask_objective, projection, trajectory
from .timing import Setting, Work, gradient

Sizes = Sequence[tuple[int, int]]
TERM_SIZES: Sizes = ((1024, 64), (16384, 256))
STEP_SIZES = (1024, 16384)
BATCHES, LARGE_BATCHES = (1, 4, 16), (64, 256, 1024)
# Half of a refinement is behind the cloud whose step is measured.
HALFWAY = 25
# Steps of a network before its step is measured: its cloud has left the start.
NETWORK_HALFWAY = 5


def terms(setting: Setting, sizes: Sizes = TERM_SIZES) -> list[dict[str, Any]]:
    """Value and gradient of each term beside the projector: from points to the sums of the silhouette, and back."""
    return [record for size in sizes for record in _terms_at(setting, *size)]


def _terms_at(setting: Setting, count: int, side: int) -> list[dict[str, Any]]:
    setting.report(f"terms {count:,}@{side}")
    scene = projection(count, side, setting.device, setting.seed)
    iterate = trajectory(count, setting.device, setting.seed, HALFWAY)
    chamfer = ChamferToInitial(iterate[0])

    def projector(points: Tensor) -> Tensor:
        return silhouette_sums(project(points, scene.cameras), scene.cameras, SIGMA_SQ)

    with torch.no_grad():
        sums = projector(scene.points)[:, 0]
    # The same picture without the mask pixels that wait for a point.
    covered = scene.mask * (sums > UNCOVERED)

    def drawn(loss: Callable[[Tensor, Tensor], Tensor]) -> Work:
        """Value of a loss of sums and projected points, and its derivatives."""
        leaves = [values.clone().requires_grad_() for values in (sums, scene.points_px)]

        def work() -> None:
            torch.autograd.grad(loss(*leaves).sum(), leaves, allow_unused=True)

        return work

    timings = setting.race(
        {
            "projector": gradient(projector, scene.points),
            "cross-entropy and pull": drawn(lambda s, p: silhouette_bce(s, scene.mask, p, scene.valid, SIGMA_SQ)),
            "cross-entropy alone": drawn(lambda s, p: silhouette_bce(s, covered, p, scene.valid, SIGMA_SQ)),
            "affinity, points": drawn(lambda s, p: affinity(s, scene.mask, p, scene.valid, "points")),
            "affinity, paper": drawn(lambda s, p: affinity(s, scene.mask, p, scene.valid, "paper")),
            "Chamfer to the start": gradient(chamfer, iterate[-1]),
        }
    )
    own = timings["projector"].median
    return [
        setting.record("terms", name, timing, points=count, side=side, over_projector=timing.median / own)
        for name, timing in timings.items()
    ]


def points_step(setting: Setting, sizes: Sequence[int] = STEP_SIZES) -> list[dict[str, Any]]:
    """One step of points mode at the working resolution of `tso refine`, halfway through, and the parts it is made of.

    The learning rate is 0, so that every step that is measured is the same one.
    """
    return [record for count in sizes for record in _points_step_at(setting, count)]


def _points_step_at(setting: Setting, count: int) -> list[dict[str, Any]]:
    setting.report(f"step {count:,}")
    iterate = trajectory(count, setting.device, setting.seed, HALFWAY)
    moving = iterate[-1].clone().requires_grad_()
    mask_term, chamfer, optimiser = mask_objective(moving), ChamferToInitial(iterate[0]), Adam([moving], 0.0)
    (view,) = mask_term.views
    points_px, valid = (part[:, 0].detach() for part in project(moving, view.cameras))
    leaf, pull = moving.detach().clone().requires_grad_(), torch.ones_like(moving)
    alone = Adam([leaf], 0.0)

    def step() -> None:
        loss = mask_term(moving) + PAPER_GAMMA["points"] * chamfer(moving)
        optimiser.step(loss.sum())

    target = PixelWeights.of(view.mask, view.known)

    def masked(points_px: Tensor) -> Tensor:
        return mask_loss(points_px, valid, target, view.sigma_sq)

    with devices.one_thread(count <= SMALL_CLOUD):
        timings = setting.race(
            {
                "whole step": step,
                "projection": gradient(lambda points: project(points, view.cameras).points_px, moving),
                "sums and cross-entropy": gradient(masked, points_px),
                "Chamfer to the start": gradient(chamfer, moving),
                "Adam": lambda: alone.step((leaf * pull).sum()),
            }
        )
    whole = timings["whole step"].median
    return [
        setting.record("step", name, timing, points=count, side=view.cameras.width, share=timing.median / whole)
        for name, timing in timings.items()
    ]


def network_steps(setting: Setting) -> list[dict[str, Any]]:
    """One step of each network mode beside the bare network's: forward, backward and Adam, nothing asked of the cloud."""
    return [record for mode in ("encoder", "encoder-decoder") for record in _network_step(setting, mode)]


def _network_step(setting: Setting, mode: str) -> list[dict[str, Any]]:
    setting.report(f"step, {mode}")
    image = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(setting.seed))
    network = build_network(seed=setting.seed)
    bare_start, start = (NetworkParameters(network, image, mode, setting.device) for _ in range(2))
    with torch.no_grad():
        initial = start.forward()
    mask_term, gamma = mask_objective(initial), PAPER_GAMMA[mode]
    chamfer = ChamferToInitial(initial)

    def whole(optimiser: Adam) -> None:
        moved = start.forward()
        loss = mask_term(moved)
        if gamma:
            loss = loss + gamma * chamfer(moved)
        optimiser.step(loss.sum())

    moving = Adam(start.parameters, PAPER_LEARNING_RATE[mode])
    for _ in range(NETWORK_HALFWAY):
        whole(moving)
    bare_still, still = Adam(bare_start.parameters, 0.0), Adam(start.parameters, 0.0)
    timings = setting.race(
        {"bare network": lambda: bare_still.step(bare_start.forward().sum()), "whole step": lambda: whole(still)}
    )
    added = timings["whole step"].median / timings["bare network"].median - 1.0
    return setting.records(f"step, {mode}", timings, points=initial.shape[1], side=64, precision="float32", added=added)


def batch(
    setting: Setting, batches: Sequence[int] | None = None, count: int = 1024, steps: int | None = None
) -> list[dict[str, Any]]:
    """Seconds a cloud, and clouds a second, of `refine` called once a cloud and of `refine_batch` on more and more clouds."""
    if batches is None:
        batches = (*BATCHES, *LARGE_BATCHES) if setting.device.type == "cuda" else BATCHES
    one, view = cloud(count, setting.seed), chair_view(256)
    records = []
    for preset in PRESETS:
        config = RefineConfig(steps=steps, device=str(setting.device), seed=setting.seed, preset=preset)
        together = {str(size): many_clouds(setting, size, count, steps, preset) for size in batches}
        setting.report(f"{preset}: batches of {batches[0]} to {batches[-1]}")
        timings = setting.race({"refine": partial(refine, one, view, config=config)} | together)
        alone = timings["refine"].median
        for name, timing in timings.items():
            size = 1 if name == "refine" else int(name)
            each = timing.scaled(1.0 / size)
            records.append(
                setting.record(
                    "batch",
                    "refine" if name == "refine" else "refine_batch",
                    each,
                    points=count,
                    side=view.camera.width,
                    batch=size,
                    preset=preset,
                    clouds_per_second=1.0 / each.median,
                    times_refine=alone / each.median,
                )
            )
    return records


def many_clouds(setting: Setting, size: int, count: int = 1024, steps: int | None = None, preset: str = "paper") -> Work:
    """One call of `refine_batch` on ``size`` clouds of ``count`` points, all in the picture of the chair."""
    config = RefineConfig(steps=steps, device=str(setting.device), seed=setting.seed, preset=preset)
    view = chair_view(256)
    scenes = [(cloud(count, setting.seed + i), view) for i in range(size)]

    def work() -> None:
        for result in refine_batch(scenes, config):
            if isinstance(result, TsoError):
                raise result

    return work
