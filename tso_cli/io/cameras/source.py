"""A camera file or folder before its format is known: its bytes and what they parse to."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...geometry.arrays import Array
from ..output import reason
from ..reading import read_bytes, shown

LIMIT = 64 << 20  # bytes of a camera file
# A scene with its cameras, as a GLB, may be larger than a list of cameras.
LIMIT_OF_SCENE = 2 << 30
LARGEST = 1e15  # products of larger entries have no correct digits left
EXPECTED = "a camera file"


class CameraSource:
    """A camera file, read once.

    Raises InputError if the file cannot be read. ``path`` may be a folder, whose ``data`` is empty.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_folder = path.is_dir()
        limit = LIMIT_OF_SCENE if path.suffix.lower() == ".glb" else LIMIT
        self.data = b"" if self.is_folder else read_bytes(path, EXPECTED, limit)

    @cached_property
    def text(self) -> str:
        """The file as text; a byte order mark is left out."""
        try:
            return self.data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise InputError(
                f"{self.path}: is not text ({reason(error)}), expected {EXPECTED}"
            ) from None

    @cached_property
    def looks_like_json(self) -> bool:
        return self.data.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] in (b"{", b"[")

    @cached_property
    def json(self) -> Any:
        """The JSON document; InputError if the file is no JSON or a key appears twice."""
        try:
            return json.loads(self.text, object_pairs_hook=self._unique)
        except InputError:
            raise
        except RecursionError:
            raise InputError(f"{self.path}: is not JSON (nested too deep)") from None
        except ValueError as error:
            raise InputError(
                f"{self.path}: is not JSON ({reason(error)}), expected {EXPECTED}"
            ) from None

    def _unique(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        values = dict(pairs)
        if len(values) < len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for i, key in enumerate(keys) if key in keys[:i])
            raise InputError(
                f"{self.path}: the key {shown(twice)} appears twice in one object, expected once"
            )
        return values

    @cached_property
    def words(self) -> list[list[str]]:
        """The words of each line that is neither empty nor a comment."""
        lines = (line.split() for line in self.text.splitlines())
        return [words for words in lines if words and not words[0].startswith("#")]

    def error(self, where: str, found: object, expected: str) -> InputError:
        """The error of a value: what was ``found`` at ``where``, and what was ``expected``."""
        return InputError(f"{self.path}: {where} is {found}, expected {expected}")

    def matrix(self, where: str, values: Any, *shapes: tuple[int, ...]) -> Array:
        """``values`` as an array of one of the ``shapes``; -1 stands for any length.

        Raises InputError if they are not finite numbers, or have none of the shapes.
        """
        try:
            array = np.asarray(values)
            if array.dtype == object and all(type(value) is int for value in array.flat):
                array = array.astype(np.float64)  # whole numbers of over 64 bits
            if array.dtype.kind not in "iuf":
                raise ValueError("not numbers")
            array = array.astype(np.float64)
        except (ValueError, TypeError, OverflowError):
            raise self.error(where, kind(values), _words(shapes)) from None
        if not any(_fits(array.shape, shape) for shape in shapes):
            size = list(array.shape)
            raise self.error(where, f"an array {size}", _words(shapes))
        wrong = ~(np.abs(array) <= LARGEST)
        if wrong.any():
            index = tuple(np.argwhere(wrong)[0].tolist())
            place = where + "".join(f"[{i}]" for i in index)
            raise self.error(place, f"{array[index]:g}", f"a finite number of at most {LARGEST:g}")
        return array

    def number(self, where: str, value: Any) -> float:
        """``value`` as a number; InputError if it is none."""
        return float(self.matrix(where, value, ()))

    def pixels(self, where: str, width: Any, height: Any) -> tuple[int, int]:
        """``width`` and ``height`` as whole numbers of pixels."""
        size = self.number(f"{where}width", width), self.number(f"{where}height", height)
        for name, value in zip(("width", "height"), size, strict=True):
            if value < 1 or value % 1:
                raise self.error(
                    f"{where}{name}", f"{value:g}", "a whole number of pixels, 1 or more"
                )
        return int(size[0]), int(size[1])


def kind(value: Any) -> str:
    """``value`` as a message quotes it."""
    if isinstance(value, (list, dict)):
        return ("list" if isinstance(value, list) else "object") + f" of {len(value)}"
    return shown(value)


def _fits(shape: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    return len(shape) == len(wanted) and all(
        w in (-1, n) for n, w in zip(shape, wanted, strict=True)
    )


def _words(shapes: Sequence[tuple[int, ...]]) -> str:
    """The shapes in words: "3x3 or [9] numbers"."""
    if () in shapes:
        return "a number"
    texts = []
    for shape in shapes:
        sides = ["N" if side < 0 else str(side) for side in shape]
        texts.append("x".join(sides) if len(sides) > 1 else f"[{sides[0]}]")
    return f"{' or '.join(texts)} numbers"
