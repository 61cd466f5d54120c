"""Many scenes, refined one by one: `refine_each` and `refine_batch`."""

from __future__ import annotations

import math
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import numpy as np

from ..errors import InputError, Interrupted, TsoError
from ..geometry.arrays import as_numpy
from ..geometry.view import View
from ..io.reading import shown
from ..kernels import blas
from ..optimisation.config import RefineConfig, config_of
from ..signals import at_interrupt
from ..workers import Ended, Here, WorkerPool, cores, each
from .clock import Clock
from .result import RefineResult, as_given
from .run import run
from .scene import as_scene

# A process takes as long to start as this many small scenes take to refine. Fewer scenes than for
# two processes are refined in the process of the caller.
SCENES_TO_START = 8
# Scenes that wait with an executor: few, as scenes are made while others are refined.
AHEAD = 2

Scene = tuple[Any, Any]
"""Points [N, 3], and views: a `View` or a sequence of them."""


@dataclass(frozen=True, eq=False)
class _Job:
    number: int
    scene: Any
    config: RefineConfig


def refine_each(
    scenes: Iterable[Scene],
    config: RefineConfig | Mapping[str, Any] | None = None,
    *,
    executor: Executor | None = None,
    window: int | None = None,
) -> Iterator[tuple[int, RefineResult | TsoError]]:
    """Refine many scenes, and yield the number of each with its result as it ends.

    A scene that fails has its error in place of a result, and stops no other. If the process of a
    scene dies, the scene is tried once more, and at last alone (`tso_cli.workers.each`). A list of
    fewer than 16 scenes is refined in the process of the caller, which a scene can then end.

    Parameters
    ----------
    scenes : (points [N, 3], views) of each; or one pair of clouds [B, N, 3] and the views of each,
        or one `View` for all. They are taken a few at a time, so that a generator may make them.
    executor : does the work, in place of a process for each core. It must be able to pickle scenes;
        that of dask is `client.get_executor()`. If it breaks as a whole, processes of tso go on.
    window : scenes that are with the processes at once.  The default is two for each core.

    Raises InputError if the mode is not "points", or if an argument is of another kind.
    """
    return _each(_iterable(scenes), _config_of(config), _checked(executor), _window(window))


def refine_batch(
    scenes: Sequence[Scene],
    config: RefineConfig | Mapping[str, Any] | None = None,
    *,
    progress: Callable[[int, int, float], None] | None = None,
    executor: Executor | None = None,
) -> list[RefineResult | TsoError]:
    """`refine_each` of a list of scenes, in their order.

    Parameters
    ----------
    progress : called after every cloud with (clouds done, clouds, mean loss of their results).
    executor : as in `refine_each`.

    Ctrl-C ends the batch. Clouds at work get their best so far, with the ``stop_reason``
    "interrupted". Clouds that had not begun have the error `Interrupted` in place of a result.

    Raises InputError as `refine_each`.
    """
    config, executor = _config_of(config), _checked(executor)
    if progress is not None and not callable(progress):
        raise InputError(f"progress is {shown(progress)}, expected a function")
    scenes = list(_iterable(scenes))
    results: dict[int, RefineResult | TsoError] = {}
    losses: list[float] = []
    stop = threading.Event()
    for number, result in _each(scenes, config, executor, None, stop):
        results[number] = result
        if isinstance(result, RefineResult):
            losses.append(result.fit.loss_after)
        try:
            if progress is not None:
                mean = float(np.mean(losses)) if losses else math.nan
                progress(len(results), len(scenes), mean)
        except KeyboardInterrupt:
            stop.set()
    return [results.get(number) or _not_begun(number) for number in range(len(scenes))]


def _not_begun(number: int) -> Interrupted:
    return Interrupted(f"scene {number}: interrupted before it began")


def _config_of(config: RefineConfig | Mapping[str, Any] | None) -> RefineConfig:
    config = config_of(config)
    if config.mode != "points":
        raise InputError(f"mode is {config.mode!r}, expected points for a batch")
    return config


def _iterable(scenes: Iterable[Scene]) -> Iterable[Scene]:
    if not isinstance(scenes, Iterable):
        raise InputError(f"scenes is {shown(scenes)}, expected a sequence of (points, views)")
    if isinstance(scenes, tuple) and len(scenes) == 2 and getattr(scenes[0], "ndim", 0) == 3:
        clouds, views = scenes
        listed = [views] * len(clouds) if isinstance(views, View) else list(views)
        if len(listed) != len(clouds):
            raise InputError(
                f"found {len(listed)} views for {len(clouds)} clouds, expected one View, or as many"
            )
        return list(zip(clouds, listed, strict=True))
    return scenes


