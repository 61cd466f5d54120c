"""Readers of clouds and meshes that other packages register, imported when one is needed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .output import reason

ENTRY_POINTS = "tso.clouds"
"""Group of the entry points. The name of each is a suffix without its dot, the object a function
``read(data, path)`` that returns points [N, 3], or points and triangles [F, 3]."""


def readers() -> dict[str, Callable[[], Any]]:
    """Suffix -> what loads the reader of another package."""
    from importlib.metadata import entry_points

    points = entry_points(group=ENTRY_POINTS)
    return {f".{point.name.lower().lstrip('.')}": point.load for point in points}


def read_with(
    load: Callable[[], Any], data: bytes, path: Path
) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """The points and the triangles, or None, that the reader of another package gives."""
    try:
        result = load()(data, path)
        points, faces = result if isinstance(result, tuple) else (result, None)
        return np.asarray(points), None if faces is None else np.asarray(faces)
    except InputError:
        raise
    except Exception as error:  # whatever the package raises
        raise InputError(
            f"{path}: the reader of {path.suffix.lower()} that another package registered failed "
            f"({type(error).__name__}: {reason(error)}), expected points [N, 3]"
        ) from None
