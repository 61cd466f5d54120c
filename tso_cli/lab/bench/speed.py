"""All measurements in one record."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from threadpoolctl import threadpool_limits

from ...refinement.api import compile_loops
from ...version import __version__
from . import PARTS
from .claims import claims
from .timing import Record, Setting

CONVENTION = {
    "seconds": "wall clock; median and quartiles (low, high) of the runs, contestants of a part by turns in one process; one "
    "thread where nothing else is said",
    "command": "whole processes; a first run finds no byte code of tso and no compiled loops",
    "object": "`refine` in process, one chair, masks of 256x256; a first call is that of a fresh process, without its imports; "
    "peak memory is that of this process, with Python and all libraries",
    "parts": "one call of each part of the default preset, with two masks and a mirror plane; the factors are those of all "
    "stages, and a product with each",
    "batch": "seconds of a call over the objects in it, 1,024 points each; a busy neighbour spins on every core",
    "silhouette": "from projected points to the gradient by them of sums and cross-entropy, one picture, sigma^2 0.4 px^2; tso "
    "in numpy float64, else float32; the scatter lacks the term for mask pixels that no window reaches",
    "chamfer": "one step, value and gradient, mean of those after 10, 30 and 50 steps of the preset paper",
    "training": "a step of 16 images without the optimiser; the bare network's forward and backward beside it; waiting: share "
    "of such steps in which the network waits for a batch that threads prepare ahead",
}
PROCESSORS = Path("/proc/cpuinfo")


def speed(setting: Setting, only: Sequence[str] = ()) -> Record:
    """Measure the parts named in ``only``; all of them where it is empty.

    Returns
    -------
    {"bench": "speed", "command", "machine", "versions", "seed", "seconds" in all, "convention", "claims", "records"}; every
    record holds "what", "name", "points", "side", "runs", and "seconds" ("median", "low", "high"; None where it was left out,
    which "left_out" explains), with a ratio to the first contestant: "over_import_torch", "over_tso" or "of_refine".
    """
    begun = time.perf_counter()
    compile_loops()
    chosen = [name for name in PARTS if name in (only or PARTS)]
    records = []
    for name in chosen:
        measure = getattr(import_module(f".{PARTS[name]}", __package__), f"measure_{name}")
        with threadpool_limits(1):
            records += measure(setting)
    return {
        "bench": "speed",
        "command": "tso bench speed",
        "machine": {"cpu": _processor(), "cores": os.cpu_count(), "platform": platform.platform(terse=True)},
        "versions": {"tso": __version__, "python": platform.python_version()}
        | {package: _version(package) for package in ("torch", "numpy", "numba", "scipy")},
        "seed": setting.seed,
        "seconds": time.perf_counter() - begun,
        "convention": {name: text for name, text in CONVENTION.items() if name in ("seconds", *chosen)},
        "claims": claims(records),
        "records": records,
    }


def _processor() -> str:
    lines = PROCESSORS.read_text().splitlines() if PROCESSORS.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def _version(package: str) -> str | None:
    with suppress(PackageNotFoundError):
        return version(package)
    return None
