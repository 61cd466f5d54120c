"""The arrays in a .npz file, and in a .pt file that holds nothing but tensors."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np

from ...errors import InputError
from ..output import reason
from ..reading import array_header, read_array, shown
from .source import LIMIT, CameraSource

_PICKLE = "data.pkl"  # in a .pt file


def is_torch(source: CameraSource) -> bool:
    return any(name.endswith(_PICKLE) for name in _names(source))


def _names(source: CameraSource) -> list[str]:
    try:
        with zipfile.ZipFile(io.BytesIO(source.data)) as archive:
            return archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError) as error:
        raise InputError(f"{source.path}: is a damaged archive ({reason(error)})") from None


def arrays_of(source: CameraSource) -> dict[str, Any]:
    """Name -> numbers. Nothing is unpickled but tensors. Arrays of other types are left out."""
    return _tensors(source) if is_torch(source) else _arrays(source)


def _arrays(source: CameraSource) -> dict[str, Any]:
    arrays = {}
    try:
        with zipfile.ZipFile(io.BytesIO(source.data)) as archive:
            for entry in archive.infolist():
                if not entry.filename.endswith(".npy"):
                    continue
                if entry.file_size > LIMIT:
                    raise InputError(
                        f"{source.path}: {shown(entry.filename)} takes {entry.file_size:,} bytes, "
                        f"expected at most {LIMIT:,}"
                    )
                with archive.open(entry) as member:
                    data = member.read(entry.file_size + 1)
                if array_header(data, source.path)[0].kind in "biuf":
                    arrays[entry.filename[: -len(".npy")]] = read_array(data, source.path)
    except InputError:
        raise
    except Exception as error:  # zipfile and zlib fail in many ways on damaged archives
        raise InputError(f"{source.path}: is a damaged archive ({reason(error)})") from None
    return arrays


def _tensors(source: CameraSource) -> dict[str, Any]:
    import torch

    try:
        loaded = torch.load(io.BytesIO(source.data), map_location="cpu", weights_only=True)
    except Exception as error:  # torch fails in many ways on damaged files
        raise InputError(
            f"{source.path}: holds more than tensors, or is damaged ({reason(error)}); expected a "
            "dictionary of tensors"
        ) from None
    if not isinstance(loaded, dict):
        loaded = {"": loaded}
    return {
        str(key): value.detach().to(torch.float64).numpy()
        if isinstance(value, torch.Tensor)
        else np.asarray(value)
        for key, value in loaded.items()
        if isinstance(value, (torch.Tensor, int, float, bool, list, tuple))
    }
