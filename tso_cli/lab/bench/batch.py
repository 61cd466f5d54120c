"""Many objects in one call: in one process, on all cores, and beside a busy neighbour."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial

from ...errors import TsoError
from ...refinement import PRESETS, RefineConfig, refine, refine_batch
from .material import chair_views, cloud
from .timing import IMPORT_TORCH, Contestant, Records, Sample, Setting, timed

SIZES, LARGE = (16, 64), (512,)
POINTS = 1024
# So many clouds differ.
CLOUDS = 16
# Ends with its parent, whatever becomes of that.
SPIN = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"


def measure(setting: Setting, sizes: tuple[int, ...] = (), steps: int | None = None, most: int | None = None) -> Records:
    """Seconds an object of `refine` and of `refine_batch`, in one process and on all cores (or ``most``)."""
    sizes = sizes or ((*SIZES, *LARGE) if setting.full else SIZES)
    neighboured = sizes[min(1, len(sizes) - 1)]
    clouds, views = [cloud(POINTS, setting.seed + number) for number in range(CLOUDS)], chair_views()
    contestants = [IMPORT_TORCH]
    for preset in PRESETS:
        config = RefineConfig(preset=preset, steps=steps, seed=setting.seed)
        alone = timed(partial(refine, clouds[0], views, config=config))
        contestants.append(Contestant("refine", alone, {"preset": preset, "batch": 1, "processes": 1, "busy": False}))
        for size in sizes:
            scenes = [(clouds[number % CLOUDS], views) for number in range(size)]
            work = partial(_refine_all, scenes, config)
            for count in sorted({1, most or os.cpu_count() or 1}):
                for busy in (False, True) if size == neighboured else (False,):
                    fields = {"preset": preset, "batch": size, "processes": count, "busy": busy}
                    name = f"refine_batch of {size}" + (", busy neighbour" if busy else "")
                    contestants.append(Contestant(name, on_processes(work, count, busy), fields, calls=size))
    records = setting.race("batch", contestants, "over_import_torch")
    alone_seconds = {row["preset"]: row["seconds"]["median"] for row in records if row["name"] == "refine"}
    for row in records[1:]:
        row |= {"points": POINTS, "over_refine": row["seconds"]["median"] / alone_seconds[row["preset"]]}
    return records


def _refine_all(scenes: list, config: RefineConfig) -> None:
    for result in refine_batch(scenes, config):
        if isinstance(result, TsoError):
            raise result


def on_processes(work: Callable[[], object], count: int, busy: bool = False) -> Sample:
    """The work in so many processes; with ``busy`` while a process spins on every core."""

    def sample() -> float:
        before = os.environ.get("OMP_NUM_THREADS")
        os.environ["OMP_NUM_THREADS"] = str(count)
        try:
            with busy_neighbour() if busy else ExitStack():
                return timed(work)()
        finally:
            os.environ.pop("OMP_NUM_THREADS")
            if before is not None:
                os.environ["OMP_NUM_THREADS"] = before

    return sample


@contextmanager
def busy_neighbour() -> Iterator[list[subprocess.Popen[bytes]]]:
    """A process that spins on every core inside the block."""
    spinners = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range(os.cpu_count() or 1)]
    try:
        yield spinners
    finally:
        for spinner in spinners:
            spinner.kill()
            spinner.wait()
