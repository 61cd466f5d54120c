"""Compiling with numba, and sharing compiled work between threads.

Importing numba takes a fifth of a second. Import this module only where compiled code runs.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import itertools
import os
import pickle
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numpy.typing import NDArray

from ..signals import waiting_signals

# What the loops take: float32 or float64, and bool.
Array = NDArray[np.floating[Any]]
Marks = NDArray[np.bool_]

# Least number of basic steps for which waking one more thread saves time.
STEPS_WORTH_A_THREAD = 1 << 18
# Work is cut into this many ranges per thread, so that threads that finish early take over ranges.
RANGES_PER_THREAD = 4

SETTINGS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz"},
}
INSIDE: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


_loops: list[Any] = []  # the loops of a refinement; `compiled` and `exactly` add themselves


def _sources_changed() -> float:
    """Time of the last change to a source of this package."""
    return max(source.stat().st_mtime for source in Path(__file__).parent.glob("*.py"))


@functools.cache
def tidy(folder: str) -> None:
    """Remove outdated files from numba's cache ``folder``, once for each process:

    1. indices of machine code that are older than a source of this package. numba compares the time
       of a function's own file only, and not of the functions that are compiled into it.
    2. temporaries that killed processes left: a temporary lives for milliseconds. A living process
       that was stopped for a minute finds that its temporary is gone; it warns and goes on.
    """
    with contextlib.suppress(OSError, ValueError):
        changed = _sources_changed()
        for index in Path(folder).glob("*.nbi"):
            if index.stat().st_mtime < changed:
                index.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        for path in Path(folder).glob("*.nb[ci].tmp.*"):
            if time.time() - path.stat().st_mtime > 60.0:
                path.unlink(missing_ok=True)


def folder_of_loops() -> Path | None:
    """Where machine code is kept; None if no folder can be written, or numba is switched off."""
    folders = [getattr(getattr(loop, "stats", None), "cache_path", None) for loop in _loops]
    return Path(str(folders[0])) if folders and all(folders) else None


def loops_on_disk() -> tuple[int, int]:
    """Of how many loops machine code is on disk, newer than the sources, and how many there are.

    The loops are those that were defined so far.
    """
    folder, found = folder_of_loops(), 0
    with contextlib.suppress(OSError, ValueError):
        changed = _sources_changed()
        for loop in _loops if folder else ():
            indices = Path(loop.stats.cache_path).glob(f"*.{loop.__name__}-*.nbi")
            found += any(index.stat().st_mtime >= changed for index in indices)
    return found, len(_loops)


_warned: list[str] = []  # the folder that was warned of; one warning is enough


@contextlib.contextmanager
def _alone_in(folder: str) -> Iterator[None]:
    """Inside, no other process is, if the system has locks."""
    handle = None
    with contextlib.suppress(ImportError, OSError):
        import fcntl

        handle = os.open(folder, os.O_RDONLY)
        fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


class _CheckedFile(IndexDataCacheFile):
    """Machine code on disk, with what it is of, and followed by its digest.

    Damaged code would run, or end the process, and so would code for other types.
    """

    def save(self, key: Any, data: Any) -> None:
        """As numba, but of two processes each finds what the other wrote; the index comes last."""
        with _alone_in(self._cache_path):
            names = self._load_index()
            numbered = map(self._data_name, itertools.count(1))
            name = names.get(key) or next(one for one in numbered if one not in names.values())
            self._save_data(name, (key, data))
            self._save_index({**names, key: name})

    def load(self, key: Any) -> Any:
        found = super().load(key)
        return found[1] if isinstance(found, tuple) and found[0] == key else None

    def _dump(self, obj: Any) -> bytes:
        data: bytes = super()._dump(obj)
        return data + hashlib.sha256(data).digest()

    def _load_data(self, name: str) -> Any:
        data = Path(self._data_path(name)).read_bytes()
        if hashlib.sha256(data[:-32]).digest() != data[-32:]:
            raise ValueError(f"{name} is damaged")
        return pickle.loads(data)


class _Cache(FunctionCache):
    """numba's cache, except that errors of the disk only cause a warning.

    Code that cannot be read is compiled again; code that cannot be written stays in memory.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        locator = self._impl.locator
        tidy(self.cache_path)
        self._cache_file = _CheckedFile(
            self.cache_path, self._impl.filename_base, locator.get_source_stamp()
        )

    @contextlib.contextmanager
    def _guard_against_spurious_io_errors(self) -> Iterator[None]:
        try:
            yield
        # Unpickling a damaged index can raise any exception.
        except Exception as error:
            if not _warned:
                _warned.append(self.cache_path)
                warnings.warn(
                    f"{self.cache_path}: compiled loops cannot be read or kept there ({error!r}), "
                    "so they are compiled anew; check that the folder can be written",
                    stacklevel=2,
                )
            with contextlib.suppress(OSError):
                self.flush()


def kept_on_disk(function: Callable[..., Any], **changes: Any) -> Any:
    """``function``, compiled at its first call and kept on disk if a folder can be written.

    Sums are reordered within a statement, and a product and a sum are rounded once. Every call
    rounds alike.
    """
    dispatcher = njit(**SETTINGS | changes)(function)
    if dispatcher is function:
        return function  # numba is switched off
    dispatcher.compile = waiting_signals()(dispatcher.compile)
    # RuntimeError: neither the package's folder nor the user's cache folder can be written. The
    # function is then compiled in every process.
    with contextlib.suppress(RuntimeError):
        dispatcher._cache = _Cache(function)
    return dispatcher


def compiled(function: Callable[..., Any], **changes: Any) -> Any:
    """As `kept_on_disk`, for a loop that a refinement uses: `loops_on_disk` asks for it."""
    loop = kept_on_disk(function, **changes)
    _loops.append(loop)
    return loop


def exactly(function: Callable[..., Any]) -> Any:
    """As `compiled`, but rounds like numpy: where ties decide, both forms must decide alike."""
    return compiled(function, fastmath=False)


def part(function: Callable[..., Any]) -> Any:
    """``function`` compiled for calls from compiled functions alone.

    Without wrappers for Python it compiles a tenth faster.
    """
    return njit(**SETTINGS, **INSIDE)(function)


def share(
    count: int, steps: int, threads: int, function: Callable[..., None], *arguments: Any
) -> None:
    """Call ``function(first, last, *arguments)`` on ranges that cover 0 to ``count``.

    The compiled function must write the same values however 0 to ``count`` is cut into ranges.
    ``steps`` is a rough number of basic steps of the whole work; the work runs on at most
    ``threads`` threads, and on fewer if it is small.
    """
    threads = min(threads, count, max(1, steps // STEPS_WORTH_A_THREAD))
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
        # After Ctrl-C no further range begins, and no thread writes once the caller goes on.
        following = itertools.repeat(ranges)
        wait(futures)
    for future in futures:
        future.result()


@functools.cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix="tso-kernel")


if hasattr(os, "register_at_fork"):
    # A forked process has none of the threads of its parent.
    os.register_at_fork(after_in_child=_threads.cache_clear)
