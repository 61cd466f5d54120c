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
from ..errors import InputError, TsoError
from ..geometry.camera import Camera
from ..kernels.dispatch import planned
from ..silhouette.chamfer import ChamferToInitial
from .agreement import view_ious
from .coarse_to_fine import BEST, coarse_to_fine_descent, mask_chamfer_with_prior
from .config import PRESETS, RefineConfig, RefineResult, Settings, StopReason
from .inputs import as_views
from .objective import MaskChamferObjective, SilhouetteObjective
from .optimise import Descent, Objective, Progress, descend
from .parameters import Carried, Cloud, NetworkParameters, PointParameters
from .photometric import PhotometricLoss
from .problem import Problem, batches_of, parts_of
from .result_warnings import remarks
from .smooth_field import SmoothField
from .view_weights import Weights

if TYPE_CHECKING:
    from ..network.model import BaseNetwork

Array = NDArray[np.float64]

# Clouds up to this size are moved by one CPU thread each, alone or in a batch: threads would wait for one another.
SMALL_CLOUD = 8192
LIGHT = ("points", "latent")
# Under this IoU hardly anything of the start lies on the mask, as of a pole beside its own: coming nearer need not show in it.
HARDLY_MEET = 0.1


def refine(
    points: Any,
    masks: Any,
    cameras: Camera | Sequence[Camera] | None = None,
    config: RefineConfig | None = None,
    *,
    network: BaseNetwork | None = None,
    image: Any = None,
    colours: Any = None,
    faces: Any = None,
    progress: Progress | None = None,
) -> RefineResult:
    """Move a cloud, a mesh, or the network that predicts a cloud, until its projection agrees with the masks.

    Parameters
    ----------
    points : [N, 3] array or tensor; None in the network modes, where the network's prediction is the start.
    masks : one [H, W] array in [0, 1], a sequence of them, or `View` objects, which bring their own
        camera, ignore map, depth map and image.
    cameras : one for each mask; None for the canonical camera.
    config : settings, by default those of the preset "best".
    network : for the modes "encoder", "encoder-decoder" and "latent"; it is copied, never changed.
    image : [3, 64, 64] network input in [0, 1], array or tensor.
    colours : [N, 3] red, green and blue of the points, in [0, 1] or uint8, array or tensor; views that have an image ask for
        them.
    faces : [F, 3] whole numbers, the triangles that join the points of a mesh, array or tensor; None for a cloud. Of a mesh
        1,024 points of the surface move in place of its vertices, and these follow.
    progress : called after every step with (step, steps, loss).

    Returns
    -------
    RefineResult; its points are the best iterate of the preset's objective, or with "best" in points mode the mean of the
    stages' best ones, the start being a candidate.

    Raises
    ------
    InputError
        Points, faces, masks or cameras that cannot be used or do not meet, a mode that lacks its network, or an image without
        colours.
    TsoError
        The loss of the start, or after the first step, is not a finite number.
    """
    views = as_views(masks, cameras)
    settings = (config or RefineConfig()).settings(len(views))
    seconds: dict[str, float] = {}
    device = devices.resolve(settings.device)
    with _timed(seconds, "prepare"):
        start: PointParameters | NetworkParameters
        if settings.mode == "points":
            if points is None:
                raise InputError("mode points needs points, found none")
            cloud = Cloud(points, "points", colours, faces)
            start = PointParameters([cloud], device)
        else:
            start = NetworkParameters(network, image, settings.mode, device)
            cloud = start.cloud
        item = Problem.of(cloud, views, settings)
    with _planned([item], settings):
        (found,) = _refined([item], start, settings, seconds, progress)
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
    scenes : (points [N, 3], views) of each; the views are a `View` or a sequence of them.
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
    settings = config.settings()
    if not isinstance(scenes, Iterable):
        raise InputError(f"scenes is {scenes!r}, expected a sequence of (points, views)")
    scenes = list(scenes)
    if settings.mode != "points":
        raise InputError(f"mode is {settings.mode!r}, expected points for a batch")
    device = devices.resolve(settings.device)
    found: list[RefineResult | TsoError | None] = [None] * len(scenes)
    items: dict[int, Problem] = {}
    for number, scene in enumerate(scenes):
        try:
            points, masks = parts_of(scene, number)
            items[number] = Problem.of(Cloud(points, f"points of scene {number}"), as_views(masks), settings)
        except TsoError as error:
            found[number] = error
    batches = batches_of(items, settings.staged)
    every = [config.settings(len(items[batch[0]].views)) for batch in batches]
    done, total, interrupted = 0, sum(own.steps for own in every), False
    for batch, settings in zip(batches, every, strict=True):
        seconds: dict[str, float] = {}

        def told(step: int, steps: int, loss: float, before: int = done) -> None:
            assert progress is not None
            progress(before + step, total, loss)

        own = [items[number] for number in batch]
        with _timed(seconds, "prepare"):
            start = PointParameters([item.cloud for item in own], device)
        with _planned(list(items.values()), settings):
            results = _refined(own, start, settings, seconds, told if progress else None, at_start=interrupted)
        for number, result in zip(batch, results, strict=True):
            found[number] = result
            interrupted |= isinstance(result, RefineResult) and result.stop_reason == "interrupted"
        done += settings.steps
    return [result for result in found if result is not None]


