"""The arrays in a .npz file, and in a .pt file that holds nothing but tensors."""

from __future__ import annotations

import io
import math
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, needed_by
from .output import reason
from .reading import array_header, read_array, require_memory, shown

_PICKLE = "data.pkl"  # in a .pt file
_PICKLED = b"\x80\x02\x8a\nl\xfc\x9cF\xf9"  # how torch.save began a file before torch 1.6
_HEADER = 1 << 16  # bytes that hold the header of a .npy file
Check = Callable[[tuple[int, ...]], None]
"""Raises InputError for the shape of an array that is too large to be read."""
# The most that a small file may stand for. Tensors may be expanded, and lists may hold one list
# twice.
MOST_NUMBERS = 10_000_000


def is_torch(data: bytes, path: Path) -> bool:
    """Whether a file was written by torch.save: an archive, or before torch 1.6 a pickle."""
    return data.startswith(_PICKLED) or any(name.endswith(_PICKLE) for name in _names(data, path))


def _names(data: bytes, path: Path) -> list[str]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return archive.namelist()
    except Exception as error:  # zipfile fails in many ways on damaged archives
        raise InputError(f"{path}: is a damaged archive ({reason(error)})") from None


def arrays_of(
    data: bytes, path: Path, limit: int | None = None, check: Check | None = None
) -> dict[str, Any]:
    """Name -> numbers. Nothing is unpickled but tensors. Arrays of other types are left out.

    ``limit`` : the most bytes of one array. ``check`` sees the shape of each array of a .npz file
    before its values are unpacked: a small file may hold many zeros.
    """
    return _tensors(data, path) if is_torch(data, path) else _arrays(data, path, limit, check)


def _arrays(data: bytes, path: Path, limit: int | None, check: Check | None) -> dict[str, Any]:
    arrays = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for entry in archive.infolist():
                if not entry.filename.endswith(".npy"):
                    continue
                if limit is not None and entry.file_size > limit:
                    raise InputError(
                        f"{path}: {shown(entry.filename)} takes {entry.file_size:,} bytes, "
                        f"expected at most {limit:,}"
                    )
                require_memory(path, 3 * entry.file_size)
                with archive.open(entry) as member:
                    values = member.read(_HEADER)
                    dtype, shape, _, _ = array_header(values, path)
                    if check is not None:
                        check(shape)
                    values += member.read(max(entry.file_size + 1 - len(values), 0))
                if dtype.kind in "biuf":
                    arrays[entry.filename[: -len(".npy")]] = read_array(values, path)
    except InputError:
        raise
    except Exception as error:  # and so does zlib
        raise InputError(f"{path}: is a damaged archive ({reason(error)})") from None
    return arrays


def _tensors(data: bytes, path: Path) -> dict[str, Any]:
    with needed_by(f"{path}: tensors need"):
        import torch

    try:
        loaded = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # torch fails in many ways on damaged files
        raise InputError(
            f"{path}: holds more than tensors, or is damaged{_why(error)}; expected a "
            "dictionary of tensors: torch.save({'points': tensor}, FILE)"
        ) from None
    if not isinstance(loaded, dict):
        loaded = {"": loaded}
    try:
        values = {str(key): value for key, value in loaded.items() if _is_data(value)}
        if (count := _count([*values.values()], {})) > max(MOST_NUMBERS, 4 * len(data)):
            raise InputError(
                f"{path}: its {len(data):,} bytes stand for {count:.3g} numbers, expected at most "
                f"{MOST_NUMBERS:,}; clone expanded tensors before they are stored"
            )
        return {key: _numbers(value, path) for key, value in values.items()}
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{path}: holds a value that is no array of numbers ({reason(error)}), expected tensors"
        ) from None


def _why(error: Exception) -> str:
    """The reason of an error; that of an unpickler is advice on code that tso does not run."""
    return "" if isinstance(error, pickle.UnpicklingError) else f" ({reason(error)})"


def _is_data(value: Any) -> bool:
    import torch

    return isinstance(value, (torch.Tensor, int, float, bool, list, tuple))


def _count(value: Any, counts: dict[int, float]) -> float:
    """How many numbers a tensor or nested lists stand for; infinite for a list in itself.

    ``counts`` : those of the lists met before, by their identities.
    """
    import torch

    if isinstance(value, torch.Tensor):
        return value.numel()
    if not isinstance(value, (list, tuple)):
        return 1
    if id(value) not in counts:
        counts[id(value)] = math.inf
        counts[id(value)] = sum(_count(item, counts) for item in value)
    return counts[id(value)]


def _numbers(value: Any, path: Path) -> Any:
    import torch

    if not isinstance(value, torch.Tensor):
        return np.asarray(value)
    require_memory(path, 16 * value.numel())
    if value.layout != torch.strided or value.is_complex() or value.is_quantized:
        raise InputError(f"{path}: holds a tensor that is sparse, complex or quantised, expected "
                         "plain numbers")  # fmt: skip
    value = value.detach()
    return (value.double() if value.is_floating_point() else value).numpy()
