"""Arrays in .npy files. Nothing is ever unpickled."""

from __future__ import annotations

import io
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .output import reason
from .reading import shown

_READERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def array_type(data: bytes, path: Path) -> tuple[np.dtype[Any], tuple[int, ...]]:
    """Type and shape of the array in the bytes of a .npy file; InputError where it is none."""
    return _header(data, path)[:2]


def read_array(data: bytes, path: Path, kinds: str = "biufc", expected: str = "numbers") -> NDArray[Any]:
    """The array in the bytes of a .npy file, read-only; its type is one of numpy's ``kinds``, which messages call ``expected``.

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
