"""Seconds that whole commands take from the shell."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np

from ...io.shipped import examples_folder
from .material import cloud
from .timing import IMPORT_TORCH, PACKAGE, Contestant, Records, Setting, as_installed, process

TSO = ("-m", "tso_cli")
REFINE = "tso refine --mode points"
SIZES = (1024, 16384)


def measure(setting: Setting) -> Records:
    """Processes of bare Python, of `import torch` and of `tso` commands; a first run finds no byte code and no compiled loops.

    Raises TsoError if a command fails, InputError if the shipped examples are missing.
    """
    with tempfile.TemporaryDirectory() as folder:
        return setting.race("command", contestants(Path(folder), setting.seed), "over_import_torch")


def contestants(folder: Path, seed: int = 0) -> list[Contestant]:
    """The commands, `import torch` first; the clouds that they refine are written to ``folder``."""
    plain = {"python": ("-c", "pass"), "tso --version": (*TSO, "--version"), "tso --help": (*TSO, "--help")}
    commands = [IMPORT_TORCH, *(Contestant(name, process(name, arguments)) for name, arguments in plain.items())]
    for points in SIZES:
        path = folder / f"{points}.npy"
        np.save(path, cloud(points, seed))
        arguments = (*TSO, "refine", "--mode", "points", str(path), str(examples_folder() / "chair" / "mask.png"))
        for call, environment in (("steady", as_installed), ("first", never_run)):
            name = f"{REFINE}, {points:,} points" + (", first run" if call == "first" else "")
            commands.append(Contestant(name, process(name, arguments, environment), {"points": points, "call": call}))
    return commands


def never_run(folder: Path) -> dict[str, str]:
    """The environment of a copy of the package without byte code and compiled loops."""
    ignored = shutil.ignore_patterns("__pycache__", "weights", "examples")
    shutil.copytree(PACKAGE, folder / "fresh" / PACKAGE.name, ignore=ignored)
    return {"PYTHONPATH": str(folder / "fresh"), "NUMBA_CACHE_DIR": str(folder / "compiled")}