def _checked(executor: Executor | None) -> Executor | None:
    if not isinstance(executor, Executor | None):
        raise InputError(
            f"executor is {shown(executor)}, expected one of concurrent.futures, or that of "
            "client.get_executor() of dask"
        )
    return executor


def _window(window: int | None) -> int | None:
    if window is not None and not (isinstance(window, Integral) and window > 0):
        raise InputError(f"window is {shown(window)}, expected a whole number from 1")
    return window


def _processes(count: int | None) -> int:
    """How many processes refine ``count`` scenes, or an unknown number; 0 if the caller does."""
    if count is None:
        return cores()
    worth = count // SCENES_TO_START
    # One process too, if there is one core: a scene that ends its process does not end the caller.
    return min(cores(), worth) if worth > 1 else 0


def _each(
    scenes: Iterable[Scene],
    config: RefineConfig,
    executor: Executor | None,
    window: int | None,
    stop: threading.Event | None = None,
) -> Iterator[tuple[int, RefineResult | TsoError]]:
    """``stop`` is set at Ctrl-C; None if Ctrl-C is the caller's."""
    processes = _processes(len(scenes) if isinstance(scenes, Sized) else None)
    tensors: dict[int, Any] = {}

    def job(number: int, scene: Any) -> _Job:
        """A tensor on a GPU cannot be read in another process."""
        if isinstance(scene, tuple) and scene and hasattr(scene[0], "detach"):
            tensors[number] = scene[0].detach()[:0].clone()
            scene = (as_numpy(scene[0]), *scene[1:])
        return _Job(number, scene, config)

    jobs = (job(number, scene) for number, scene in enumerate(scenes))
    pool = WorkerPool(processes) if executor is None and processes else None
    most = window or (AHEAD * cores() if executor or pool else 1)

    def instead() -> Executor:
        nonlocal pool
        pool = WorkerPool(min(most, cores()))
        warnings.warn("the executor broke, so processes of tso refine the rest", stacklevel=2)
        return pool

    stopping = stop.is_set if stop else lambda: False
    try:
        with _passed_on(pool, stop):
            executor_of_jobs = executor or pool or Here()
            for ended in each(
                executor_of_jobs, _refined, jobs, most, stopping=stopping, instead=instead
            ):
                result = _result_of(ended)
                if stop is not None and _interrupted(result):
                    stop.set()
                number = ended.job.number
                if isinstance(result, RefineResult):
                    result = as_given(result, tensors.pop(number, None))
                if not isinstance(result, Interrupted):
                    yield number, result
    finally:
        if pool is not None:
            pool.shutdown(wait=False)


def _passed_on(
    pool: WorkerPool | None, stop: threading.Event | None
) -> AbstractContextManager[None]:
    """Pass Ctrl-C on to the processes; without processes it reaches the scene at work anyway."""
    if pool is None or stop is None:
        return nullcontext()

    def interrupt() -> None:
        stop.set()
        pool.interrupt()

    return at_interrupt(interrupt)


def _interrupted(result: RefineResult | TsoError) -> bool:
    if isinstance(result, RefineResult):
        return result.fit.stop_reason == "interrupted"
    return isinstance(result, Interrupted)


def _result_of(ended: Ended[_Job]) -> RefineResult | TsoError:
    """The result, whose warnings are given here, or the error as a `TsoError`."""
    error, where = ended.error, f"scene {ended.job.number}"
    if error is None:
        result, caught = ended.result
        for warning in caught:
            warnings.warn(warning, stacklevel=2)
        assert isinstance(result, RefineResult)
        return result
    if isinstance(error, TsoError):
        return error
    if isinstance(error, KeyboardInterrupt):
        return _not_begun(ended.job.number)
    failure = TsoError(f"{where}: {ended.failure}")
    failure.__cause__ = error
    return failure


def _refined(job: _Job) -> tuple[RefineResult, list[Warning]]:
    """The result, and the warnings on the way, which may arise in another process."""
    number = job.number
    with warnings.catch_warnings(record=True) as caught, blas.one_thread():
        warnings.simplefilter("always", UserWarning)
        try:
            points, masks = _points_and_views(job.scene, number)
            clock = Clock()
            with clock.phase("prepare"):
                scene = as_scene(points, masks, name=f"points of scene {number}")
            result = run(scene, job.config.settings(), clock)
        except KeyboardInterrupt:
            raise _not_begun(number) from None
    texts = [warning.message for warning in caught if isinstance(warning.message, Warning)]
    return result, texts


def _points_and_views(scene: Any, number: int) -> Scene:
    try:
        points, views = scene
    except (TypeError, ValueError):
        sized = hasattr(scene, "__len__")
        what = f"{type(scene).__name__} of {len(scene)}" if sized else repr(scene)
        raise InputError(f"scene {number} is {what}, expected (points, views)") from None
    return points, views
