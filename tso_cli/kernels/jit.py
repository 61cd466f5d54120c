"""Compiling with numba, and sharing compiled work between threads.

Importing numba takes a fifth of a second: import this module only where compiled code runs.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import itertools
import os
import pickle
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile

# Fewest basic steps of a thread for which waking it pays.
WORTH_A_THREAD = 1 << 18
# Ranges per thread, so that threads with little to do take over from others.
RANGES_PER_THREAD = 4

SETTINGS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz"},
}
INSIDE: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def forget_stale(folder: Path) -> None:
    """Remove numba's cache of the sources in ``folder`` that is older than any of them.

    numba checks the file of a function alone, not those of the functions that are compiled into it.
    """
    with contextlib.suppress(OSError, ValueError):
        changed = max(source.stat().st_mtime for source in folder.glob("*.py"))
        for index in (folder / "__pycache__").glob("*.nbi"):
            if index.stat().st_mtime < changed:
                index.unlink(missing_ok=True)


forget_stale(Path(__file__).parent)


@functools.cache
def sweep(folder: str) -> None:
    """Once for each process, remove the temporaries that killed processes left in numba's ``folder``.

    A temporary lives for milliseconds, so one older than a minute is a leftover. A process that was stopped for that long finds
    its own gone; it warns and goes on.
    """
    with contextlib.suppress(OSError):
        for path in Path(folder).glob("*.nb[ci].tmp.*"):
            if time.time() - path.stat().st_mtime > 60.0:
                path.unlink(missing_ok=True)


def on_disk(*functions: Any) -> bool:
    """Whether the machine code of all these `compiled` functions is on disk, newer than the sources."""
    try:
        changed = max(source.stat().st_mtime for source in Path(__file__).parent.glob("*.py"))
        caches = (
            Path(function.stats.cache_path).glob(f"*.{function.__name__}-*.nbi")
            for function in functions
        )
        return all(any(index.stat().st_mtime >= changed for index in cache) for cache in caches)
    except (AttributeError, OSError, TypeError, ValueError):
        # no folder can be written, or numba was told to compile nothing
        return False


_warned: list[str] = []  # folders that were warned of; once is enough


class _CheckedFile(IndexDataCacheFile):
    """Machine code on disk, behind it its digest: damaged code would run, or end the process."""

    def _dump(self, obj: Any) -> bytes:
        data: bytes = super()._dump(obj)
        return data + hashlib.sha256(data).digest()

    def _load_data(self, name: str) -> Any:
        data = Path(self._data_path(name)).read_bytes()
        if hashlib.sha256(data[:-32]).digest() != data[-32:]:
            raise ValueError(f"{name} is damaged")
        return pickle.loads(data)


class _Cache(FunctionCache):
    """numba's, but what cannot be read is compiled anew, and what cannot be written stays in memory, with a warning."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        locator = self._impl.locator
        sweep(self.cache_path)
        self._cache_file = _CheckedFile(
            self.cache_path, self._impl.filename_base, locator.get_source_stamp()
        )

    @contextlib.contextmanager
    def _guard_against_spurious_io_errors(self) -> Iterator[None]:
        try:
            yield
        # Unpickling a damaged index fails in any way there is.
        except Exception as error:
            if not _warned:
                _warned.append(self.cache_path)
                text = f"{self.cache_path}: compiled loops cannot be read or kept there ({error!r}), they are compiled anew"
                warnings.warn(text, stacklevel=2)
            with contextlib.suppress(OSError):
                self.flush()


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Inside, signals wait: raised in a callback of LLVM, KeyboardInterrupt would be printed and forgotten."""
    waiting: list[int] = []
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            if (number := getattr(signal, name, None)) and callable(signal.getsignal(number)):
                before[number] = signal.signal(number, lambda number, frame: waiting.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if waiting:
            signal.raise_signal(waiting[0])


def compiled(function: Callable[..., Any], **changes: Any) -> Any:
    """``function`` compiled at its first call; the machine code is kept on disk where a folder can be written.

    Sums are reordered within a statement, and multiply-adds rounded once: the same way at every call.
    """
    dispatcher = njit(**SETTINGS | changes)(function)
    dispatcher.compile = _uninterrupted()(dispatcher.compile)
    # RuntimeError: neither the package's folder nor the user's cache folder can be written; compiled in every process.
    with contextlib.suppress(RuntimeError):
        dispatcher._cache = _Cache(function)
    return dispatcher


def exactly(function: Callable[..., Any]) -> Any:
    """As `compiled`, rounding as numpy does, where ties decide and must fall the same way in both."""
    return compiled(function, fastmath=False)


def part(function: Callable[..., Any]) -> Any:
    """As `compiled`, for functions that only compiled functions call: without wrappers for Python, a tenth less to compile."""
    return njit(**SETTINGS, **INSIDE)(function)


def share(
    count: int, steps: int, threads: int, function: Callable[..., None], *arguments: Any
) -> None:
    """Call the compiled ``function(first, last, *arguments)`` on ranges that cover 0 to ``count``, on at most ``threads``.

    It must write the same values however 0 to ``count`` is cut into ranges. ``steps`` is the work in all, roughly, in basic
    steps.
    """
    threads = min(threads, count, max(1, steps // WORTH_A_THREAD))
    if threads <= 1:
        function(0, count, *arguments)
        return
    ranges = min(count, threads * RANGES_PER_THREAD)
    following: Iterator[int] = itertools.count()

    def work() -> None:
        while (i := next(following)) < ranges:
            function(i * count // ranges, (i + 1) * count // ranges, *arguments)

    futures = [_threads().submit(work) for _ in range(threads - 1)]
    try:
        work()
    finally:
        # After Ctrl-C no further range begins, and no thread still writes when the caller goes on.
        following = itertools.repeat(ranges)
        wait(futures)
    for future in futures:
        future.result()


@functools.cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix="tso-kernel")


if hasattr(os, "register_at_fork"):
    # A forked process has none of its parent's threads.
    os.register_at_fork(after_in_child=_threads.cache_clear)
