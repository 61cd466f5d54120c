"""Compiling with numba, and sharing compiled work between threads.

Importing numba takes a fifth of a second: import this module only where compiled code runs.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

from numba import njit

# Fewest basic steps of a thread for which waking it pays.
WORTH_A_THREAD = 1 << 18
# Ranges per thread, so that threads with little to do take over from others.
RANGES_PER_THREAD = 4

SETTINGS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz"}}
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


def on_disk(*functions: Any) -> bool:
    """Whether the machine code of all these `compiled` functions is on disk, newer than the sources."""
    try:
        changed = max(source.stat().st_mtime for source in Path(__file__).parent.glob("*.py"))
        caches = (Path(function.stats.cache_path).glob(f"*.{function.__name__}-*.nbi") for function in functions)
        return all(any(index.stat().st_mtime >= changed for index in cache) for cache in caches)
    except (AttributeError, OSError, TypeError, ValueError):
        # no folder can be written, or numba was told to compile nothing
        return False


def compiled(function: Callable[..., Any], **changes: Any) -> Any:
    """``function`` compiled at its first call; the machine code is kept on disk where a folder can be written.

    Sums are reordered within a statement, and multiply-adds rounded once: the same way at every call.
    """
    settings = SETTINGS | changes
    try:
        return njit(cache=True, **settings)(function)
    except RuntimeError:
        # neither the package's folder nor the user's cache folder can be written: compile in every process
        return njit(**settings)(function)


def exactly(function: Callable[..., Any]) -> Any:
    """As `compiled`, rounding as numpy does, where ties decide and must fall the same way in both."""
    return compiled(function, fastmath=False)


def part(function: Callable[..., Any]) -> Any:
    """As `compiled`, for functions that only compiled functions call: without wrappers for Python, a tenth less to compile."""
    return njit(**SETTINGS, **INSIDE)(function)


def share(count: int, steps: int, threads: int, function: Callable[..., None], *arguments: Any) -> None:
    """Call the compiled ``function(first, last, *arguments)`` on ranges that cover 0 to ``count``, on at most ``threads``.

    It must write the same values however 0 to ``count`` is cut into ranges. ``steps`` is the work in all, roughly, in basic
    steps.
    """
    threads = min(threads, count, max(1, steps // WORTH_A_THREAD))
    if threads <= 1:
        _call(function, 0, count, *arguments)
        return
    ranges = min(count, threads * RANGES_PER_THREAD)
    following: Iterator[int] = itertools.count()

    def work() -> None:
        while (i := next(following)) < ranges:
            _call(function, i * count // ranges, (i + 1) * count // ranges, *arguments)

    futures = [_threads().submit(work) for _ in range(threads - 1)]
    try:
        work()
    finally:
        # After Ctrl-C no further range begins, and no thread still writes when the caller goes on.
        following = itertools.repeat(ranges)
        wait(futures)
    for future in futures:
        future.result()


def _call(function: Callable[..., None], *arguments: Any) -> None:
    try:
        function(*arguments)
    except OSError:
        # The machine code could not be written to disk (full, say). It is in memory, and nothing has run yet.
        function(*arguments)


@functools.cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix="tso-kernel")


if hasattr(os, "register_at_fork"):
    # A forked process has none of its parent's threads.
    os.register_at_fork(after_in_child=_threads.cache_clear)
