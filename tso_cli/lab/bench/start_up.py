"""How long whole commands take from the shell: the interpreter, the imports, the work and the end of the process."""

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

PACKAGE = Path(__file__).resolve().parent.parent

# Given an empty folder, the variables of the environment to set.
Prepare = Callable[[Path], dict[str, str]]

TORCH = ("-c", "import torch")
TSO = ("-m", "tso_cli")
LARGE = "tso refine --mode points, 16,384 points"


def start_up(repeats: int = 7) -> list[dict[str, Any]]:
    """Time command lines as whole processes, in turn, so that other load on the machine falls on all of them alike.

    Bare Python and the import of torch are what the commands are to be held against. A *first* run finds no byte code of tso
    (what an installer may leave undone) and an empty cache of compiled loops; a *bare* one finds no byte code of torch either.
    Neither empties the system's file cache.

    Parameters
    ----------
    repeats : counted runs of each, >= 1, after one that is not counted.

    Returns
    -------
    For each command line {"what": "start-up", "name", "seconds": {"median", "low", "high"}, "runs"}; low and high are the
    quickest and the slowest run.

    Raises
    ------
    TsoError
        A command fails.
    InputError
        The shipped examples are not there.
    """
    with tempfile.TemporaryDirectory() as folder:
        commands = _commands(Path(folder))
        seconds: dict[str, list[float]] = {name: [] for name in commands}
        if LARGE in commands:
            _run("tso compile", (*TSO, "compile"), _warm)
        for turn in range(repeats + 1):
            for name, (arguments, prepare) in commands.items():
                # The first of a kind that is prepared anew each time is as good as any other.
                if turn or prepare is _warm:
                    seconds[name].append(_run(name, arguments, prepare))
    return [_record(name, values[-repeats:]) for name, values in seconds.items()]


def _commands(folder: Path) -> dict[str, tuple[tuple[str, ...], Prepare]]:
    """For each name what Python is given, and what prepares its run; ``folder`` gets the larger cloud."""
    chair = examples_folder() / "chair"
    many = folder / "many.npy"
    np.save(many, cloud(16384))
    large = (*TSO, "refine", "--mode", "points", str(many), str(chair / "mask.png"))
    refine = (*TSO, "refine", "--mode", "points", str(chair / "initial.ply"), str(chair / "mask.png"))
    return {
        "python": (("-c", "pass"), _warm),
        "import torch": (TORCH, _warm),
        "tso --version": ((*TSO, "--version"), _warm),
        "tso --help": ((*TSO, "--help"), _warm),
        "tso refine --mode points": (refine, _warm),
        "tso refine --mode points, with picture": ((*refine, "--overlay", "picture.png"), _warm),
        "tso refine --mode points, first": (refine, _first),
        LARGE: (large, _warm),
        f"{LARGE}, first": (large, _first),
        "import torch, bare": (TORCH, _bare),
        "tso refine --mode points, bare": (refine, _bare),
    }


def _run(name: str, arguments: tuple[str, ...], prepare: Prepare) -> float:
    """Wall time of one process, in s."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder) / "work"
        work.mkdir()
        # With this set, nothing would ever be kept and every run would be a first one.
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
        environment |= prepare(Path(folder))
        start = time.perf_counter()
        done = subprocess.run(
            [sys.executable, *arguments], cwd=work, env=environment, stdin=subprocess.DEVNULL, capture_output=True
        )
        elapsed = time.perf_counter() - start
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip().splitlines() or ["nothing"]
        raise TsoError(f"{name}: ended with exit code {done.returncode}, saying {said[-1]!r}")
    return elapsed


def _warm(folder: Path) -> dict[str, str]:
    return {"PYTHONPATH": str(PACKAGE.parent)}


def _first(folder: Path) -> dict[str, str]:
    left_out = shutil.ignore_patterns("__pycache__", "weights", "examples")
    shutil.copytree(PACKAGE, folder / "fresh" / PACKAGE.name, ignore=left_out)
    return {"PYTHONPATH": str(folder / "fresh"), "NUMBA_CACHE_DIR": str(folder / "compiled")}


def _bare(folder: Path) -> dict[str, str]:
    return _warm(folder) | {"PYTHONPYCACHEPREFIX": str(folder / "bytecode"), "NUMBA_CACHE_DIR": str(folder / "compiled")}


def _record(name: str, values: list[float]) -> dict[str, Any]:
    spread = {"median": statistics.median(values), "low": min(values), "high": max(values)}
    return {"what": "start-up", "name": name, "seconds": spread, "runs": len(values)}
