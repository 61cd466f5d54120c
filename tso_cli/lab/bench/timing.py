"""Wall-clock times of contestants that take turns, so that a busy machine slows all of them alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

# Seconds that a sample lasts at least: quick work is repeated, or the clock and the loop would count.
SAMPLE = 2e-3
MOST_RUNS, LEAST_RUNS = 200, 3
# Work that takes this many times the budget is sampled once.
FAR_OVER = 10.0

Work = Callable[[], object]


@dataclass(frozen=True)
class Timing:
    """Median and quartiles of the seconds that a piece of work takes, from ``runs`` samples."""

    median: float
    low: float
    high: float
    runs: int

    def scaled(self, factor: float) -> Timing:
        return Timing(self.median * factor, self.low * factor, self.high * factor, self.runs)


@dataclass(frozen=True)
class Setting:
    """Settings of a whole run.

    threads : of torch and of the compiled loops. budget : seconds to spend on each contestant. full : whether the large sizes
    are measured too. report : called with the name of the next measurement.
    """

    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    threads: int = 1
    budget: float = 0.5
    full: bool = False
    seed: int = 0
    report: Callable[[str], None] = lambda _: None

    def race(self, contestants: Mapping[str, Work]) -> dict[str, Timing]:
        """Seconds of one call of each contestant, timed by turns after a warm-up.

        Each is given the budget in 3 to 200 samples; work that lasts ten times the budget is sampled once.
        """
        repeats: dict[str, int] = {}
        samples: dict[str, list[float]] = {}

        def enough(name: str) -> bool:
            taken = samples[name]
            if len(taken) < LEAST_RUNS:
                return bool(taken) and taken[0] > FAR_OVER * self.budget
            return len(taken) >= MOST_RUNS or sum(taken) * repeats[name] >= self.budget

        for name, work in contestants.items():
            self._sample(work, 1)
            once = self._sample(work, 1)
            repeats[name] = max(1, round(SAMPLE / max(once, 1e-7)))
            samples[name] = [once] if once > self.budget else []
        while waiting := [name for name in contestants if not enough(name)]:
            for name in waiting:
                samples[name].append(self._sample(contestants[name], repeats[name]))
        timings = {}
        for name, taken in samples.items():
            low, median, high = (float(value) for value in np.percentile(taken, [25, 50, 75]))
            timings[name] = Timing(median, low, high, len(taken))
        return timings

    def _sample(self, work: Work, repeats: int) -> float:
        self._synchronise()
        start = time.perf_counter()
        for _ in range(repeats):
            work()
        self._synchronise()
        return (time.perf_counter() - start) / repeats

    def _synchronise(self) -> None:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)

    def record(self, what: str, name: str, timing: Timing | None = None, **fields: Any) -> dict[str, Any]:
        """A flat record of one contestant; ``fields`` override and add."""
        return {
            "what": what,
            "name": name,
            "points": None,
            "side": None,
            "batch": 1,
            "device": str(self.device),
            "threads": self.threads,
            "seconds": timing and {"median": timing.median, "low": timing.low, "high": timing.high},
            "runs": timing.runs if timing else 0,
        } | fields

    def records(self, what: str, timings: Mapping[str, Timing], ratio: str, **fields: Any) -> list[dict[str, Any]]:
        """A record of each contestant; its field ``ratio`` is its time over the first contestant's."""
        first = next(iter(timings.values())).median
        return [self.record(what, name, timing, **fields, **{ratio: timing.median / first}) for name, timing in timings.items()]

    def left_out(self, what: str, contestants: Mapping[str, Any], **fields: Any) -> list[dict[str, Any]]:
        """A record of every contestant that is a reason in place of work."""
        return [self.record(what, n, left_out=why, **fields) for n, why in contestants.items() if isinstance(why, str)]


def gradient(function: Callable[[Tensor], Tensor], variable: Tensor) -> Work:
    """Work: the summed value of ``function`` and its derivative by ``variable``."""
    leaf = variable.detach().clone().requires_grad_()
    return lambda: torch.autograd.grad(function(leaf).sum(), leaf)


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Let torch and the compiled loops use ``count`` CPU threads inside the block."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
