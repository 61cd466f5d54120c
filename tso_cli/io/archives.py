"""The arrays in a .npz file, and in a .pt file that holds nothing but tensors."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, needed_by
from .output import reason
from .reading import array_header, read_array, require_memory, shown

_PICKLE = "data.pkl"  # in a .pt file


def is_torch(data: bytes, path: Path) -> bool:
    return any(name.endswith(_PICKLE) for name in _names(data, path))


def _names(data: bytes, path: Path) -> list[str]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return archive.namelist()
    except Exception as error:  # zipfile fails in many ways on damaged archives
        raise InputError(f"{path}: is a damaged archive ({reason(error)})") from None


def arrays_of(data: bytes, path: Path, limit: int | None = None) -> dict[str, Any]:
    """Name -> numbers. Nothing is unpickled but tensors. Arrays of other types are left out.

    ``limit`` : the most bytes of one array.
    """
    return _tensors(data, path) if is_torch(data, path) else _arrays(data, path, limit)


def _arrays(data: bytes, path: Path, limit: int | None) -> dict[str, Any]:
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
                    values = member.read(entry.file_size + 1)
                if array_header(values, path)[0].kind in "biuf":
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
            f"{path}: holds more than tensors, or is damaged ({reason(error)}); expected a "
            "dictionary of tensors"
        ) from None
    if not isinstance(loaded, dict):
        loaded = {"": loaded}
    try:
        return {str(key): _numbers(value, path) for key, value in loaded.items() if _is_data(value)}
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{path}: holds a value that is no array of numbers ({reason(error)}), expected tensors"
        ) from None


def _is_data(value: Any) -> bool:
    import torch

    return isinstance(value, (torch.Tensor, int, float, bool, list, tuple))


def _numbers(value: Any, path: Path) -> Any:
    import torch

    if not isinstance(value, torch.Tensor):
        return np.asarray(value)
    # A tensor may be expanded: a small file then stands for many numbers.
    require_memory(path, 16 * value.numel())
    if value.layout != torch.strided or value.is_complex() or value.is_quantized:
        raise InputError(f"{path}: holds a tensor that is sparse, complex or quantised, expected "
                         "plain numbers")  # fmt: skip
    value = value.detach()
    return (value.double() if value.is_floating_point() else value).numpy()
