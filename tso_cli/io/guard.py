"""Exceptions that a damaged file causes become one line: file, place, and what was expected."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError
from .checked import Checked
from .output import reason
from .reading import plain

DAMAGE = (LookupError, ValueError, TypeError, AttributeError, OverflowError, struct.error)
"""What numpy, struct and look-ups raise where a file lacks something, or has another form."""


@contextmanager
def reading(source: Checked | Path, expected: str) -> Iterator[None]:
    """Turns what a reader raises inside into an InputError.

    The reader updates ``source.place``, such as "frames[3].", before it reads there. Without places
    the path of the file stands for ``source``.

    Raises InputError where the file does not have what was ``expected``.
    """
    try:
        yield
    except DAMAGE as error:
        path, place = (source, "") if isinstance(source, Path) else (source.path, source.place)
        if isinstance(error, KeyError):
            wrong = f"{place}{plain(str(error.args[0]))} is missing"
        elif isinstance(error, (IndexError, struct.error)):
            wrong = f"{place.rstrip('.: ')} ends early"
        elif isinstance(error, (TypeError, AttributeError)):
            wrong = f"{place.rstrip('.: ')} has another form"
        else:
            wrong = f"{place.rstrip('.: ')} cannot be read ({reason(error)})"
        raise InputError(f"{path}: {wrong.lstrip()}, expected {expected}") from None
