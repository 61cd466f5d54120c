"""BLAS held to one thread.

Several threads gain nothing on matrices of this size, and wait for one another on a busy machine.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_lock = threading.Lock()
_inside: list[Any] = []


@contextmanager
def one_thread() -> Iterator[None]:
    """Inside, for the whole process, matrix products and inverses run on one thread.

    Where several Python threads are inside at once, the first sets the limit and the last lifts it.
    """
    with _lock:
        _inside.append(_inside[0] if _inside else _limited())
    try:
        yield
    finally:
        with _lock:
            limit = _inside.pop()
            if not _inside:
                limit.restore_original_limits()
                _give_up_control()


def _limited() -> Any:
    limit = _controller().limit(limits=1, user_api="blas")
    _give_up_control()
    return limit


def _give_up_control() -> None:
    """Let another thread lift the limit: threadpoolctl 3.8 obeys only the thread that set it."""
    import threadpoolctl

    of_openblas = getattr(threadpoolctl, "OpenBLASController", None)
    if clear := getattr(of_openblas, "clear_controlling_thread", None):
        clear()


@functools.cache
def _controller() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
