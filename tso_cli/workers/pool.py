"""A pool of processes. If one of them dies, only the piece of work that it had is lost."""

from __future__ import annotations

import os
import pickle
import queue
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import suppress
from typing import IO, Any

LENGTH = struct.Struct("<Q")
"""Before each message stands its length."""
# The child finds what this process finds, whatever put it on the path.
_CHILD = "import sys; sys.path[:] = {path!r}; from tso_cli.workers.child import main; main()"


class WorkerDied(BrokenExecutor):
    """The process that did a piece of work ended before the work was done."""


def cores() -> int:
    """How many processes may work at once: the cores, or as many as OMP_NUM_THREADS says."""
    try:
        return max(1, int(os.environ["OMP_NUM_THREADS"]))
    except (KeyError, ValueError):
        pass
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # only Linux has it
        return os.cpu_count() or 1


class WorkerPool(Executor):
    """An executor whose processes are fresh interpreters.

    `concurrent.futures.ProcessPoolExecutor` gives up all of its work if one process dies, and its
    processes outlive a parent that is killed. Here a future has the exception `WorkerDied` only if
    the process that had its work has died, and a new process takes the next piece. All processes
    end as soon as the parent does, because each of them reads from a pipe of the parent. A pool
    also works in a script without ``if __name__ == "__main__"``, in a notebook, and in a process
    that is itself a worker.

    Ctrl-C of a terminal does not reach the processes; `interrupt` passes it on.

    A piece of work that takes over ``seconds``, with the start of its process, ends with a
    TimeoutError, and its process is killed. None is no limit.
    """

    def __init__(self, processes: int, seconds: float | None = None) -> None:
        self._jobs: queue.SimpleQueue[tuple[Future[Any], Callable[[], bytes]] | None] = (
            queue.SimpleQueue()
        )
        self._children = [_Child(seconds) for _ in range(processes)]
        self._threads = [
            threading.Thread(target=self._serve, args=(child,), daemon=True)
            for child in self._children
        ]
        self._closed = False
        for thread in self._threads:
            thread.start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if self._closed:
            raise RuntimeError("the pool is shut down")
        future: Future[Any] = Future()
        # Pickled by the thread that sends it: a caller with much to do does not wait.
        self._jobs.put((future, lambda: pickle.dumps((fn, args, kwargs), pickle.HIGHEST_PROTOCOL)))
        return future

    def interrupt(self) -> None:
        """Do to the pieces at work what Ctrl-C does, and cancel those that have not begun."""
        self._cancel_waiting()
        for child in self._children:
            child.interrupt()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after their work, or at once without ``wait``."""
        self._closed = True
        if cancel_futures or not wait:
            self._cancel_waiting()
        for _ in self._threads:
            self._jobs.put(None)
        if not wait:
            for child in self._children:
                child.kill()
        for thread in self._threads:
            thread.join()

    def _cancel_waiting(self) -> None:
        with suppress(queue.Empty):
            while (job := self._jobs.get_nowait()) is not None:
                job[0].cancel()
                # Only this wakes those who wait for the future.
                job[0].set_running_or_notify_cancel()

    def _serve(self, child: _Child) -> None:
        while (job := self._jobs.get()) is not None:
            future, pickled = job
            if not future.set_running_or_notify_cancel():
                continue
            try:
                succeeded, value = child.ask(pickled())
            except BaseException as error:
                future.set_exception(error)
            else:
                (future.set_result if succeeded else future.set_exception)(value)
        child.kill()


class _Child:
    """One process, started when it is first needed, and again after it has died."""

    def __init__(self, seconds: float | None) -> None:
        self._seconds = seconds
        self._process: subprocess.Popen[bytes] | None = None
        self._working = self._ended = False

    def ask(self, message: bytes) -> tuple[bool, Any]:
        """Whether the work succeeded, and its result or exception.

        Raises WorkerDied if there is none, TimeoutError if it takes too long.
        """
        process = self._process = self._process or self._started()
        assert process.stdin
        assert process.stdout
        if self._ended:  # `kill` came while the process started, and did not see it
            process.kill()
        self._working, late = True, threading.Event()

        def give_up() -> None:
            late.set()
            process.kill()

        alarm = threading.Timer(self._seconds or 0.0, give_up)
        if self._seconds is not None:
            alarm.start()
        try:
            send(process.stdin, message)
            reply = receive(process.stdout)
        except (EOFError, OSError, ValueError):  # the last if `kill` has closed the pipes
            self._process = None
            process.kill()
            _close(process)
            if late.is_set():
                process.wait()
                raise TimeoutError(f"took over {self._seconds:g} seconds") from None
            raise WorkerDied(f"its process {_end(process.wait())}") from None
        finally:
            alarm.cancel()
            self._working = False
        answer: tuple[bool, Any] = pickle.loads(reply)
        return answer

    def _started(self) -> subprocess.Popen[bytes]:
        if self._ended:
            raise WorkerDied("its pool was shut down")
        return subprocess.Popen(
            [sys.executable, "-c", _CHILD.format(path=sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # A session of its own: Ctrl-C in the terminal does not reach it.
            start_new_session=True,
        )

    def interrupt(self) -> None:
        process = self._process
        if self._working and process and os.name == "posix":
            with suppress(OSError):
                process.send_signal(signal.SIGINT)

    def kill(self) -> None:
        self._ended = True
        process, self._process = self._process, None
        if process:
            process.kill()
            process.wait()
            _close(process)


def _close(process: subprocess.Popen[bytes]) -> None:
    """Close the pipes of a dead process; what is left in a buffer cannot be sent."""
    for stream in (process.stdin, process.stdout):
        if stream:
            with suppress(OSError):
                stream.close()


def _end(code: int) -> str:
    """How a process ended, in words."""
    if code >= 0:
        return f"ended with exit code {code}"
    with suppress(ValueError):
        name = signal.Signals(-code).name
        memory = ", perhaps for lack of memory" if name == "SIGKILL" else ""
        return f"was killed by {name}{memory}"
    return f"was killed by signal {-code}"


def send(stream: IO[bytes], message: bytes) -> None:
    stream.write(LENGTH.pack(len(message)))
    stream.write(message)
    stream.flush()


def receive(stream: IO[bytes]) -> bytes:
    """The next message; EOFError if the other side has ended."""
    header = stream.read(LENGTH.size)
    if len(header) < LENGTH.size:
        raise EOFError
    (length,) = LENGTH.unpack(header)
    message = stream.read(length)
    if len(message) < length:
        raise EOFError
    return message
