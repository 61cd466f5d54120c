"""Readers that other packages register, imported when one is needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .output import reason

CLOUDS = "tso.clouds"
"""Group of the entry points of clouds and meshes. The name of each is a suffix without its dot, the
object a function ``read(data, path)`` that returns points [N, 3], or points and triangles [F, 3].
"""
CAMERAS = "tso.cameras"
"""Group of the entry points of cameras: objects with ``recognises`` and ``read``."""


def registered(group: str) -> dict[str, Callable[[], Any]]:
    """Name of an entry point -> what loads it."""
    from importlib.metadata import entry_points

    return {point.name: point.load for point in entry_points(group=group)}


def readers() -> dict[str, Callable[[], Any]]:
    """Suffix -> what loads the reader of another package."""
    return {f".{name.lower().lstrip('.')}": load for name, load in registered(CLOUDS).items()}


def camera_reader(load: Callable[[], Any]) -> Any:
    """The reader that an entry point of cameras names: an object, or a class that makes it."""
    reader = load()
    return reader() if isinstance(reader, type) else reader


@contextmanager
def guarded(path: Path, what: str, expected: str) -> Iterator[None]:
    """Whatever the code of another package raises becomes an InputError."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{path}: the reader of {what} that another package registered failed "
            f"({type(error).__name__}: {reason(error)}), expected {expected}"
        ) from None


def read_with(
    load: Callable[[], Any], data: bytes, path: Path
) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """The points and the triangles, or None, that the reader of another package gives."""
    with guarded(path, path.suffix.lower(), "points [N, 3]"):
        result = load()(data, path)
        points, faces = result if isinstance(result, tuple) else (result, None)
        return np.asarray(points), None if faces is None else np.asarray(faces)
