"""What a process of a `WorkerPool` runs: it does one piece of work after another."""

from __future__ import annotations

import os
import pickle
import queue
import signal
import sys
import threading
from typing import IO

from .pool import receive, send


def main() -> None:
    """Answer the messages on stdin until it ends."""
    # What the work prints goes to stderr, and not between the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    messages = os.fdopen(os.dup(0), "rb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    waiting: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(messages, waiting), daemon=True).start()
    while True:
        send(answers, _answer(waiting.get()))


def _read(messages: IO[bytes], waiting: queue.SimpleQueue[bytes]) -> None:
    """Take messages; the parent's end is this process's end, even in the middle of its work."""
    try:
        while True:
            waiting.put(receive(messages))
    except BaseException:
        os._exit(1)


def _answer(message: bytes) -> bytes:
    try:
        work, args, kwargs = pickle.loads(message)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            answer = True, work(*args, **kwargs)
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
    except BaseException as error:
        answer = False, error
        if isinstance(error, SystemExit):
            os._exit(error.code if isinstance(error.code, int) else 1)
    try:
        return pickle.dumps(answer, pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        unsent = RuntimeError(f"{type(answer[1]).__name__} cannot be sent back ({error})")
        return pickle.dumps((False, unsent), pickle.HIGHEST_PROTOCOL)
    finally:
        sys.stdout.flush()
