"""The course of a run: the time that its phases take, and whether Ctrl-C came."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

Result = TypeVar("Result")


class Clock:
    """Wall time of the phases of a run.

    Attributes
    ----------
    seconds : of each phase. interrupted : whether Ctrl-C ended a phase that can be left out.
    """

    def __init__(self, interrupted: bool = False) -> None:
        self.seconds: dict[str, float] = {}
        self.interrupted = interrupted

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """A phase whose seconds are kept."""
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def attempt(self, name: str, work: Callable[[], Result], otherwise: Result) -> Result:
        """What ``work`` returns, or ``otherwise`` where Ctrl-C came before or meanwhile."""
        if self.interrupted:
            return otherwise
        with self.phase(name):
            try:
                return work()
            except KeyboardInterrupt:
                self.interrupted = True
                return otherwise
