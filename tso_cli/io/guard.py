"""What a damaged file raises becomes one line: the file, the place, and what was expected."""

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
    """Inside, a reader takes what it needs of ``source``, and sets its ``place`` as it goes on.

    A file without places is given by its path.

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
