"""`refine` and `refine_batch`: test-stage optimisation (Eq. 7 of the paper) of clouds by masks and cameras."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..cloud.cloud import Cloud, as_numpy
from ..errors import InputError, TsoError
from ..geometry.camera import Camera
from ..geometry.view import View
from ..kernels import blas
from ..kernels.dispatch import planned
from ..optimisation.loop import Progress
from ..optimisation.presets import PRESETS, SYMMETRY_PROBE_STEPS
from ..optimisation.problem import Problem
from .config import RefineConfig, Settings
from .result import RefineResult
from .run import Stopwatch, run

if TYPE_CHECKING:
    from ..network.model import BaseNetwork


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
    points : [N, 3] array or tensor, or a `Cloud`, which has its colours and faces; None in the network modes, where the
        network's prediction is the start.
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
    stopwatch, parameters = Stopwatch(), None
    with stopwatch.phase("prepare"):
        if settings.mode == "points":
            if points is None:
                raise InputError("mode points needs points, found none")
            cloud = points if isinstance(points, Cloud) else Cloud(points, "points", colours, faces)
        else:
            from ..optimisation.network_parameters import NetworkParameters

            parameters = NetworkParameters(
                network, image, settings.mode, settings.device, settings.learning_rate
            )
            cloud = parameters.cloud
    with (
        planned(*_work(settings, len(views), len(cloud.given)), settings.seconds),
        blas.one_thread(),
    ):
        with stopwatch.phase("prepare"):
            problem = Problem.of(cloud, views, settings)
        return run(problem, settings, stopwatch, parameters, progress)


def _work(settings: Settings, views: int, points: int) -> tuple[int, int]:
    """How often a cloud is compared with a view, and the points in all these, as `planned` counts them."""
    comparisons = views * settings.steps
    if settings.staged:
        points = min(points, settings.points or points)
    if settings.symmetry == "auto":
        # The flipped views, and the symmetry check.
        comparisons = 2 * comparisons + 3 * views * SYMMETRY_PROBE_STEPS
    # In numpy a point costs the paper's silhouette several times as much.
    return comparisons, comparisons * points * (4 if settings.preset == "paper" else 1)


def refine_batch(
    scenes: Sequence[tuple[Any, Any]],
    config: RefineConfig | None = None,
    *,
    progress: Progress | None = None,
) -> list[RefineResult | TsoError]:
    """Move many clouds, each until its projection agrees with its own masks: the results of `refine`, of all at once.

    Parameters
    ----------
    scenes : (points [N, 3], views) of each; the views are a `View` or a sequence of them.
    progress : called after every cloud with (clouds done, clouds, mean loss of their results).

    Clouds are spread over processes, one for each core (OMP_NUM_THREADS, where set, says how many; one on other systems than
    Linux). Ctrl-C ends it: clouds at work get their best so far, those that had not begun their start, and the ``stop_reason``
    of all these is "interrupted".

    Returns
    -------
    For each scene its result, or the error that `refine` would have raised: one that cannot be refined stops no other.

    Raises
    ------
    InputError
        The mode is not "points", the device is not there, or ``scenes`` are none.
    """
    config = config or RefineConfig()
    if not isinstance(scenes, Iterable):
        raise InputError(f"scenes is {scenes!r}, expected a sequence of (points, views)")
    # A tensor on a GPU cannot be read in a forked process.
    scenes = [
        (as_numpy(scene[0]), *scene[1:]) if isinstance(scene, tuple) and scene else scene
        for scene in scenes
    ]
    if config.mode != "points":
        raise InputError(f"mode is {config.mode!r}, expected points for a batch")
    # Modules for processes take a twentieth of a small refinement to import.
    from .workers import processes_for, spread, stop_flag

    processes = processes_for(len(scenes))
    batch, losses, done = _Batch(scenes, config, stop_flag(processes)), [], 0

    def report(result: RefineResult | TsoError) -> None:
        nonlocal done
        done += 1
        if isinstance(result, RefineResult):
            losses.append(result.loss_after)
        if progress is not None:
            progress(done, len(scenes), float(np.mean(losses)) if losses else np.nan)

    with planned(*batch.work(), len(scenes) * config.settings().seconds), blas.one_thread():
        return spread(batch.refine, len(scenes), processes, batch.interrupted, report)


@dataclass(frozen=True, eq=False)
class _Batch:
    """Scenes that are refined independently of one another."""

    scenes: list[tuple[Any, Any]]
    config: RefineConfig
    interrupted: Any  # an event

    def work(self) -> tuple[int, int]:
        """That of all scenes, as `planned` counts it; broken ones count as nothing."""
        comparisons = points = 0
        for scene in self.scenes:
            try:
                views = 1 if isinstance(scene[1], View) else len(scene[1])
                of_scene, points_of_scene = _work(self.config.settings(views), views, len(scene[0]))
            except (TypeError, LookupError):
                continue
            comparisons, points = comparisons + of_scene, points + points_of_scene
        return comparisons, points

    def refine(self, number: int) -> RefineResult | TsoError:
        """The result of the scene of that number, or the error that `refine` would have raised."""
        while True:
            try:
                result = self._refined(number)
            except TsoError as error:
                return error
            except KeyboardInterrupt:
                self.interrupted.set()
                continue
            if result.stop_reason == "interrupted":
                self.interrupted.set()
            return result

    def _refined(self, number: int) -> RefineResult:
        points, masks = _points_and_views(self.scenes[number], number)
        views, stopwatch = _as_views(masks), Stopwatch()
        settings = self.config.settings(len(views))
        with stopwatch.phase("prepare"):
            problem = Problem.of(Cloud(points, f"points of scene {number}"), views, settings)
        return run(problem, settings, stopwatch, None, self._pause, self.interrupted.is_set())

    def _pause(self, step: int, steps: int, loss: float) -> None:
        if self.interrupted.is_set():
            raise KeyboardInterrupt


def compile_loops() -> None:
    """Compile all loops that a refinement uses, and keep the machine code on disk; nothing where it is there."""
    mask = np.zeros((64, 64), np.float32)
    # Larger than the cloud, so that pixels look for their nearest points too.
    mask[4:60, 4:60] = 1.0
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (600, 3))
    much = 1 << 60
    with planned(much, much):
        for preset in PRESETS:
            refine(points, mask, config=RefineConfig(steps=3, preset=preset))


def _as_views(masks: Any, cameras: Camera | Sequence[Camera] | None = None) -> tuple[View, ...]:
    """One `View` for each mask."""
    if isinstance(masks, View):
        masks = [masks]
    if isinstance(masks, Sequence) and masks and all(isinstance(mask, View) for mask in masks):
        if cameras is not None:
            raise InputError("views bring their own cameras, expected none beside them")
        return tuple(masks)
    if getattr(masks, "ndim", None) == 2:
        masks = [masks]
    try:
        arrays = [_as_array(mask) for mask in masks]
    except (TypeError, ValueError):
        raise InputError(
            "masks are no arrays of numbers, expected one [H, W] or a sequence of them"
        ) from None
    if any(mask.ndim != 2 for mask in arrays):
        raise InputError(
            f"a mask has shape {[list(m.shape) for m in arrays if m.ndim != 2][0]}, expected [H, W]"
        )
    if cameras is None:
        cameras = [Camera.canonical(mask.shape[-1], mask.shape[0]) for mask in arrays]
    elif isinstance(cameras, Camera):
        cameras = [cameras]
    if len(arrays) == 0 or len(arrays) != len(cameras):
        raise InputError(
            f"found {len(arrays)} masks and {len(cameras)} cameras, expected one camera for each mask"
        )
    return tuple(
        View(mask, camera, name=f"mask {i}")
        for i, (mask, camera) in enumerate(zip(arrays, cameras, strict=True))
    )


def _as_array(mask: Any) -> NDArray[np.float32]:
    return np.asarray(as_numpy(mask), dtype=np.float32)


def _points_and_views(scene: Any, number: int) -> tuple[Any, Any]:
    try:
        points, views = scene
    except (TypeError, ValueError):
        shown = (
            f"{type(scene).__name__} of {len(scene)}" if hasattr(scene, "__len__") else repr(scene)
        )
        raise InputError(f"scene {number} is {shown}, expected (points, views)") from None
    return points, views
