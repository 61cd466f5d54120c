"""The parts of a refinement: each term beside the projector, one step taken apart, many clouds in one call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .. import device as devices
from ..adam import Adam
from ..errors import TsoError
from ..losses import UNCOVERED, ChamferToInitial, PixelWeights, affinity, mask_loss, silhouette_bce
from ..network import build_network
from ..projection import project, silhouette_sums
from ..refinement import RefineConfig, refine, refine_batch
from ..refinement.config import PAPER_GAMMA, PAPER_LEARNING_RATE
from ..refinement.run import SMALL_CLOUD
from ..refinement.starts import NetworkStart
from .material import SIGMA_SQ, chair_view, cloud, mask_objective, projection, trajectory
from .timing import Setting, Work, gradient

Sizes = Sequence[tuple[int, int]]
TERM_SIZES: Sizes = ((1024, 64), (16384, 256))
STEP_SIZES = (1024, 16384)
BATCHES, LARGE_BATCHES = (1, 4, 16, 64), (256, 1024)
# Half of a refinement is behind the cloud whose step is measured.
HALFWAY = 25
# Steps of a network before its step is measured: its cloud has left the start.
NETWORK_HALFWAY = 5


def terms(setting: Setting, sizes: Sizes = TERM_SIZES) -> list[dict[str, Any]]:
    """Value and gradient of each term beside the projector: from points to the sums of the silhouette, and back."""
    records = []
    for count, side in sizes:
        setting.report(f"terms {count:,}@{side}")
        scene = projection(count, side, setting.device, setting.seed)
        iterate = trajectory(count, setting.device, setting.seed, HALFWAY)
        chamfer = ChamferToInitial(iterate[0])
        with torch.no_grad():
            sums = silhouette_sums(project(scene.points, scene.cameras), scene.cameras, SIGMA_SQ)[:, 0]
        # The same picture without the mask pixels that wait for a point.
        covered = scene.mask * (sums > UNCOVERED)

        def projector(points: Tensor) -> Tensor:
            return silhouette_sums(project(points, scene.cameras), scene.cameras, SIGMA_SQ)  # noqa: B023

        def entropy(mask: Tensor) -> Work:
            leaf, points_px = sums.clone().requires_grad_(), scene.points_px.clone().requires_grad_()  # noqa: B023

            def work() -> None:
                loss = silhouette_bce(leaf, mask, points_px, scene.valid, SIGMA_SQ)  # noqa: B023
                torch.autograd.grad(loss.sum(), [leaf, points_px], allow_unused=True)

            return work

        def drawn(form: str) -> Work:
            leaf, points_px = sums.clone().requires_grad_(), scene.points_px.clone().requires_grad_()  # noqa: B023

            def work() -> None:
                loss = affinity(leaf, scene.mask, points_px, scene.valid, form)  # noqa: B023
                torch.autograd.grad(loss.sum(), [leaf, points_px], allow_unused=True)

            return work

        timings = setting.race(
            {
                "projector": gradient(projector, scene.points),
                "cross-entropy and pull": entropy(scene.mask),
                "cross-entropy alone": entropy(covered),
                "affinity, points": drawn("points"),
                "affinity, paper": drawn("paper"),
                "Chamfer to the start": gradient(chamfer, iterate[-1]),
            }
        )
        own = timings["projector"].median
        records += [
            setting.record("terms", name, timing, points=count, side=side, over_projector=timing.median / own)
            for name, timing in timings.items()
        ]
    return records


def points_step(setting: Setting, sizes: Sequence[int] = STEP_SIZES) -> list[dict[str, Any]]:
    """One step of points mode at the working resolution of `tso refine`, halfway through, and the parts it is made of.

    The learning rate is 0, so that every step that is measured is the same one.
    """
    records = []
    for count in sizes:
        setting.report(f"step {count:,}")
        iterate = trajectory(count, setting.device, setting.seed, HALFWAY)
        moving = iterate[-1].clone().requires_grad_()
        mask_term, chamfer, optimiser = mask_objective(moving), ChamferToInitial(iterate[0]), Adam([moving], 0.0)
        (view,) = mask_term.views
        points_px, valid = (part[:, 0].detach() for part in project(moving, view.cameras))
        target = PixelWeights.of(view.mask, view.known)
        leaf, pull = moving.detach().clone().requires_grad_(), torch.ones_like(moving)
        alone = Adam([leaf], 0.0)

        def step() -> None:
            loss = mask_term(moving) + PAPER_GAMMA["points"] * chamfer(moving)  # noqa: B023
            optimiser.step(loss.sum())  # noqa: B023

        def masked(points_px: Tensor) -> Tensor:
            return mask_loss(points_px, valid, target, view.sigma_sq)  # noqa: B023

        with devices.one_thread(count <= SMALL_CLOUD):
            timings = setting.race(
                {
                    "whole step": step,
                    "projection": gradient(lambda points: project(points, view.cameras).points_px, moving),  # noqa: B023
                    "sums and cross-entropy": gradient(masked, points_px),
                    "Chamfer to the start": gradient(chamfer, moving),
                    "Adam": lambda: alone.step((leaf * pull).sum()),  # noqa: B023
                }
            )
        whole = timings["whole step"].median
        records += [
            setting.record("step", name, timing, points=count, side=view.cameras.width, share=timing.median / whole)
            for name, timing in timings.items()
        ]
    return records


def network_steps(setting: Setting) -> list[dict[str, Any]]:
    """One step of each network mode beside the bare network's: forward, backward and Adam, nothing asked of the cloud."""
    image = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(setting.seed))
    records = []
    for mode in ("encoder", "encoder-decoder"):
        setting.report(f"step, {mode}")
        network = build_network(seed=setting.seed)
        bare_start, start = (NetworkStart(network, image, mode, setting.device) for _ in range(2))
        with torch.no_grad():
            initial = start.produce()
        mask_term, gamma = mask_objective(initial), PAPER_GAMMA[mode]
        chamfer = ChamferToInitial(initial)

        def whole(optimiser: Adam) -> None:
            moved = start.produce()  # noqa: B023
            loss = mask_term(moved)  # noqa: B023
            if gamma:  # noqa: B023
                loss = loss + gamma * chamfer(moved)  # noqa: B023
            optimiser.step(loss.sum())

        moving = Adam(start.parameters, PAPER_LEARNING_RATE[mode])
        for _ in range(NETWORK_HALFWAY):
            whole(moving)
        bare_still, still = Adam(bare_start.parameters, 0.0), Adam(start.parameters, 0.0)
        timings = setting.race(
            {
                "bare network": lambda: bare_still.step(bare_start.produce().sum()),  # noqa: B023
                "whole step": lambda: whole(still),  # noqa: B023
            }
        )
        added = timings["whole step"].median / timings["bare network"].median - 1.0
        points = initial.shape[1]
        records += setting.records(f"step, {mode}", timings, points=points, side=64, precision="float32", added=added)
    return records


def batch(setting: Setting, batches: Sequence[int] | None = None, count: int = 1024, steps: int = 50) -> list[dict[str, Any]]:
    """Seconds a cloud, and clouds a second, of `refine` called once a cloud and of `refine_batch` on more and more clouds."""
    if batches is None:
        batches = (*BATCHES, *LARGE_BATCHES) if setting.device.type == "cuda" else BATCHES
    view = chair_view(256)
    clouds: list[np.ndarray[Any, np.dtype[np.float64]]] = [cloud(count, setting.seed + i) for i in range(max(batches))]
    config = RefineConfig(steps=steps, device=str(setting.device), seed=setting.seed, preset="paper")

    def together(size: int) -> Work:
        def work() -> None:
            for result in refine_batch([(points, view) for points in clouds[:size]], config):
                if isinstance(result, TsoError):
                    raise result

        return work

    setting.report(f"batches of {batches[0]} to {batches[-1]}")
    timings = setting.race(
        {"refine": lambda: refine(clouds[0], view, config=config)} | {str(size): together(size) for size in batches}
    )
    alone = timings["refine"].median
    records = []
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
                clouds_per_second=1.0 / each.median,
                times_refine=alone / each.median,
            )
        )
    return records
