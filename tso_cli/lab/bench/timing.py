"""Wall-clock times of contestants that take turns in one process, so that a busy machine is busy for all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

# A sample takes this long at least, in seconds: below it the clock and the loop around the work would show.
SAMPLE = 2e-3
# Samples of each contestant, however quick or slow it is.
MOST_RUNS, LEAST_RUNS = 200, 3
# What takes so many times its budget is sampled once.
FAR_OVER = 10.0

Work = Callable[[], object]


@dataclass(frozen=True)
class Timing:
    """Median and quartiles of the seconds that a piece of work takes, and how many samples they are from."""

    median: float
    low: float
    high: float
    runs: int

    def scaled(self, factor: float) -> Timing:
        """The seconds times ``factor``, from as many samples."""
        return Timing(self.median * factor, self.low * factor, self.high * factor, self.runs)


@dataclass(frozen=True)
class Setting:
    """What holds for every measurement of a run.

    Parameters
    ----------
    device : where the work is done.
    threads : of torch and of the compiled loops.
    budget : seconds that each contestant is measured for; slow ones are run three times all the same, or once.
    full : the large sizes too.
    seed : of everything random.
    report : called with what is measured next.
    """

    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    threads: int = 1
    budget: float = 0.5
    full: bool = False
    seed: int = 0
    report: Callable[[str], None] = lambda _: None

    def race(self, contestants: Mapping[str, Work]) -> dict[str, Timing]:
        """As `race`, with this setting's budget and device."""
        return race(contestants, self.budget, self.synchronise)

    def synchronise(self) -> None:
        """Wait until the device has done what it was given."""
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)

    def record(self, what: str, name: str, timing: Timing | None = None, **more: Any) -> dict[str, Any]:
        """A flat record of one contestant; ``more`` overrides and adds fields."""
        seconds = timing and {"median": timing.median, "low": timing.low, "high": timing.high}
        return {
            "what": what,
            "name": name,
            "points": None,
            "side": None,
            "batch": 1,
            "device": str(self.device),
            "threads": self.threads,
            "seconds": seconds,
            "runs": timing.runs if timing else 0,
            "peak_memory_bytes": None,
        } | more

    def records(self, what: str, timings: Mapping[str, Timing], **more: Any) -> list[dict[str, Any]]:
        """A record of each contestant of a race."""
        return [self.record(what, name, timing, **more) for name, timing in timings.items()]


def race(contestants: Mapping[str, Work], budget: float, synchronise: Callable[[], None] = lambda: None) -> dict[str, Timing]:
    """Time pieces of work by turns, after a first call of each that warms up.

    Parameters
    ----------
    contestants : name -> work; what it returns is dropped.
    budget : seconds for each. Between 3 and 200 samples are taken, of what takes ten times the budget only one; a sample
        repeats quick work until it takes 2 ms.
    synchronise : waits for the device, before the clock is read.

    Returns
    -------
    The seconds that each takes for one call.
    """
    repeats, samples = {}, {}
    for name, work in contestants.items():
        _sample(work, 1, synchronise)
        once = _sample(work, 1, synchronise)
        repeats[name] = max(1, round(SAMPLE / max(once, 1e-7)))
        # Work that long is not disturbed by being the first.
        samples[name] = [once] if once > budget else []
    waiting = [name for name, taken in samples.items() if not _enough(taken, 1, budget)]
    while waiting:
        for name in waiting:
            samples[name].append(_sample(contestants[name], repeats[name], synchronise))
        waiting = [name for name in waiting if not _enough(samples[name], repeats[name], budget)]
    return {name: _timing(taken) for name, taken in samples.items()}


def _sample(work: Work, repeats: int, synchronise: Callable[[], None]) -> float:
    synchronise()
    start = time.perf_counter()
    for _ in range(repeats):
        work()
    synchronise()
    return (time.perf_counter() - start) / repeats


def _enough(samples: list[float], repeats: int, budget: float) -> bool:
    if len(samples) < LEAST_RUNS:
        return bool(samples) and samples[0] > FAR_OVER * budget
    return len(samples) >= MOST_RUNS or sum(samples) * repeats >= budget


def _timing(samples: list[float]) -> Timing:
    low, median, high = (float(value) for value in np.percentile(samples, [25, 50, 75]))
    return Timing(median, low, high, len(samples))


def slope(sizes: list[int], seconds: list[float]) -> float:
    """Of the straight line through log(seconds) over log(size), by least squares."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def gradient(function: Callable[[Tensor], Tensor], variable: Tensor) -> Work:
    """Work: the value of ``function`` of ``variable``, summed, and its derivative."""
    leaf = variable.detach().clone().requires_grad_()

    def work() -> Tensor:
        (slope,) = torch.autograd.grad(function(leaf).sum(), leaf)
        return slope

    return work


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Let torch and the compiled loops use ``count`` CPU threads inside the block."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
