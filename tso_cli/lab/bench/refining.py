"""Refinements: whole commands, single objects, their phases and memory, and batches."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager, nullcontext
from functools import partial
from itertools import product
from multiprocessing import get_context
from typing import Any
from unittest.mock import patch

import numpy as np
from threadpoolctl import threadpool_limits

from ...cloud import smooth_field
from ...diagnosis.agreement import Agreement
from ...errors import TsoError
from ...geometry.points import Array, normalise_longest_side, sample_surface, spread_subset
from ...geometry.view import View
from ...io.meshes import read_mesh
from ...io.shipped import examples_folder
from ...optimisation import symmetry
from ...optimisation.objective import MaskChamferObjective
from ...refinement import PRESETS, RefineConfig, refine, refine_batch
from ...refinement.run import Stopwatch
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
    in_form,
    never_run,
    peak_memory,
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
# Points of the largest cloud, which the default alone refines.
LARGE, CORES = 262_144, os.cpu_count() or 1
# Calls after the first that are taken apart in phases.
RUNS = 3
# What is timed within the phases; none of these calls another.
PIECES: dict[str, tuple[Any, str]] = {
    "agreement": (Agreement, "of"),
    "mirror plane": (symmetry, "find_mirror_plane"),
    "fields": (smooth_field.SmoothField, "__init__"),
    "factors": (smooth_field._Smoother, "__init__"),
    "solves": (smooth_field._Smoother, "__call__"),
    "mask loss": (MaskChamferObjective, "_of_masks"),
}
# (preset, points, views) -> numbers of clouds in a batch; those of `NEIGHBOURED` also run beside a busy neighbour.
BATCHES = {
    ("best", 1024, 1): (16, 64, 512),
    ("paper", 1024, 1): (16, 64),
    ("best", 16384, 1): (16,),
    **{("best", 1024, views): (16,) for views in MORE_VIEWS},
}
# So many clouds of a batch differ.
NEIGHBOURED, CLOUDS = 64, 16
# Ends with its parent, whatever becomes of that.
SPIN = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"
TSO = ("-m", "tso_cli")


def cloud(count: int, seed: int = 0) -> Array:
    """Initial points [count, 3], longest side 1."""
    mesh = read_mesh(START)
    samples = sample_surface(
        mesh.vertices, mesh.faces, max(count, SAMPLES), np.random.default_rng([seed, count])
    )
    return normalise_longest_side(
        samples[spread_subset(samples, count)] if count <= SPREAD else samples[:count]
    )


def chair_views(count: int = 1) -> list[View]:
    """The mask of the shipped chair, and silhouettes of its cloud turned about the vertical axis."""
    scene = load_points_scene(CHAIR / "target.ply", CHAIR / "mask.png")
    return views_around(
        scene.view, scene.points, np.radians(DEGREES_BETWEEN_VIEWS * np.arange(1, count))
    )


def measure_command(setting: Setting) -> Cases:
    """Processes of bare Python, of `import torch` and of `tso` commands; a first run finds no byte code and no compiled loops.

    Raises TsoError if a command fails, InputError if the shipped examples are missing.
    """
    plain = {
        "python": ("-c", "pass"),
        "tso --version": (*TSO, "--version"),
        "tso --help": (*TSO, "--help"),
    }
    contestants = [
        IMPORT_TORCH,
        *(Contestant(name, process(name, arguments)) for name, arguments in plain.items()),
    ]
    with tempfile.TemporaryDirectory() as folder:
        for points in SIZES:
            path = f"{folder}/{points}.npy"
            np.save(path, cloud(points, setting.seed))
            arguments = (*TSO, "refine", "--mode", "points", path, str(CHAIR / "mask.png"))
            for call, environment in (("steady", as_installed), ("first", never_run)):
                name = f"tso refine --mode points, {points:,} points" + (
                    ", first run" if call == "first" else ""
                )
                contestants.append(
                    Contestant(
                        name,
                        process(name, arguments, environment),
                        {"points": points, "call": call},
                    )
                )
        return setting.race("command", contestants, "over_import_torch")


def measure_object(
    setting: Setting, sizes: tuple[int, ...] = SIZES, large: int = LARGE, steps: int | None = None
) -> Cases:
    """Both forms of the loops, of both presets and with more views; the form that the default chooses, on one core and on all.

    A form "" is the one chosen.
    """
    cases = [
        (preset, points, 1, form, 1, False)
        for points in sizes
        for preset in PRESETS
        for form in FORMS
    ]
    more = [(large, 1), *((sizes[0], views) for views in MORE_VIEWS)]
    cases += [
        ("best", points, views, form, 1, False) for (points, views), form in product(more, FORMS)
    ]
    on_threads = product((*sizes, large), sorted({1, CORES}), (False, True))
    cases += [("best", points, 1, "", threads, busy) for points, threads, busy in on_threads]
    contestants = [IMPORT_TORCH]
    for preset, points, views, form, threads, busy in cases:
        config = RefineConfig(preset=preset, steps=steps)
        work = partial(refine, cloud(points, setting.seed), chair_views(views), config=config)
        fields = {
            "points": points,
            "preset": preset,
            "views": views,
            "form": form,
            "threads": threads,
            "busy": busy,
        }
        way = form or f"{threads} thread" + "s" * (threads > 1) + ", busy neighbour" * busy
        contestants.append(
            Contestant(f"{preset}, {way}", on_cores(timed(work, form), threads, busy), fields)
        )
    return setting.race("object", contestants, "over_import_torch")


def measure_phases(
    setting: Setting, sizes: tuple[int, ...] = (*SIZES, LARGE), views: tuple[int, ...] = MORE_VIEWS
) -> Cases:
    """The default at every size, and at the smallest with more views and as in a batch; each in a process of its own."""
    scenes = [
        *((points, 1, "") for points in sizes),
        *((sizes[0], count, "") for count in views),
        (sizes[0], 1, "compiled"),
    ]
    records = []
    for number, scene in enumerate(scenes, 1):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            records.append(pool.submit(_taken_apart, *scene, setting.seed).result())
        setting.report("phases", number, len(scenes))
    return records


def _taken_apart(points: int, views: int, form: str, seed: int) -> Record:
    work = partial(refine, cloud(points, seed), chair_views(views), config=RefineConfig())
    with in_form(form):
        first, *later = (work().seconds for _ in range(1 + RUNS))
        peak = peak_memory()
        # Timed in one more call, so that these clocks slow no other.
        stopwatch = Stopwatch()
        with ExitStack() as patches:
            for name, (owner, function) in PIECES.items():
                clocked = stopwatch.phase(name)(getattr(owner, function))
                patches.enter_context(patch.object(owner, function, clocked))
            whole = sum(work().seconds.values())
    of_these = stopwatch.seconds | {"rest": whole - sum(stopwatch.seconds.values())}
    phases = {name: float(np.median([seconds[name] for seconds in later])) for name in later[0]}
    low, median, high = np.percentile(
        [sum(seconds.values()) for seconds in later], [25, 50, 75]
    ).tolist()
    fields = {
        "points": points,
        "views": views,
        "form": form,
        "phases": phases,
        "of_these": of_these,
    }
    fields |= {"first": sum(first.values()), "peak_MiB": peak}
    return (
        record("phases", "best", seconds={"median": median, "low": low, "high": high}, runs=RUNS)
        | fields
    )


def measure_batch(
    setting: Setting,
    batches: Mapping[tuple[str, int, int], Sequence[int]] = BATCHES,
    steps: int | None = None,
) -> Cases:
    """Seconds an object of `refine`, and of `refine_batch` in one process and on all cores."""
    contestants = [IMPORT_TORCH]
    for (preset, points, views), sizes in batches.items():
        config, seen = RefineConfig(preset=preset, steps=steps), chair_views(views)
        scenes = [(cloud(points, setting.seed + number), seen) for number in range(CLOUDS)]
        scene = {"preset": preset, "points": points, "views": views}
        alone = on_cores(timed(partial(refine, *scenes[0], config=config)), 1)
        contestants.append(
            Contestant("refine", alone, scene | {"batch": 1, "processes": 1, "busy": False})
        )
        for size, count, busy in product(sizes, sorted({1, CORES}), (False, True)):
            if busy and size != NEIGHBOURED:
                continue
            work = partial(_refine_all, [scenes[number % CLOUDS] for number in range(size)], config)
            fields = scene | {"batch": size, "processes": count, "busy": busy}
            name = f"refine_batch of {size}" + ", busy neighbour" * busy
            sample = on_cores(timed(work), count, busy)
            contestants.append(
                Contestant(name, sample, fields, calls=size, warm_up=size <= NEIGHBOURED)
            )
    records = setting.race("batch", contestants, "over_import_torch")
    of_one = records[0]
    for row in records[1:]:
        of_one = row if row["name"] == "refine" else of_one
        row["over_refine"] = row["seconds"]["median"] / of_one["seconds"]["median"]
    return records


def _refine_all(scenes: list, config: RefineConfig) -> None:
    for result in refine_batch(scenes, config):
        if isinstance(result, TsoError):
            raise result


def on_cores(work: Sample, count: int, busy: bool = False) -> Sample:
    """The work in so many processes or threads; with ``busy`` while a process spins on every core."""

    def sample() -> float:
        neighbour = busy_neighbour() if busy else nullcontext()
        with (
            patch.dict(os.environ, OMP_NUM_THREADS=str(count)),
            threadpool_limits(count),
            neighbour,
        ):
            return work()

    return sample


@contextmanager
def busy_neighbour() -> Iterator[list[subprocess.Popen[bytes]]]:
    """A process that spins on every core inside the block."""
    spinners = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range(CORES)]
    try:
        yield spinners
    finally:
        for spinner in spinners:
            spinner.kill()
            spinner.wait()
