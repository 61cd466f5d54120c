"""Wall-clock times of contestants that take turns, so that a busy machine slows all of them alike."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import TsoError
from ...kernels.dispatch import planned
from ..study import Cases, Record, Report

Sample = Callable[[], float]
"""Does the work once, and returns the seconds that it took."""

PACKAGE = Path(__file__).resolve().parents[2]
# Quick work is repeated for so many seconds at a time: with cold caches each turn would measure these.
BLOCK = 2e-3
MOST_RUNS, LEAST_RUNS = 200, 3
# Work that takes this many times the budget is done once.
FAR_OVER = 30.0
# Form of the loops -> the work that `planned` is told of: none, or so much that compiling pays.
FORMS = {"compiled": 1 << 60, "numpy": 0}


@dataclass(frozen=True, eq=False)
class Contestant:
    """``calls`` is how many calls or objects one sample is; ``fields`` are added to the record.

    ``warm_up`` is False of long work for which contestants before it load everything.
    """

    name: str
    sample: Sample
    fields: dict[str, Any] = field(default_factory=dict)
    calls: int = 1
    warm_up: bool = True


@dataclass(frozen=True)
class Setting:
    """Settings of a whole run: ``budget`` is in seconds for each contestant."""

    budget: float = 0.5
    seed: int = 0
    report: Report = lambda what, done, total: None

    def race(self, what: str, contestants: Sequence[Contestant], ratio: str) -> Cases:
        """A record of each contestant, timed by turns after a warm-up; its field ``ratio`` is its time over the first one's.

        Each is given the budget in 3 to 200 blocks; work that lasts thirty times the budget is done once.
        """
        for number, contestant in enumerate(contestants, 1):
            if contestant.warm_up:
                contestant.sample()
            self.report(f"warming up, {what}", number, len(contestants))
        blocks: list[list[float]] = [[] for _ in contestants]
        while waiting := [i for i, taken in enumerate(blocks) if not self._enough(taken)]:
            for i in waiting:
                blocks[i].append(_block(contestants[i].sample))
        records = []
        for contestant, taken in zip(contestants, blocks, strict=True):
            low, median, high = np.percentile(taken, [25, 50, 75]) / contestant.calls
            seconds = {"median": float(median), "low": float(low), "high": float(high)}
            records.append(
                record(what, contestant.name, seconds=seconds, runs=len(taken)) | contestant.fields
            )
        first = records[0]["seconds"]["median"]
        return [row | {ratio: row["seconds"]["median"] / first} for row in records]

    def _enough(self, taken: list[float]) -> bool:
        if len(taken) < LEAST_RUNS:
            return bool(taken) and taken[0] > FAR_OVER * self.budget
        return len(taken) >= MOST_RUNS or sum(max(block, BLOCK) for block in taken) >= self.budget


def _block(sample: Sample) -> float:
    """Mean seconds of a call, over at least `BLOCK`."""
    taken = [sample()]
    while sum(taken) < BLOCK:
        taken.append(sample())
    return sum(taken) / len(taken)


def record(what: str, name: str, **fields: Any) -> Record:
    """A flat record of one contestant; without ``seconds`` the field "left_out" says why."""
    return {
        "what": what,
        "name": name,
        "points": None,
        "side": None,
        "seconds": None,
        "runs": 0,
    } | fields


def timed(work: Callable[[], object], form: str = "") -> Sample:
    """The work in a form of the loops: "numpy", "compiled", or that which it would choose itself."""

    def sample() -> float:
        start = time.perf_counter()
        with in_form(form):
            work()
        return time.perf_counter() - start

    return sample


def in_form(form: str) -> AbstractContextManager[None]:
    """Inside, loops run in this form; without one, in that which the work chooses."""
    return planned(FORMS[form], FORMS[form]) if form else nullcontext()


def peak_memory() -> int | None:
    """MiB that this process took at most, as Linux tells it; None elsewhere.

    What `resource` says begins with the peak of the process that started this one.
    """
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return next(
        (round(int(line.split()[1]) / 1024.0) for line in lines if line.startswith("VmHWM:")), None
    )


Environment = Callable[[Path], dict[str, str]]
"""Given an empty folder, the environment variables of a process."""


def as_installed(folder: Path) -> dict[str, str]:
    return {
        "PYTHONPATH": os.pathsep.join(
            filter(None, (str(PACKAGE.parent), os.environ.get("PYTHONPATH")))
        )
    }


def never_run(folder: Path) -> dict[str, str]:
    """The environment of a copy of the package without byte code and compiled loops."""
    ignored = shutil.ignore_patterns("__pycache__", "weights", "examples")
    shutil.copytree(PACKAGE, folder / "fresh" / PACKAGE.name, ignore=ignored)
    return {"PYTHONPATH": str(folder / "fresh"), "NUMBA_CACHE_DIR": str(folder / "compiled")}


def process(name: str, arguments: Sequence[str], environment: Environment = as_installed) -> Sample:
    """A whole process of Python; TsoError if it fails."""

    def sample() -> float:
        with tempfile.TemporaryDirectory() as folder:
            # With PYTHONDONTWRITEBYTECODE no byte code would be kept, and every run would be a first one.
            variables = {
                key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"
            }
            variables |= environment(Path(folder))
            start = time.perf_counter()
            done = subprocess.run(
                [sys.executable, *arguments],
                cwd=folder,
                env=variables,
                stdin=subprocess.DEVNULL,
                capture_output=True,
            )
            elapsed = time.perf_counter() - start
        if done.returncode:
            last = (done.stderr.decode(errors="replace").strip().splitlines() or ["nothing"])[-1]
            raise TsoError(f"{name}: ended with exit code {done.returncode}, saying {last!r}")
        return elapsed

    return sample


IMPORT_TORCH = Contestant("import torch", process("import torch", ("-c", "import torch")))
"""What times are compared with: the first thing that a program with torch does."""
