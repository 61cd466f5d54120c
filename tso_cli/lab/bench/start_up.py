"""Seconds that whole commands take from the shell."""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import TsoError
from ...io.shipped import examples_folder
from .material import cloud
from .timing import Setting, Timing

PACKAGE = Path(__file__).resolve().parents[2]
Prepare = Callable[[Path], dict[str, str]]
"""Given an empty folder, the environment variables of a run."""
TSO = ("-m", "tso_cli")
REFINE = "tso refine --mode points"
REFINE_LARGE = f"{REFINE}, 16,384 points"


def measure(setting: Setting, repeats: int = 5) -> list[dict[str, Any]]:
    """Wall times of `tso` commands, of bare Python and of ``import torch``, by turns; low and high are the extremes.

    A *first* run finds no byte code of tso and no compiled loops. Each command runs ``repeats`` times, after one run that is
    not counted.

    Raises TsoError if a command fails, InputError if the shipped examples are missing.
    """
    setting.report("start-up")
    with tempfile.TemporaryDirectory() as folder:
        commands = _commands(Path(folder))
        seconds: dict[str, list[float]] = {name: [] for name in commands}
        if REFINE_LARGE in commands:
            _run("tso compile", (*TSO, "compile"), _warm)
        for turn in range(repeats + 1):
            for name, (arguments, prepare) in commands.items():
                # Runs that are prepared anew need no warm-up.
                if turn or prepare is _warm:
                    seconds[name].append(_run(name, arguments, prepare))
    timings = {
        n: Timing(statistics.median(v[-repeats:]), min(v[-repeats:]), max(v[-repeats:]), repeats) for n, v in seconds.items()
    }
    return [setting.record("start-up", name, timing) for name, timing in timings.items()]


def _commands(folder: Path) -> dict[str, tuple[tuple[str, ...], Prepare]]:
    """Name -> Python's arguments and the preparation; the larger cloud is written to ``folder``."""
    chair = examples_folder() / "chair"
    many = folder / "many.npy"
    np.save(many, cloud(16384))
    refine, large = (
        (*TSO, "refine", "--mode", "points", str(points), str(chair / "mask.png")) for points in (chair / "initial.ply", many)
    )
    return {
        "python": (("-c", "pass"), _warm),
        "import torch": (("-c", "import torch"), _warm),
        "tso --version": ((*TSO, "--version"), _warm),
        "tso --help": ((*TSO, "--help"), _warm),
        REFINE: (refine, _warm),
        f"{REFINE}, first": (refine, _first),
        REFINE_LARGE: (large, _warm),
        f"{REFINE_LARGE}, first": (large, _first),
    }


def _run(name: str, arguments: tuple[str, ...], prepare: Prepare) -> float:
    """Wall time of one process, in seconds."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder) / "work"
        work.mkdir()
        # With this set, no byte code would be kept and every run would be a first one.
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
        environment |= prepare(Path(folder))
        command = [sys.executable, *arguments]
        start = time.perf_counter()
        done = subprocess.run(command, cwd=work, env=environment, stdin=subprocess.DEVNULL, capture_output=True)
        elapsed = time.perf_counter() - start
    if done.returncode:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or ["nothing"])[-1]
        raise TsoError(f"{name}: ended with exit code {done.returncode}, saying {last!r}")
    return elapsed


def _warm(folder: Path) -> dict[str, str]:
    return {"PYTHONPATH": str(PACKAGE.parent)}


def _first(folder: Path) -> dict[str, str]:
    ignored = shutil.ignore_patterns("__pycache__", "weights", "examples")
    shutil.copytree(PACKAGE, folder / "fresh" / PACKAGE.name, ignore=ignored)
    return {"PYTHONPATH": str(folder / "fresh"), "NUMBA_CACHE_DIR": str(folder / "compiled")}
