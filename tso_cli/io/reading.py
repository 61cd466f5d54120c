"""Getting the bytes of an input file, or one clear line why not."""

from __future__ import annotations

import json
import stat
from pathlib import Path
from typing import Any

from ..errors import InputError
from .output import reason


def read_bytes(path: Path, expected: str, limit: int | None = None, most: int = -1) -> bytes:
    """The bytes of the regular file ``path``, or the first ``most`` of them.

    Parameters
    ----------
    expected : what the file should be, for the messages: "a point cloud".
    limit : the largest file to accept, in bytes.

    Raises InputError if the file is missing, a folder, a device, unreadable, empty or larger than ``limit``.
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


def read_json(path: Path, expected: str, form: str, limit: int | None = None) -> Any:
    """The JSON document in ``path``; InputError as `read_bytes`, or if it is not JSON, naming the ``form`` expected."""
    try:
        return json.loads(read_bytes(path, expected, limit))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not JSON ({shown(str(error))}), expected {form}") from None


def shown(value: object) -> str:
    """``value`` as a message may quote it: one printable line of at most 60 characters."""
    try:
        text = ascii(value)
    except (RecursionError, ValueError):
        text = f"a {type(value).__name__}"
    return text if len(text) <= 60 else text[:57] + "..."