def _planned(items: list[Problem], settings: Settings) -> AbstractContextManager[None]:
    """All the work on the items, for `planned`."""
    steps = settings.steps // 2 if settings.staged else settings.steps  # of the pull, plain torch makes half as much work
    drawn = steps * sum(len(item.working) * len(item.cloud.initial) for item in items)
    return planned(steps * sum(len(item.working) for item in items), drawn)


def compile_loops() -> None:
    """Compile all loops that a refinement on the CPU uses, and keep the machine code on disk; nothing where it is there."""
    mask = np.zeros((64, 64), np.float32)
    mask[20:44, 20:44] = 1.0
    much = 1 << 60
    with planned(much, much):
        for preset in PRESETS:
            refine(np.random.default_rng(0).uniform(-0.3, 0.3, (64, 3)), mask, config=RefineConfig(steps=1, preset=preset))


def _refined(
    items: list[Problem],
    start: PointParameters | NetworkParameters,
    settings: Settings,
    seconds: dict[str, float],
    progress: Progress | None,
    at_start: bool = False,
) -> list[RefineResult | TsoError]:
    """The loop, and the results of all items; ``at_start``: Ctrl-C came before it, and nothing moves."""
    small = int(start.counts.max()) <= SMALL_CLOUD
    one_thread = small and settings.mode in LIGHT
    recipe = settings.coarse_to_fine or BEST
    given = [item.views for item in items]
    if settings.refine_camera and settings.steps and not at_start and isinstance(start, PointParameters):
        from .camera_correction import settled

        with _timed(seconds, "cameras"), devices.one_thread(one_thread):
            items, at_start = settled(items, start, settings)
    with _timed(seconds, "prepare"), devices.one_thread(one_thread):
        first = start.forward().detach().clone()
        chamfer = ChamferToInitial(first, start.counts)
        views = [item.working for item in items]
        weights = Weights.even(len(items), len(items[0].views))
        if settings.preset == "best" and recipe.weighs:
            weights = Weights.of([item.working[: len(item.views)] for item in items], start.counts, first)
        fields: dict[int, SmoothField] = {}
        items, of_all, at_start = _mirrored(items, start.counts, first, weights.shared, settings, at_start, fields)
        views = [item.working for item in items]

    def held(moved: Tensor) -> Tensor:
        return settings.gamma * chamfer(moved)

    further = held if settings.gamma else None
    steps, told = (0, None) if at_start else (settings.steps, progress)
    with _timed(seconds, "optimise"), devices.one_thread(one_thread):
        if settings.staged:
            following = _Following(items, start.counts, first, of_all)
            pictures = torch.tensor([item.pictures(own) for item, own in zip(items, weights.shared.tolist(), strict=True)])
            descent = coarse_to_fine_descent(
                first,
                start.counts,
                following,
                further,
                steps,
                settings.learning_rate,
                told,
                recipe,
                fields,
                _coloured(items, weights.shared, first),
                pictures,
            )
            items = following.items
        else:
            term: Objective
            if settings.preset == "best":
                term = mask_chamfer_with_prior(first, start.counts, MaskChamferObjective(views, start.counts, first, of_all))
            else:
                term = SilhouetteObjective(views, start.counts, first, of_all)

            def objective(moved: Tensor) -> Tensor:
                loss = term(moved)
                return loss + further(moved) if further else loss

            descent = descend(start.forward, start.parameters, objective, steps, settings.learning_rate, told)
        descent = replace(descent, interrupted=descent.interrupted or at_start)
    with _timed(seconds, "judge"), devices.one_thread(small):
        ways = descent.best.double() - first.double()
        ends = [item.cloud.carried(way) for item, way in zip(items, ways.cpu().numpy(), strict=True)]
        ious = [
            view_ious(item.cloud.judged, end.judged, own, item.views) for item, end, own in zip(items, ends, given, strict=True)
        ]
        for number, (item, own) in enumerate(zip(items, weights.shared.tolist(), strict=True)):
            if settings.staged and item.views == given[number] and _agrees_less(item, ious[number], own):
                ends[number] = item.cloud.carried(np.zeros_like(ends[number].ways))
                ious[number] = [(before, before) for before, _ in ious[number]]
                descent.best_step[number], descent.best_loss[number] = 0, descent.first_loss[number]
        for way, end in zip(ways, ends, strict=True):
            way[: len(end.ways)] = torch.from_numpy(end.ways)
        moved_by = chamfer((first.double() + ways).to(first)).tolist()
    seconds = {phase: value / len(items) for phase, value in seconds.items()}
    return [
        _result(item, descent, number, end, own, weights, moved_by[number], first.device, settings, seconds)
        for number, (item, end, own) in enumerate(zip(items, ends, ious, strict=True))
    ]


