"""Signals that wait until work that they would damage is done."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def waiting_signals() -> Iterator[None]:
    """Inside, SIGINT, SIGTERM and SIGHUP wait. Other threads than the main one get none anyway.

    trimesh and open3d take any exception during their import for a missing part and go on, and a
    KeyboardInterrupt in a callback of LLVM is printed and ignored.
    """
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


def press_ctrl_c() -> None:
    """Do from another thread what Ctrl-C does."""
    main = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main is not None:
        signal.pthread_kill(main, signal.SIGINT)  # wakes the thread from what it waits for
    else:
        signal.raise_signal(signal.SIGINT)


@contextmanager
def at_interrupt(act: Callable[[], None], once: bool = False) -> Iterator[None]:
    """Inside, Ctrl-C calls ``act``; with ``once`` the second Ctrl-C does what it did before."""
    before = signal.getsignal(signal.SIGINT)
    if before is None or threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, frame: Any) -> None:
        if once:
            # In the background of a shell Ctrl-C is ignored, and SIGTERM comes here all the same.
            ends = before if callable(before) else signal.default_int_handler
            signal.signal(signal.SIGINT, ends)
        act()

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
