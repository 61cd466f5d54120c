"""Errors that a user can act on; `cli` prints them as one line and exits with their code."""

from collections.abc import Iterator
from contextlib import contextmanager


class TsoError(Exception):
    """A failure, with a message for the user: the file, what was found, what was expected."""

    exit_code = 1


class InputError(TsoError):
    """Wrong usage, or input that is unreadable or impossible."""

    exit_code = 2


class GateError(TsoError):
    """The work is done, but a target that was set is missed."""

    exit_code = 3


@contextmanager
def prefixed(prefix: str) -> Iterator[None]:
    """Begin the message of an InputError in the block with ``prefix``."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{prefix}{error}") from None


def is_interrupt(error: BaseException) -> bool:
    """Whether the first cause is Ctrl-C, which machine code and modules of C++ turn into other errors."""
    while error.__cause__ is not None:
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt)
