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
    """Whether ``error`` was caused by Ctrl-C; libraries turn Ctrl-C into other errors."""
    while error.__cause__ is not None:
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt)


# Package -> what needs it, and the extra that installs it.
EXTRAS = {
    "torch": ("networks need", "network"),
    "matplotlib": ("charts need", "plots"),
    "open3d": ("rendering needs", "render"),
    "dask": ("a cluster needs", "dask"),
    "distributed": ("a cluster needs", "dask"),
    "rerun": ("recordings of the optimisation need", "rerun"),
    "fsspec": ("files that an address names need", "remote"),
}


def missing_extra(error: BaseException, needing: str | None = None) -> str | None:
    """What to install if ``error`` says that a package of an extra is missing; otherwise None.

    ``needing`` : the words before the package, such as "networks need".
    """
    package = (getattr(error, "name", None) or "").partition(".")[0]
    if not isinstance(error, ImportError) or package not in EXTRAS:
        return None
    words, extra = EXTRAS[package]
    return f"{needing or words} {package}, which is not installed: pip install 'tso-cli[{extra}]'"


@contextmanager
def needed_by(needing: str) -> Iterator[None]:
    """Raise InputError, which begins with ``needing``, if a package of an extra is missing."""
    try:
        yield
    except ImportError as error:
        if is_interrupt(error) or (message := missing_extra(error, needing)) is None:
            raise
        raise InputError(message) from None
