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


def read_array(data: bytes, path: Path) -> NDArray[Any]:
    """The array in the bytes of a .npy file, read-only.

    Raises
    ------
    InputError
        It is not a .npy file, holds Python objects, or is shorter or longer than its header says.
    """
    stream = io.BytesIO(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            version = np.lib.format.read_magic(stream)
            if version == (1, 0):
                shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
            elif version == (2, 0):
                shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream)
            else:
                raise ValueError(f"version {version[0]}.{version[1]}, expected 1.0 or 2.0")
    # numpy evaluates the header as a Python literal, so that a damaged one can raise nearly anything.
    except Exception as error:
        raise InputError(f"{path}: is not a readable .npy file ({reason(error)})") from None
    if dtype.kind not in "biufc":
        raise InputError(f"{path}: holds values of type {shown(str(dtype))}, expected numbers")
    begin = stream.tell()
    size = math.prod(shape) * dtype.itemsize
    if any(not isinstance(n, int) or n < 0 for n in shape) or size != len(data) - begin:
        raise InputError(f"{path}: has {len(data) - begin:,} bytes of values, expected {shown(shape)} of {dtype}")
    try:
        array = np.frombuffer(data, dtype=dtype, count=math.prod(shape), offset=begin)
        return array.reshape(shape, order="F" if fortran else "C")
    except (ValueError, TypeError) as error:
        raise InputError(f"{path}: is not a readable .npy file ({reason(error)})") from None