def _agrees_less(item: Problem, ious: list[tuple[float, float]], weights: list[float]) -> bool:
    """Whether the masks are all that was asked, and the silhouette agrees less with them than that of the start.

    The pull may be less all the same, as it counts how far off cells are: so a start that is right would be led away from the
    truth, after its mask's pixels.
    """
    if any(view.depth is not None or view.image is not None for view in item.views):
        return False
    before, after = np.average(ious, axis=0, weights=weights)
    return bool(after < before and before >= HARDLY_MEET)


class _Following:
    """The pull of the masks in windows that follow the clouds: made anew where a window would change much.

    Attributes
    ----------
    items : as they are seen now.
    """

    def __init__(self, items: list[Problem], counts: Tensor, first: Tensor, weights: Tensor) -> None:
        self.items, self._counts, self._first, self._weights = items, counts, first, weights
        self._pull: MaskChamferObjective | None = None

    def __call__(self, points: Tensor, finest: bool) -> MaskChamferObjective:
        items = self.items
        if self._pull is not None or finest:
            clouds = points.double().cpu().numpy()
            items = [
                item.followed(item.cloud.centre + item.cloud.scale * cloud[: len(item.cloud.initial)], finest)
                for item, cloud in zip(items, clouds, strict=True)
            ]
        views = [item.working for item in items]
        if self._pull is None or any(
            now is not before
            for own, item in zip(views, self.items, strict=True)
            for now, before in zip(own, item.working, strict=True)
        ):
            self.items = items
            self._pull = MaskChamferObjective(views, self._counts, self._first, self._weights)
        return self._pull


