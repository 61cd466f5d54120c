"""The bytes, the JSON document or the array (.npy) in an input file, or one clear line why not. Nothing is unpickled."""

from __future__ import annotations

import io
import json
import math
import stat
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .output import reason

_READERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_bytes(path: Path, expected: str, limit: int | None = None, most: int = -1) -> bytes:
    """The bytes of the regular file ``path``, or the first ``most`` of them.

    Raises InputError, naming what is ``expected``, if it is missing, none, unreadable, empty or larger than ``limit`` bytes.
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


def array_type(data: bytes, path: Path) -> tuple[np.dtype[Any], tuple[int, ...]]:
    """Type and shape of the array in the bytes of a .npy file; InputError where it is none."""
    return _header(data, path)[:2]


def read_array(data: bytes, path: Path, kinds: str = "biufc", expected: str = "numbers") -> NDArray[Any]:
    """The read-only array in the bytes of a .npy file, its type one of numpy's ``kinds``, which messages call ``expected``.

    Raises InputError if it is no such file, or is shorter or longer than its header says.
    """
    dtype, shape, fortran, begin = _header(data, path)
    if dtype.kind not in kinds:
        raise InputError(f"{path}: holds values of type {shown(str(dtype))}, expected {expected}")
    size = math.prod(shape) * dtype.itemsize
    if any(not isinstance(n, int) or n < 0 for n in shape) or size != len(data) - begin:
        raise InputError(f"{path}: has {len(data) - begin:,} bytes of values, expected {shown(shape)} of {dtype}")
    try:
        array = np.frombuffer(data, dtype=dtype, count=math.prod(shape), offset=begin)
        return array.reshape(shape, order="F" if fortran else "C")
    except (ValueError, TypeError) as error:
        raise InputError(f"{path}: is not a readable .npy file ({reason(error)})") from None


def _header(data: bytes, path: Path) -> tuple[np.dtype[Any], tuple[int, ...], bool, int]:
    """Type, shape, order (whether Fortran's) and the byte where the values begin."""
    stream = io.BytesIO(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            version = np.lib.format.read_magic(stream)
            if version not in _READERS:
                raise ValueError(f"version {version[0]}.{version[1]}, expected 1.0 or 2.0")
            shape, fortran, dtype = _READERS[version](stream)
    # numpy evaluates the header as a Python literal, so that a damaged one can raise nearly anything.
    except Exception as error:
        raise InputError(f"{path}: is not a readable .npy file ({reason(error)})") from None
    return dtype, shape, fortran, stream.tell()
