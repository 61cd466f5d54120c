"""`refine` and `refine_batch`: test-stage optimisation (Eq. 7 of the paper) of clouds by masks and cameras."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from .. import device as devices
from ..errors import InputError, TsoError
from ..geometry.camera import Camera
from ..geometry.view import View
from ..kernels.dispatch import planned
from ..network.model import BaseNetwork
from .cloud import Cloud
from .config import RefineConfig, Settings
from .optimise import Progress, offset_progress
from .parameters import NetworkParameters, PointParameters
from .presets import PRESETS
from .problem import Problem
from .result import RefineResult
from .run import Stopwatch, run_batch

# Most points of a batch; and no cloud of a batch has less than half the points of its largest.
BATCH_POINTS = 1 << 20
# Most cells of a batch's resampled views: bounds memory at 1 GiB in plain torch.
BATCH_CELLS = 1 << 24
# Most clouds of a staged batch: the inverse matrices of a cloud's smooth fields take 12 MiB, so these 0.8 GiB.
BATCH_FIELDS = 64


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
    masks : one [H, W] array in [0, 1], a sequence of them, or `View` objects.
    cameras : one for each mask; None for the canonical camera, and for views, which have their own.
    network : for the modes "encoder", "encoder-decoder" and "latent"; it is copied, never changed.
    image : [3, 64, 64] network input in [0, 1], array or tensor.
    colours : [N, 3] RGB of the points, in [0, 1] or uint8, array or tensor; needed for views with an image.
    faces : [F, 3] whole numbers, the triangles of a mesh, array or tensor: 1,024 points of its surface move, and its vertices
        follow.
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
    views = _as_views(masks, cameras)
    settings = (config or RefineConfig()).settings(len(views))
    stopwatch = Stopwatch()
    device = devices.resolve(settings.device)
    with stopwatch.phase("prepare"):
        parameters: PointParameters | NetworkParameters
        if settings.mode == "points":
            if points is None:
                raise InputError("mode points needs points, found none")
            cloud = Cloud(points, "points", colours, faces)
            parameters = PointParameters([cloud], device)
        else:
            parameters = NetworkParameters(network, image, settings.mode, device)
            cloud = parameters.cloud
        problem = Problem.of(cloud, views, settings)
    with planned(*_work([problem], settings)):
        (result,) = run_batch([problem], parameters, settings, stopwatch, progress)
    if isinstance(result, TsoError):
        raise result
    return result


def refine_batch(
    scenes: Sequence[tuple[Any, Any]], config: RefineConfig | None = None, *, progress: Progress | None = None
) -> list[RefineResult | TsoError]:
    """Move many clouds, each until its projection agrees with its own masks: the results of `refine`, of all at once.

    Parameters
    ----------
    scenes : (points [N, 3], views) of each; the views are a `View` or a sequence of them.
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
    results: dict[int, RefineResult | TsoError] = {}
    problems: dict[int, Problem] = {}
    for number, scene in enumerate(scenes):
        try:
            points, masks = _points_and_views(scene, number)
            problems[number] = Problem.of(Cloud(points, f"points of scene {number}"), _as_views(masks), settings)
        except TsoError as error:
            results[number] = error
    batches = batches_of(problems, settings.staged)
    settings_of = [config.settings(len(problems[batch[0]].views)) for batch in batches]
    done, total, interrupted = 0, sum(settings.steps for settings in settings_of), False
    for batch, settings in zip(batches, settings_of, strict=True):
        stopwatch = Stopwatch()
        batch_problems = [problems[number] for number in batch]
        with stopwatch.phase("prepare"):
            parameters = PointParameters([problem.cloud for problem in batch_problems], device)
        report = progress and offset_progress(progress, done, total)
        with planned(*_work(list(problems.values()), settings)):
            batch_results = run_batch(batch_problems, parameters, settings, stopwatch, report, interrupted)
        for number, result in zip(batch, batch_results, strict=True):
            results[number] = result
            interrupted |= isinstance(result, RefineResult) and result.stop_reason == "interrupted"
        done += settings.steps
    return [results[number] for number in range(len(scenes))]


