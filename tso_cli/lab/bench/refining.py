"""Refinements: whole commands, single objects, their phases and memory, and batches."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from functools import partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from unittest.mock import patch

import numpy as np

from ...errors import TsoError
from ...geometry.points import Array, normalise_longest_side, sample_surface, spread_subset
from ...geometry.view import View
from ...io.meshes import read_mesh
from ...io.shipped import examples_folder
from ...refinement import PRESETS, RefineConfig, refine, refine_batch
from ...scene.load import load_points_scene
from ..study import Cases, Record
from ..views import views_around
from .timing import (
    FORMS,
    IMPORT_TORCH,
    Contestant,
    Sample,
    Setting,
    as_installed,
    never_run,
    process,
    record,
    timed,
)

CHAIR = examples_folder() / "chair"
# The example starts from points of this shape.
START = examples_folder() / "meshes" / "chair" / "q17_ChairHandle.ply"
# Clouds of up to so many points are spread evenly, like those of data sets: else no mirror plane would be found.
SPREAD, SAMPLES = 1024, 8192
DEGREES_BETWEEN_VIEWS = 50.0
SIZES = (1024, 16384)
# Numbers of views of the default preset, at the smallest size.
MORE_VIEWS = (2, 4)
# Points of the largest cloud that is taken apart in phases, calls after the first, and where Linux tells how much they took.
LARGE, RUNS, PROCESS = 262_144, 3, Path("/proc/self/status")
BATCHES = (16, 64)
# Of each object of a batch; so many clouds differ.
POINTS, CLOUDS = 1024, 16
# Ends with its parent, whatever becomes of that.
SPIN = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"
TSO = ("-m", "tso_cli")


def cloud(count: int, seed: int = 0) -> Array:
    """Initial points [count, 3], longest side 1."""
    mesh = read_mesh(START)
    samples = sample_surface(mesh.vertices, mesh.faces, max(count, SAMPLES), np.random.default_rng([seed, count]))
    return normalise_longest_side(samples[spread_subset(samples, count)] if count <= SPREAD else samples[:count])


def chair_views(count: int = 1) -> list[View]:
    """The mask of the shipped chair, and silhouettes of its cloud turned about the vertical axis."""
    scene = load_points_scene(CHAIR / "target.ply", CHAIR / "mask.png")
    return views_around(scene.view, scene.points, np.radians(DEGREES_BETWEEN_VIEWS * np.arange(1, count)))


def measure_command(setting: Setting) -> Cases:
    """Processes of bare Python, of `import torch` and of `tso` commands; a first run finds no byte code and no compiled loops.

    Raises TsoError if a command fails, InputError if the shipped examples are missing.
    """
    plain = {"python": ("-c", "pass"), "tso --version": (*TSO, "--version"), "tso --help": (*TSO, "--help")}
    contestants = [IMPORT_TORCH, *(Contestant(name, process(name, arguments)) for name, arguments in plain.items())]
    with tempfile.TemporaryDirectory() as folder:
        for points in SIZES:
            path = f"{folder}/{points}.npy"
            np.save(path, cloud(points, setting.seed))
            arguments = (*TSO, "refine", "--mode", "points", path, str(CHAIR / "mask.png"))
            for call, environment in (("steady", as_installed), ("first", never_run)):
                name = f"tso refine --mode points, {points:,} points" + (", first run" if call == "first" else "")
                contestants.append(Contestant(name, process(name, arguments, environment), {"points": points, "call": call}))
        return setting.race("command", contestants, "over_import_torch")


def measure_object(setting: Setting, sizes: tuple[int, ...] = SIZES, steps: int | None = None) -> Cases:
    """Both presets in both forms of the loops at every size, and the default with more views."""
    cases = [(preset, points, 1) for points in sizes for preset in PRESETS]
    cases += [("best", sizes[0], views) for views in MORE_VIEWS]
    contestants = [IMPORT_TORCH]
    for (preset, points, views), form in product(cases, FORMS):
        config = RefineConfig(preset=preset, steps=steps)
        work = partial(refine, cloud(points, setting.seed), chair_views(views), config=config)
        fields = {"points": points, "preset": preset, "views": views, "form": form}
        contestants.append(Contestant(f"{preset}, {form}", timed(work, form), fields))
    return setting.race("object", contestants, "over_import_torch")


def measure_phases(setting: Setting, sizes: tuple[int, ...] = (*SIZES, LARGE), views: tuple[int, ...] = MORE_VIEWS) -> Cases:
    """The default at every size, and at the smallest with more views; each in a process that does nothing else."""
    records, scenes = [], [*((points, 1) for points in sizes), *((sizes[0], count) for count in views)]
    for number, (points, count) in enumerate(scenes, 1):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            records.append(pool.submit(_taken_apart, points, count, setting.seed).result())
        setting.report("phases", number, len(scenes))
    return records


def _taken_apart(points: int, views: int, seed: int) -> Record:
    work, seen = cloud(points, seed), chair_views(views)
    first, *later = (refine(work, seen, config=RefineConfig()).seconds for _ in range(1 + RUNS))
    phases = {name: float(np.median([seconds[name] for seconds in later])) for name in later[0]}
    low, median, high = np.percentile([sum(seconds.values()) for seconds in later], [25, 50, 75]).tolist()
    # Linux alone says so; what `resource` says begins with the peak of the process that started this one.
    status = PROCESS.read_text() if PROCESS.exists() else ""
    peak = [round(int(line.split()[1]) / 1024.0) for line in status.splitlines() if line.startswith("VmHWM:")]
    fields = {"points": points, "views": views, "phases": phases, "first": sum(first.values()), "peak_MiB": (*peak, None)[0]}
    return record("phases", "best", seconds={"median": median, "low": low, "high": high}, runs=RUNS) | fields


def measure_batch(
    setting: Setting, sizes: tuple[int, ...] = BATCHES, steps: int | None = None, most: int | None = None
) -> Cases:
    """Seconds an object of `refine` and of `refine_batch`, in one process and on all cores (or ``most``)."""
    neighboured = sizes[min(1, len(sizes) - 1)]
    clouds, views = [cloud(POINTS, setting.seed + number) for number in range(CLOUDS)], chair_views()
    contestants = [IMPORT_TORCH]
    for preset in PRESETS:
        config = RefineConfig(preset=preset, steps=steps)
        alone = timed(partial(refine, clouds[0], views, config=config))
        contestants.append(Contestant("refine", alone, {"preset": preset, "batch": 1, "processes": 1, "busy": False}))
        for size, count, busy in product(sizes, sorted({1, most or os.cpu_count() or 1}), (False, True)):
            if busy and size != neighboured:
                continue
            work = partial(_refine_all, [(clouds[number % CLOUDS], views) for number in range(size)], config)
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
        with patch.dict(os.environ, OMP_NUM_THREADS=str(count)), busy_neighbour() if busy else nullcontext():
            return timed(work)()

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