def _coloured(items: list[Problem], weights: Tensor, first: Tensor) -> PhotometricLoss | None:
    """What images ask: of a single cloud, those of a batch have no colours."""
    # Paint, lettering above all, is not its own mirror image where the shape is.
    views, colours = items[0].working[: len(items[0].views)], items[0].cloud.colours
    if colours is None or all(view.image is None for view in views):
        return None
    return PhotometricLoss(views, weights[0].tolist(), torch.from_numpy(colours), first)


def _mirrored(
    items: list[Problem],
    counts: Tensor,
    first: Tensor,
    weights: Tensor,
    settings: Settings,
    at_start: bool,
    fields: dict[int, SmoothField],
) -> tuple[list[Problem], Tensor, bool]:
    """The items, the weights of all their views, and whether Ctrl-C came, as `verified_symmetry`."""
    if len(items[0].working) == weights.shape[1]:
        return items, weights, at_start
    if settings.symmetry == "auto" and settings.steps and not at_start:
        from .symmetry_check import verified_symmetry

        return verified_symmetry(items, counts, first, weights, settings, fields)
    # What the mirror image shows is worth what its picture is.
    return items, weights.repeat(1, 2), at_start


def _result(
    item: Problem,
    descent: Descent,
    number: int,
    end: Carried,
    ious: list[tuple[float, float]],
    weights: Weights,
    moved_by: float,
    device: torch.device,
    settings: Settings,
    seconds: dict[str, float],
) -> RefineResult | TsoError:
    losses = descent.losses[:, number]
    finite = np.isfinite(losses)
    steps = int(finite.sum()) - 1
    if steps < 0:
        return TsoError("the loss of the start is no finite number")
    if steps == 0 and not finite.all():
        return TsoError("the loss is no finite number after the first step (a smaller learning rate?)")
    before, after = np.mean(ious, 0).tolist()
    moved = np.linalg.norm(end.ways, axis=1)
    result = RefineResult(
        points=end.points,
        initial=item.cloud.given,
        mode=settings.mode,
        steps=steps,
        best_step=int(descent.best_step[number]),
        stop_reason=_stop_reason(descent, number, bool(finite.all()), settings.steps),
        losses=losses[finite].tolist(),
        loss_before=float(descent.first_loss[number]),
        loss_after=float(descent.best_loss[number]),
        iou_before=before,
        iou_after=after,
        view_ious=ious,
        view_trust=weights.trust[number].tolist(),
        view_weights=weights.shared[number].tolist(),
        view_windows=[(seen.box, seen.camera.width) for seen in item.working[: len(item.views)]],
        moved_mean=float(moved.mean()),
        moved_max=float(moved.max()),
        chamfer_to_initial=moved_by,
        symmetry=None if item.plane is None else (*item.plane.normal.tolist(), item.plane.offset),
        symmetry_outcome=item.symmetry_outcome,
        symmetry_reason=item.symmetry_reason,
        preset=settings.preset,
        learning_rate=settings.learning_rate,
        gamma=settings.gamma,
        sigma_sq=settings.sigma_sq,
        device=str(device),
        seed=settings.seed,
        cameras=tuple(view.camera for view in item.views),
        seconds=seconds,
        surface=(item.cloud.judged, end.judged) if item.cloud.surface else None,
        surface_samples=len(end.ways) if item.cloud.surface else None,
    )
    return replace(result, warnings=remarks(result, item.views, settings.steps))


def _stop_reason(descent: Descent, number: int, finite: bool, steps: int) -> StopReason:
    if not finite:
        return "non_finite"
    if descent.interrupted:
        return "interrupted"
    if steps == 0 or descent.best_step[number] > 0:
        return "max_steps"
    return "nothing_to_do" if descent.first_loss[number] == 0.0 else "not_improved"


@contextmanager
def _timed(seconds: dict[str, float], phase: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[phase] = seconds.get(phase, 0.0) + time.perf_counter() - start
