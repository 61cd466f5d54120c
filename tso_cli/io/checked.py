"""Numbers of a file, checked: errors name the file, the place and what was expected."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array
from .reading import shown

LARGEST = 1e15  # products of larger entries have no correct digits left


class Checked:
    """The values of the file ``path``; ``place`` is where in it they are, such as "frames[3]."."""

    path: Path
    place = ""

    def error(self, where: str, value: object, expected: str) -> InputError:
        """The error of a value: what was ``value`` at ``where``, and what was ``expected``."""
        return InputError(f"{self.path}: {self.place}{where} is {value}, expected {expected}")

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
            place, wrong = _first_text(values)
            if place:
                raise self.error(where + place, kind(wrong), "a number") from None
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
    if value is None:
        return "nothing"
    if isinstance(value, (list, dict)):
        return ("a list" if isinstance(value, list) else "an object") + f" of {len(value)}"
    return shown(value)


def _first_text(values: Any) -> tuple[str, Any]:
    """The place of the first entry of a list, or of lists in it, that is no number; "" for none."""
    for index, value in enumerate(values if isinstance(values, list) else ()):
        if isinstance(value, list):
            place, wrong = _first_text(value)
            if place:
                return f"[{index}]{place}", wrong
        elif isinstance(value, bool) or not isinstance(value, (int, float)):
            return f"[{index}]", value
    return "", None


def _fits(shape: tuple[int, ...], pattern: tuple[int, ...]) -> bool:
    return len(shape) == len(pattern) and all(
        w in (-1, n) for n, w in zip(shape, pattern, strict=True)
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
