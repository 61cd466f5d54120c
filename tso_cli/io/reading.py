"""Getting the bytes of an input file, or one clear line why not."""

from __future__ import annotations

import json
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..errors import InputError
from .output import reason


def read_bytes(path: Path, expected: str, limit: int | None = None, most: int = -1) -> bytes:
    """The bytes of the regular file ``path``, or the first ``most`` of them.

    Raises InputError, which names what is ``expected``, if it is missing, a folder, a device, unreadable, empty or larger than
    ``limit`` bytes.
    """
    try:
        about = path.stat()
        if stat.S_ISDIR(about.st_mode):
            raise InputError(f"{path}: is a folder, expected {expected}")
        if not stat.S_ISREG(about.st_mode):
            raise InputError(f"{path}: is not a regular file, expected {expected}")
        if about.st_size == 0:
            raise InputError(f"{path}: is empty, expected {expected}")
        if limit is not None and about.st_size > limit:
            raise InputError(f"{path}: holds {about.st_size:,} bytes, expected {expected} of at most {limit:,}")
        with path.open("rb") as stream:
            return stream.read(most)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: does not exist, expected {expected}") from None
    except MemoryError:
        raise InputError(f"{path}: does not fit into memory") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({reason(error)}), expected {expected}") from None


def read_json(
    path: Path, expected: str, form: str, limit: int | None = None, build: Callable[[list[tuple[str, Any]]], Any] = dict
) -> Any:
    """The JSON document in ``path``, its objects made by ``build``; InputError as `read_bytes`, or if it is not JSON."""
    try:
        return json.loads(read_bytes(path, expected, limit), object_pairs_hook=build)
    except RecursionError:
        raise InputError(f"{path}: is not JSON (nested too deep), expected {form}") from None
    except ValueError as error:
        raise InputError(f"{path}: is not JSON ({reason(error)}), expected {form}") from None


def shown(value: object) -> str:
    """``value`` as a message may quote it: one printable line of at most 60 characters."""
    try:
        text = ascii(value)
    except (RecursionError, ValueError):
        text = f"a {type(value).__name__}"
    return text if len(text) <= 60 else text[:57] + "..."