def _work(problems: list[Problem], settings: Settings) -> tuple[int, int]:
    """Images and points drawn in all steps, as `planned` counts them."""
    # In plain torch the mask Chamfer loss is half the work of the silhouette.
    steps = settings.steps // 2 if settings.staged else settings.steps
    images = sum(len(problem.resampled) for problem in problems)
    points = sum(len(problem.resampled) * len(problem.cloud.initial) for problem in problems)
    return steps * images, steps * points


def compile_loops() -> None:
    """Compile all loops that a refinement on the CPU uses, and keep the machine code on disk; nothing where it is there."""
    mask = np.zeros((64, 64), np.float32)
    mask[20:44, 20:44] = 1.0
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (64, 3))
    much = 1 << 60
    with planned(much, much):
        for preset in PRESETS:
            refine(points, mask, config=RefineConfig(steps=1, preset=preset))


def _as_views(masks: Any, cameras: Camera | Sequence[Camera] | None = None) -> tuple[View, ...]:
    """One `View` for each mask."""
    if isinstance(masks, View):
        masks = [masks]
    if isinstance(masks, Sequence) and masks and all(isinstance(mask, View) for mask in masks):
        if cameras is not None:
            raise InputError("views bring their own cameras, expected none beside them")
        return tuple(masks)
    if isinstance(masks, (Tensor, np.ndarray)) and masks.ndim == 2:
        masks = [masks]
    try:
        arrays = [_as_array(mask) for mask in masks]
    except (TypeError, ValueError):
        raise InputError("masks are no arrays of numbers, expected one [H, W] or a sequence of them") from None
    if any(mask.ndim != 2 for mask in arrays):
        raise InputError(f"a mask has shape {[list(m.shape) for m in arrays if m.ndim != 2][0]}, expected [H, W]")
    if cameras is None:
        cameras = [Camera.canonical(mask.shape[-1], mask.shape[0]) for mask in arrays]
    elif isinstance(cameras, Camera):
        cameras = [cameras]
    if len(arrays) == 0 or len(arrays) != len(cameras):
        raise InputError(f"found {len(arrays)} masks and {len(cameras)} cameras, expected one camera for each mask")
    return tuple(View(mask, camera, name=f"mask {i}") for i, (mask, camera) in enumerate(zip(arrays, cameras, strict=True)))


def _as_array(mask: Any) -> NDArray[np.float32]:
    if isinstance(mask, Tensor):
        mask = mask.detach().cpu().numpy()
    return np.asarray(mask, dtype=np.float32)


def _points_and_views(scene: Any, number: int) -> tuple[Any, Any]:
    try:
        points, views = scene
    except (TypeError, ValueError):
        shown = f"{type(scene).__name__} of {len(scene)}" if hasattr(scene, "__len__") else repr(scene)
        raise InputError(f"scene {number} is {shown}, expected (points, views)") from None
    return points, views


def batches_of(problems: dict[int, Problem], staged: bool = False) -> list[list[int]]:
    """Keys of the problems of each batch: views of one kind, cloud sizes within a factor of two, bounded memory.

    ``staged`` : the clouds move by smooth fields, as the preset "best" does in points mode.
    """
    groups: dict[Any, list[int]] = {}
    for number, problem in problems.items():
        kind = (len(problem.views), problem.fine_grids, *(view.kind for view in problem.resampled))
        groups.setdefault(kind, []).append(number)
    batches: list[list[int]] = []
    for group in groups.values():
        most = BATCH_CELLS // problems[group[0]].cells
        if staged:
            most = min(most, BATCH_FIELDS)
        largest = 0
        for number in sorted(group, key=lambda number: -len(problems[number].cloud.initial)):
            size = len(problems[number].cloud.initial)
            full = largest and (len(batches[-1]) >= most or (len(batches[-1]) + 1) * largest > BATCH_POINTS)
            if not largest or 2 * size < largest or full:
                batches.append([])
                largest = size
            batches[-1].append(number)
    return batches
