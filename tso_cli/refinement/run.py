"""Test-stage optimisation (Eq. 7 of the paper): clouds, masks and cameras -> the loop -> results."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .. import device as devices
from ..camera import Camera
from ..errors import InputError, TsoError
from ..kernels.choice import planned
from ..losses import ChamferToInitial
from ..metrics import iou
from ..objective import MaskObjective
from ..projection import default_sigma_sq, silhouettes_of
from ..scene import View
from .batching import Item, batches_of, parts_of
from .config import PAPER_GAMMA, PAPER_LEARNING_RATE, RefineConfig, RefineResult
from .loop import Descent, Progress, descend
from .starts import Cloud, NetworkStart, PointsStart
from .views import as_views

if TYPE_CHECKING:
    from ..network import BaseNetwork

Array = NDArray[np.float64]

# Clouds up to this size are moved by one CPU thread.
SMALL_CLOUD = 8192
# Silhouettes judged at once hold no more pixels than this together; bounds memory.
PIXELS_AT_ONCE = 1 << 22


def refine(
    points: Any,
    masks: Any,
    cameras: Camera | Sequence[Camera] | None = None,
    config: RefineConfig | None = None,
    *,
    network: BaseNetwork | None = None,
    image: Any = None,
    progress: Progress | None = None,
) -> RefineResult:
    """Move a cloud, or the network that predicts it, until its projection agrees with the masks.

    Parameters
    ----------
    points : [N, 3] array or tensor; None in the network modes, where the network's prediction is the start.
    masks : one [H, W] array in [0, 1], a sequence of them, or :class:`tso_cli.scene.View` objects, which bring their own camera
        and ignore map.
    cameras : one for each mask; None for the canonical camera.
    config : settings, by default the paper's.
    network : for the modes "encoder" and "encoder-decoder"; it is copied, never changed.
    image : [3, 64, 64] network input in [0, 1], array or tensor.
    progress : called after every step with (step, steps, loss).

    Returns
    -------
    RefineResult; its points are the best iterate of BCE + gamma * Chamfer, the start being a candidate.

    Raises
    ------
    InputError
        Points, masks or cameras that cannot be used or do not meet, or a mode that lacks its network.
    TsoError
        The loss of the start, or after the first step, is not a finite number.
    """
    config = config or RefineConfig()
    seconds: dict[str, float] = {}
    views = as_views(masks, cameras)
    device = devices.resolve(config.device)
    with _timed(seconds, "prepare"):
        start: PointsStart | NetworkStart
        if config.mode == "points":
            if points is None:
                raise InputError("mode points needs points, found none")
            cloud = Cloud(points, "points")
            start = PointsStart([cloud], device)
        else:
            start = NetworkStart(network, image, config.mode, device)
            cloud = start.cloud
        item = Item.of(cloud, views, config)
    with _planned([item], config):
        (found,) = _refined([item], start, config, seconds, progress)
    if isinstance(found, TsoError):
        raise found
    return found


def refine_batch(
    scenes: Sequence[tuple[Any, Any]], config: RefineConfig | None = None, *, progress: Progress | None = None
) -> list[RefineResult | TsoError]:
    """Move many clouds, each until its projection agrees with its own masks: the results of `refine`, of all at once.

    Small clouds fill the machine together where they could not alone.

    Parameters
    ----------
    scenes : (points [N, 3], views) of each; the views are a :class:`tso_cli.scene.View` or a sequence of them.
    config : settings for all; mode "points".
    progress : called with (steps done, steps in all, mean loss), counted over the batches that the clouds are put into.

    Ctrl-C ends it: each cloud of the batch at work gets its best so far, those that had not begun their start, and the
    ``stop_reason`` of all these is "interrupted".

    Returns
    -------
    For each scene its result, or the error that `refine` would have raised: one that cannot be refined stops no other.
    ``seconds`` are those of the batch, divided by its size.

    Raises
    ------
    InputError
        The mode is not "points", the device is not there, or ``scenes`` are none.
    """
    config = config or RefineConfig()
    if not isinstance(scenes, Iterable):
        raise InputError(f"scenes is {scenes!r}, expected a sequence of (points, views)")
    scenes = list(scenes)
    if config.mode != "points":
        raise InputError(f"mode is {config.mode!r}, expected points for a batch")
    device = devices.resolve(config.device)
    found: list[RefineResult | TsoError | None] = [None] * len(scenes)
    items: dict[int, Item] = {}
    for number, scene in enumerate(scenes):
        try:
            points, masks = parts_of(scene, number)
            items[number] = Item.of(Cloud(points, f"points of scene {number}"), as_views(masks), config)
        except TsoError as error:
            found[number] = error
    batches = batches_of(items)
    done, total, interrupted = 0, len(batches) * config.steps, False
    for batch in batches:
        seconds: dict[str, float] = {}

        def told(step: int, steps: int, loss: float, before: int = done) -> None:
            assert progress is not None
            progress(before + step, total, loss)

        own = [items[number] for number in batch]
        with _timed(seconds, "prepare"):
            start = PointsStart([item.cloud for item in own], device)
        with _planned(list(items.values()), config):
            results = _refined(own, start, config, seconds, told if progress else None, at_start=interrupted)
        for number, result in zip(batch, results, strict=True):
            found[number] = result
            interrupted |= isinstance(result, RefineResult) and result.stop_reason == "interrupted"
        done += config.steps
    return [result for result in found if result is not None]


def _planned(items: list[Item], config: RefineConfig) -> AbstractContextManager[None]:
    """All the work on the items, for :func:`tso_cli.kernels.choice.planned`."""
    drawn = config.steps * sum(len(item.views) * len(item.cloud.initial) for item in items)
    return planned(config.steps * sum(len(item.views) for item in items), drawn)


def compile_loops() -> None:
    """Compile all loops that a refinement on the CPU uses, and keep the machine code on disk; nothing where it is there."""
    mask = np.zeros((64, 64), np.float32)
    mask[20:44, 20:44] = 1.0
    much = 1 << 60
    with planned(much, much):
        refine(np.random.default_rng(0).uniform(-0.3, 0.3, (64, 3)), mask, config=RefineConfig(steps=1))


def _refined(
    items: list[Item],
    start: PointsStart | NetworkStart,
    config: RefineConfig,
    seconds: dict[str, float],
    progress: Progress | None,
    at_start: bool = False,
) -> list[RefineResult | TsoError]:
    """The loop, and the results of all items; ``at_start``: Ctrl-C came before it, and nothing moves."""
    with _timed(seconds, "prepare"):
        first = start.produce().detach().clone()
        mask_term = MaskObjective([item.working for item in items], start.counts, first)
        chamfer = ChamferToInitial(first, start.counts)
    gamma = PAPER_GAMMA[config.mode] if config.gamma is None else config.gamma
    learning_rate = config.learning_rate or PAPER_LEARNING_RATE[config.mode]

    def objective(moved: Tensor) -> Tensor:
        loss = mask_term(moved)
        return loss + gamma * chamfer(moved) if gamma else loss

    seen = [item.views for item in items]
    if config.refine_camera and not at_start and isinstance(start, PointsStart):
        from .cameras import settled_views

        with _timed(seconds, "cameras"):
            clouds = [item.cloud for item in items]
            seen, at_start = settled_views(
                clouds, seen, mask_term, lambda moved: gamma * chamfer(moved), start, config.steps, learning_rate
            )
            working = [Item.of(cloud, own, config).working for cloud, own in zip(clouds, seen, strict=True)]
            mask_term = MaskObjective(working, start.counts, first)
    small = first[..., 0].numel() <= SMALL_CLOUD
    with _timed(seconds, "optimise"), devices.one_thread(small and isinstance(start, PointsStart)):
        steps = 0 if at_start else config.steps
        descent = descend(start.produce, start.parameters, objective, steps, learning_rate, None if at_start else progress)
        descent = replace(descent, interrupted=descent.interrupted or at_start)
    with _timed(seconds, "judge"), devices.one_thread(small):
        moved_by = chamfer(descent.best).tolist()
        offsets = (descent.best.double() - first.double()).cpu().numpy()
        judged = _judged(items, seen, offsets, config, first.device)
    seconds = {phase: value / len(items) for phase, value in seconds.items()}
    return [
        _result(item, seen[number], descent, number, own, moved_by[number], first.device, config, learning_rate, gamma, seconds)
        for number, (item, own) in enumerate(zip(items, judged, strict=True))
    ]


def _judged(
    items: list[Item], seen: list[tuple[View, ...]], offsets: Array, config: RefineConfig, device: torch.device
) -> list[tuple[Array, float, float]]:
    """The refined points of each item, and its IoU before and after, mean over views.

    ``seen`` are the views with the cameras of the end, ``offsets`` [B, N, 3] are normalised.
    """
    before = [item.cloud.initial for item in items]
    # What did not move keeps every bit of the input.
    after: list[Array] = [
        item.cloud.initial + item.cloud.scale * offset[: len(item.cloud.initial)]
        for item, offset in zip(items, offsets, strict=True)
    ]
    groups: dict[Any, list[tuple[int, View, Camera]]] = {}
    for number, (item, moved) in enumerate(zip(items, seen, strict=True)):
        for view, own in zip(item.views, moved, strict=True):
            groups.setdefault((own.camera.width, own.camera.height, own.camera.model), []).append((number, view, own.camera))
    scores: list[list[tuple[float, float]]] = [[] for _ in items]
    for (width, height, _), group in groups.items():
        size = max(1, PIXELS_AT_ONCE // (width * height))
        for part in (group[i : i + size] for i in range(0, len(group), size)):
            numbers, views, moved_cameras = zip(*part, strict=True)
            stages = (before, [view.camera for view in views]), (after, moved_cameras)
            shown = [silhouettes_of([c[n] for n in numbers], cams, config.sigma_sq, device) for c, cams in stages]
            for number, view, *both in zip(numbers, views, *shown, strict=True):
                first, last = (iou(silhouette, view.mask, view.known) for silhouette in both)
                scores[number].append((first, last))
    return [(points, *np.mean(own, 0).tolist()) for points, own in zip(after, scores, strict=True)]


def _result(
    item: Item,
    seen: tuple[View, ...],
    descent: Descent,
    number: int,
    judged: tuple[Array, float, float],
    moved_by: float,
    device: torch.device,
    config: RefineConfig,
    learning_rate: float,
    gamma: float,
    seconds: dict[str, float],
) -> RefineResult | TsoError:
    losses = descent.losses[:, number]
    finite = np.isfinite(losses)
    steps = int(finite.sum()) - 1
    if steps < 0:
        return TsoError("the loss of the start is no finite number")
    if steps == 0 and not finite.all():
        return TsoError("the loss is no finite number after the first step (a smaller learning rate?)")
    points, before, after = judged
    first_camera = item.views[0].camera
    return RefineResult(
        points=points,
        initial=item.cloud.initial,
        mode=config.mode,
        steps=steps,
        best_step=int(descent.best_step[number]),
        stop_reason="non_finite" if not finite.all() else "interrupted" if descent.interrupted else "max_steps",
        losses=losses[finite].tolist(),
        loss_before=float(losses[0]),
        loss_after=float(losses[descent.best_step[number]]),
        iou_before=before,
        iou_after=after,
        chamfer_to_initial=moved_by,
        learning_rate=learning_rate,
        gamma=gamma,
        sigma_sq=config.sigma_sq or default_sigma_sq(first_camera.width, first_camera.height),
        device=str(device),
        seed=config.seed,
        seconds=seconds,
        cameras=tuple(view.camera for view in seen),
    )


@contextmanager
def _timed(seconds: dict[str, float], phase: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[phase] = seconds.get(phase, 0.0) + time.perf_counter() - start
