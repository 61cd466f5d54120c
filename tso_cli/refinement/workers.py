"""Independent pieces of work on all cores.

They run in forked processes, since threads would wait for one another's Python.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from ..errors import TsoError

Result = TypeVar("Result")


def processes_for(count: int) -> int:
    """How many processes ``count`` pieces of work get.

    That is one for each core, or as many as OMP_NUM_THREADS says. It is one where processes cannot
    be forked safely: on other systems than Linux, and in a process that may have no children.
    """
    if sys.platform != "linux" or multiprocessing.current_process().daemon:
        return 1
    try:
        most = int(os.environ["OMP_NUM_THREADS"])
    except (KeyError, ValueError):
        most = len(os.sched_getaffinity(0))
    return max(1, min(most, count - 1))


def stop_flag(processes: int) -> Any:
    """An event that all of these processes see."""
    return multiprocessing.get_context("fork").Event() if processes > 1 else threading.Event()


def spread(
    work: Callable[[int], Result],
    count: int,
    processes: int,
    stop: Any,
    on_done: Callable[[Result], None],
) -> list[Result]:
    """``[work(0), ..., work(count - 1)]``; ``on_done`` is called here with each result.

    Ctrl-C, or a KeyboardInterrupt of ``on_done``, sets ``stop``, for ``work`` to end early. It is
    still called for every number.

    Raises TsoError where a process is killed, and whatever else ``work`` or ``on_done`` raise.
    """
    results: dict[int, Result] = {}

    def finish(number: int, result: Result) -> None:
        results[number] = result
        try:
            on_done(result)
        except KeyboardInterrupt:
            stop.set()

    # The first is done here, so that processes find all modules and compiled loops loaded.
    for number in range(count if processes == 1 else 1):
        finish(number, work(number))
    if len(results) < count:
        _fork(
            work,
            [number for number in range(count) if number not in results],
            processes,
            stop,
            finish,
        )
    return [results[number] for number in range(count)]


def _fork(
    work: Callable[[int], Result],
    numbers: list[int],
    processes: int,
    stop: Any,
    finish: Callable[[int, Result], None],
) -> None:
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(processes, context, initializer=_begin, initargs=(work,)) as pool:
        # Ctrl-C waits until all processes are there and leave it to this one.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            waiting = {pool.submit(_call, number): number for number in numbers}
        except BaseException:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            raise
        while waiting:
            try:
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)
                for future in as_completed(list(waiting)):
                    result, caught = future.result()
                    for warning in caught:
                        warnings.warn(warning, stacklevel=2)
                    # Ctrl-C after this must not finish it again.
                    finish(waiting.pop(future), result)
            except KeyboardInterrupt:
                stop.set()
            except BrokenProcessPool:
                raise TsoError(
                    "a process of the batch was killed, expected enough memory for all of them"
                ) from None
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise


_work: Callable[[int], Any]


def _begin(work: Callable[[int], Any]) -> None:
    global _work
    _work = work
    # Ctrl-C reaches all processes; the first one ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _call(number: int) -> tuple[Any, list[Warning]]:
    """The result, and the warnings on the way, which the first process gives."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        result = _work(number)
    return result, [warning.message for warning in caught if isinstance(warning.message, Warning)]
