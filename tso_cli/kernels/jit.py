"""Compiling with numba, and sharing compiled work between threads.

Importing numba takes half a second: this is imported where compiled code runs, and nowhere else.
"""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import torch
from numba import njit
from torch import Tensor

# What a thread must have to do at least, in basic steps, for waking it to pay.
WORTH_A_THREAD = 1 << 18
# Ranges handed out per thread, so that one with little to do takes over from another.
RANGES_PER_THREAD = 4

SETTINGS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz"}}
INSIDE: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

_pool: ThreadPoolExecutor | None = None


def forget_stale(folder: Path) -> None:
    """Remove what numba kept of the sources in ``folder`` if any of them changed since.

    numba looks at the file of a function alone, not at those of the functions that are compiled into it.
    """
    with contextlib.suppress(OSError, ValueError):
        changed = max(source.stat().st_mtime for source in folder.glob("*.py"))
        for index in (folder / "__pycache__").glob("*.nbi"):
            if index.stat().st_mtime < changed:
                index.unlink(missing_ok=True)


forget_stale(Path(__file__).parent)


def kept(*functions: Any) -> bool:
    """Whether the machine code of all these `compiled` functions is on disk, made from the sources as they are."""
    try:
        changed = max(source.stat().st_mtime for source in Path(__file__).parent.glob("*.py"))
        found = (Path(function.stats.cache_path).glob(f"*.{function.__name__}-*.nbi") for function in functions)
        return all(any(index.stat().st_mtime >= changed for index in indices) for indices in found)
    except (AttributeError, OSError, TypeError, ValueError):
        # none can be kept, or numba was told to compile nothing
        return False


def compiled(function: Callable[..., Any]) -> Any:
    """``function`` compiled at its first call, with the machine code kept on disk where a folder for it can be written.

    Sums are reordered within a statement and multiplied and added in one rounding, the same way at every call.
    """
    try:
        return njit(cache=True, **SETTINGS)(function)
    except RuntimeError:
        # neither the package's own folder nor the user's cache folder can be written: compile in every process anew
        return njit(**SETTINGS)(function)


def part(function: Callable[..., Any]) -> Any:
    """As `compiled`, for what compiled functions alone call.

    It is kept inside them, and is compiled without the doors by which Python would come in: a tenth less to compile.
    """
    return njit(**SETTINGS, **INSIDE)(function)


def share(count: int, steps: int, function: Callable[..., None], *arguments: Any) -> None:
    """Call the compiled ``function(first, last, *arguments)`` on ranges that cover 0 to ``count``.

    As many threads as torch uses share the ranges. Whatever ranges it is called on, ``function`` must write the same: then
    nothing depends on the number of threads. ``steps`` is roughly what there is to do in all, in basic steps. Tensors among the
    arguments are on the CPU and are handed on as arrays; those that are written to must be contiguous.
    """
    arguments = tuple(a.detach().contiguous().numpy() if isinstance(a, Tensor) else a for a in arguments)
    threads = min(torch.get_num_threads(), count, max(1, steps // WORTH_A_THREAD))
    if threads <= 1:
        _call(function, 0, count, *arguments)
        return
    ranges = min(count, threads * RANGES_PER_THREAD)
    following: Iterator[int] = itertools.count()

    def work() -> None:
        while (i := next(following)) < ranges:
            _call(function, i * count // ranges, (i + 1) * count // ranges, *arguments)

    others = [_threads().submit(work) for _ in range(threads - 1)]
    try:
        work()
    finally:
        # After Ctrl-C nothing more is handed out, and nobody writes any more when the caller goes on.
        following = itertools.repeat(ranges)
        wait(others)
    for other in others:
        other.result()


def _call(function: Callable[..., None], *arguments: Any) -> None:
    try:
        function(*arguments)
    except OSError:
        # The machine code could not be kept on disk (full, say). It is there in memory, and nothing has run yet.
        function(*arguments)


def _threads() -> ThreadPoolExecutor:
    global _pool
    if _pool is None:
        _pool = ThreadPoolExecutor(max(os.cpu_count() or 1, torch.get_num_threads()), thread_name_prefix="tso-kernel")
    return _pool


def _forget_threads() -> None:
    global _pool
    _pool = None


if hasattr(os, "register_at_fork"):
    # A forked process has none of its parent's threads.
    os.register_at_fork(after_in_child=_forget_threads)
