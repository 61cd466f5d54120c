"""Wall-clock times of contestants that take turns: a busy machine slows all of them alike."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tso_cli.errors import TsoError
from tso_cli.io.shipped import PACKAGE

from ..study import Cases, Record, Report

Sample = Callable[[], float]
"""Does the work once, and returns the seconds that it took."""
BLOCK = 2e-3
"""Seconds for which quick work is repeated; single calls would measure cold caches."""
MOST_RUNS, FAR_OVER = 200, 30.0
"""Of a contestant; work that takes this many times the budget is done once."""


@dataclass(frozen=True, eq=False)
class Contestant:
    """One way to do the work.

    fields : added to its record. calls : calls or objects in one sample.
    warm_up : False for long work for which earlier contestants load everything.
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
    least_runs: int = 3

    def race(self, what: str, contestants: Sequence[Contestant], ratio: str) -> Cases:
        """A record of each contestant, timed by turns after a warm-up.

        Its field ``ratio`` is its time over the first contestant's.
        """
        for number, contestant in enumerate(contestants, 1):
            if contestant.warm_up:
                contestant.sample()
            self.report(f"warming up, {what}", number, len(contestants))
        blocks: list[list[float]] = [[] for _ in contestants]
        while waiting := [i for i, seconds in enumerate(blocks) if not self._enough(seconds)]:
            for i in waiting:
                blocks[i].append(_block(contestants[i].sample))
        records = []
        for contestant, seconds in zip(contestants, blocks, strict=True):
            of_calls = [value / contestant.calls for value in seconds]
            records.append(record(what, contestant.name, of_calls, **contestant.fields))
        first = records[0]["seconds"]["median"]
        return [row | {ratio: row["seconds"]["median"] / first} for row in records]

    def _enough(self, seconds: list[float]) -> bool:
        if len(seconds) < self.least_runs:
            return bool(seconds) and seconds[0] > FAR_OVER * self.budget
        total = sum(max(block, BLOCK) for block in seconds)
        return len(seconds) >= MOST_RUNS or total >= self.budget


def _block(sample: Sample) -> float:
    """Mean seconds of a call, over at least `BLOCK`."""
    seconds = [sample()]
    while sum(seconds) < BLOCK:
        seconds.append(sample())
    return sum(seconds) / len(seconds)


def record(what: str, name: str, taken: Sequence[float], **fields: Any) -> Record:
    """A flat record of one contestant, with median and quartiles of its times."""
    low, median, high = (float(value) for value in np.percentile(taken, [25, 50, 75]))
    seconds = {"median": median, "low": low, "high": high}
    head = {"what": what, "name": name, "points": None, "side": None}
    return {**head, "seconds": seconds, "runs": len(taken), **fields}


def timed(work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> Sample:
    """The work as a sample."""

    def sample() -> float:
        start = clock()
        work()
        return clock() - start

    return sample


def machine() -> dict[str, Any]:
    """Where times are taken."""
    names = proc_values("/proc/cpuinfo", "model name")
    cpu = next(names, platform.processor() or platform.machine())
    return {"cpu": cpu, "cores": os.cpu_count(), "platform": platform.platform(terse=True)}


def proc_values(path: str, key: str) -> Iterator[str]:
    """What a file of Linux says of ``key``; nothing on other systems."""
    lines = Path(path).read_text().splitlines() if Path(path).exists() else []
    return (line.partition(":")[2].strip() for line in lines if line.startswith(key))


def peak_memory() -> int | None:
    """Most MiB that this process took, as Linux counts them; None on other systems.

    The count of `resource` begins with the peak of the process that started this one.
    """
    peaks = proc_values("/proc/self/status", "VmHWM")
    return next((round(int(text.split()[0]) / 1024.0) for text in peaks), None)


def as_installed(folder: Path) -> dict[str, str]:
    paths = filter(None, (str(PACKAGE.parent), os.environ.get("PYTHONPATH")))
    return {"PYTHONPATH": os.pathsep.join(paths)}


def never_run(folder: Path) -> dict[str, str]:
    """The environment of a copy of the package, in an empty ``folder``, without byte code."""
    ignored = shutil.ignore_patterns("__pycache__", "examples")
    shutil.copytree(PACKAGE, folder / "fresh" / PACKAGE.name, ignore=ignored)
    return {"PYTHONPATH": str(folder / "fresh")}


def process(
    name: str,
    arguments: Sequence[str],
    environment: Callable[[Path], dict[str, str]] = as_installed,
) -> Sample:
    """A whole process of Python; TsoError if it fails."""

    def sample() -> float:
        with tempfile.TemporaryDirectory() as folder:
            variables = {**os.environ, **environment(Path(folder))}
            # With it no byte code would be kept, and every run would be a first one.
            variables.pop("PYTHONDONTWRITEBYTECODE", None)
            quiet: dict[str, Any] = {"stdin": subprocess.DEVNULL, "capture_output": True}
            start = time.perf_counter()
            ended = subprocess.run([sys.executable, *arguments], cwd=folder, env=variables, **quiet)
            elapsed = time.perf_counter() - start
        if ended.returncode:
            last = (ended.stderr.decode(errors="replace").strip().splitlines() or ["nothing"])[-1]
            raise TsoError(f"{name}: ended with exit code {ended.returncode}, saying {last!r}")
        return elapsed

    return sample
