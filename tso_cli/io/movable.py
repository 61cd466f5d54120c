"""Files of points that can be written again with other coordinates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array, Bits, Indices
from .output import reason
from .paint import Paint, Pictures


class MovableFile(ABC):
    """A file of points that can be written again with other coordinates.

    Attributes
    ----------
    data : the bytes of the file. suffix : of files of this format.
    kinds : the types of the three coordinates: "f4", "f8" or an integer's.
    """

    data: bytes
    suffix: str
    kinds: Sequence[str]

    @abstractmethod
    def read(self) -> Array:
        """The points [N, 3]."""

    @abstractmethod
    def read_faces(self) -> Indices | None:
        """Triangles [F, 3], or None."""

    @abstractmethod
    def with_points(self, points: Array, matrix: Array | None = None) -> bytes:
        """The file with its points at ``points`` [N, 3].

        ``matrix`` [4, 4] moved the whole file, x' = matrix x, before its points moved further:
        directions such as normals turn along. It is a rotation with one factor for all lengths
        and a shift; None or the identity if nothing moved as a whole.
        """

    def read_colours(self) -> Array | None:
        """Red, green and blue [N, 3] in [0, 1], or None."""
        return None

    def read_paint(self, pictures: Pictures) -> Paint | None:
        """The colours of the surface of a mesh; None if its materials say nothing of them.

        Where a picture is missing the colour of the material is left. Raises any error if the file
        is damaged.
        """
        return None

    def paint(self, pictures: Pictures) -> Paint | None:
        """As `read_paint`; what is damaged is a line of ``pictures.missing``, as is a file."""
        # Pictures only decorate: whatever is wrong with them must not stop the work.
        try:
            with np.errstate(all="ignore"):
                return self.read_paint(pictures)
        except Exception as error:
            is_refusal = isinstance(error, InputError)
            why = reason(error) if is_refusal else f"damaged ({reason(error)})"
            pictures.missing.append(f"{why}, its colours are left out")
            return None

    def read_faint(self) -> Bits | None:
        """[N], points that cannot be seen, or None."""
        return None

    @property
    def stale_after_moving(self) -> list[str]:
        """What is wrong once points have moved one by one, such as "normals"."""
        return []

    def left_behind(self, matrix: Array) -> list[str]:
        """What is wrong once ``matrix`` [4, 4] moved the whole file, such as "normals"."""
        return []

    def read_normals(self) -> Array | None:
        """The normal of each point [N, 3], or None."""
        return None

    @property
    def contents(self) -> list[str]:
        """What the file holds besides points and faces, such as "textures"."""
        return []

    def files_named(self, data: bytes) -> list[str]:
        """The files that ``data``, this file with other points, names; relative to its folder."""
        return []

    def require_movable(self) -> None:  # noqa: B027
        """Raise InputError if the file cannot be written with other points."""


def in_unit(colours: Array, path: Path) -> Array:
    """``colours`` [N, 3] in [0, 1]; whole numbers to 255 are shares of 255.

    Raises InputError if they are neither.
    """
    low, high = colours.min(initial=0.0), colours.max(initial=0.0)
    if high > 1.0 and (colours == np.rint(colours)).all():
        colours, high = colours / 255.0, high / 255.0
    if not (low >= 0.0 and high <= 1.0):
        raise InputError(
            f"{path}: its colours span {low:g} to {colours.max():g}, expected 0 to 1, or whole "
            "numbers to 255"
        )
    return colours


def in_words(names: Iterable[str]) -> str:
    """The names as a sentence lists them: "textures, materials and normals"; "" for none."""
    *most, last = [*names] or [""]
    return f"{', '.join(most)} and {last}" if most else last
