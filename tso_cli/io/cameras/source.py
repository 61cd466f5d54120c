"""A camera file or folder before its format is known: its bytes and what they parse to."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...geometry.arrays import Array
from ...geometry.rotations import from_quaternion
from ..checked import Checked
from ..output import reason
from ..reading import json_reason, read_bytes, shown

LIMIT = 16 << 20  # bytes of a camera file
# A model of COLMAP lists all image points with its cameras.
LIMIT_OF_MODEL = 2 << 30
COLMAP_FILES = tuple(
    f"{name}{suffix}" for name in ("cameras", "images", "points3D") for suffix in (".bin", ".txt")
)
# A scene with its cameras, as a GLB, may be larger than a list of cameras.
LIMIT_OF_SCENE = 2 << 30
EXPECTED = "a camera file"
# By how much the last row of a pose may differ from 0 0 0 1: programs compute it in 32 bits.
LAST_ROW_TOLERANCE = 1e-6
# What files of a kind begin with.
_MAGIC = {b"glTF": "glb", b"PK\x03\x04": "zip", b"\x93NUMPY": "npy"}


class CameraSource(Checked):
    """A camera file, read once.

    Raises InputError if the file cannot be read. ``path`` may be a folder, whose ``data`` is empty.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_folder = path.is_dir()
        limit = LIMIT_OF_SCENE if path.suffix.lower() == ".glb" else LIMIT
        if path.name in COLMAP_FILES:
            limit = LIMIT_OF_MODEL
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
    def container(self) -> str:
        """The kind of file, by its content: folder, glb, zip, npy, json, yaml, text or binary."""
        if self.is_folder:
            return "folder"
        for start, name in _MAGIC.items():
            if self.data.startswith(start):
                return name
        if self.looks_like_json:
            return "json"
        try:
            head = self.text[:4096]
        except InputError:
            return "binary"
        markup = head.startswith(("%YAML", "<?xml", "<opencv_storage"))
        keys = re.search(r"^[A-Za-z_][\w-]*\s*:(\s|$)", head, re.MULTILINE)
        return "yaml" if markup or keys else "text"

    @cached_property
    def json(self) -> Any:
        """The JSON document; InputError if the file is no JSON or a key appears twice."""
        try:
            return json.loads(self.text, object_pairs_hook=self._unique)
        except InputError:
            raise
        except (RecursionError, ValueError) as error:
            raise InputError(
                f"{self.path}: is not JSON ({json_reason(error)}), expected {EXPECTED}"
            ) from None

    def _unique(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        values = dict(pairs)
        if len(values) < len(pairs):
            keys: set[str] = set()
            twice = next(key for key, _ in pairs if key in keys or keys.add(key))  # type: ignore[func-returns-value]
            raise InputError(
                f"{self.path}: the key {shown(twice)} appears twice in one object, expected once"
            )
        return values

    @cached_property
    def arrays(self) -> dict[str, Any]:
        """The arrays of a .npz or .pt file."""
        from ..archives import arrays_of

        return arrays_of(self.data, self.path, LIMIT)

    @cached_property
    def markup(self) -> list[Any]:
        """The documents of a YAML file, or of OpenCV's XML, that are not empty."""
        from .markup import documents_of

        return documents_of(self.text, self.path)

    def pose(self, where: str, values: Any, *shapes: tuple[int, ...]) -> Array:
        """``values``, an array of one of the ``shapes``, by rows as a matrix [4, 4].

        Raises InputError as `matrix`, or if its last row is not 0 0 0 1.
        """
        rows = self.matrix(where, values, *(shapes or ((4, 4),))).reshape(-1, 4)
        last = np.array([0.0, 0.0, 0.0, 1.0])
        if len(rows) == 3:
            return np.vstack([rows, last])
        if np.abs(rows[3] - last).max() > LAST_ROW_TOLERANCE:
            transposed = np.abs(rows[:, 3] - last).max() <= LAST_ROW_TOLERANCE
            raise self.error(
                f"the last row of {where}",
                " ".join(f"{value:g}" for value in rows[3]),
                "0 0 0 1" + ("; transpose the matrix: t is its last column" if transposed else ""),
            )
        return rows

    def quaternion(self, where: str, values: Any) -> Array:
        """The rotation [3, 3] of w, x, y and z; InputError if all are 0."""
        w, x, y, z = self.matrix(where, values, (4,)).tolist()
        if not any((w, x, y, z)):
            raise self.error(where, "a quaternion of length 0", "w, x, y and z of a rotation")
        return from_quaternion(w, x, y, z)

    @property
    def title(self) -> str:
        """The place, as the title of a view."""
        return self.place.rstrip(".: ")

    @property
    def objects(self) -> list[Any]:
        """The entries of the JSON document, or the document itself."""
        return self.json if isinstance(self.json, list) else [self.json]

    def each(self, entries: Sequence[Any], place: str) -> Iterator[Any]:
        """The ``entries`` one after the other; ``place`` has {} for the number of an entry."""
        for number, entry in enumerate(entries):
            self.place = place.format(number)
            yield entry
        self.place = ""

    @cached_property
    def columns(self) -> list[str]:
        """The names in the first line of a table with commas."""
        return [name.strip() for name in self.text.partition("\n")[0].split(",")]

    @property
    def table(self) -> Iterator[dict[str, str]]:
        """The rows of a table with commas, by the names of its columns; `place` is their line."""
        for number, line in enumerate(self.text.splitlines()[1:], 2):
            self.place = f"line {number}: "
            cells = [cell.strip() for cell in line.split(",")]
            if len(cells) != len(self.columns) and line.strip():
                raise self.error("a row", f"{len(cells)} values", f"{len(self.columns)}")
            if line.strip():
                yield dict(zip(self.columns, cells, strict=True))

    @cached_property
    def words(self) -> list[list[str]]:
        """The words of each line that is neither empty nor a comment."""
        lines = (line.split() for line in self.text.splitlines())
        return [words for words in lines if words and not words[0].startswith("#")]


def has_keys(entry: object, keys: set[str]) -> bool:
    """Whether ``entry`` is an object of JSON with all of the ``keys``."""
    return isinstance(entry, dict) and entry.keys() >= keys
