"""Refinements phase by phase: the first call of a process, later ones, and the memory that it takes."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from ...refinement import RefineConfig, refine
from ..study import Cases, Record
from .refining import MORE_VIEWS, SIZES, chair_views, cloud
from .timing import Setting, record

LARGE = 262_144
RUNS = 3
PROCESS = Path("/proc/self/status")


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
