"""Errors that a user can act on; `cli` prints one line and exits with the error's code."""

from collections.abc import Iterator
from contextlib import contextmanager


class TsoError(Exception):
    """A failure. The message names the file, what was found and what was expected."""

    exit_code = 1


class InputError(TsoError):
    """Wrong usage, or input that is unreadable or impossible."""

    exit_code = 2


class Interrupted(TsoError):
    """Ctrl-C came before this piece of work began."""

    exit_code = 130


class GateError(TsoError):
    """The work is done, but it misses a target that the user has set."""

    exit_code = 3


@contextmanager
def prefixed(prefix: str) -> Iterator[None]:
    """Put ``prefix`` before the message of every InputError that the block raises."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{prefix}{error}") from None


def is_interrupt(error: BaseException) -> bool:
    """Whether ``error`` was caused by Ctrl-C; compiled code turns Ctrl-C into other errors."""
    while error.__cause__ is not None:
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt)
