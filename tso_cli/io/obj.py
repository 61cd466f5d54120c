"""Wavefront OBJ: the vertices of all objects, and the file again with these vertices moved.

Normals are turned with the whole file and with the surface. Every other byte of the file stays:
objects, groups, materials, texture coordinates and comments.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array, Indices
from ..geometry.normals import rigid_turn, turned_normals
from .movable import MovableFile
from .paint import Paint, Pictures
from .ply_body import spliced
from .reading import plain, require_memory
from .similarity import Similarity, similarity_of

# The end of a line on old Macs. A line feed in its place keeps every byte where it is.
_LONE_RETURN = re.compile(rb"\r(?!\n)")
# A line that continues on the next one ends with a backslash.
_CONTINUED = re.compile(rb"\\\r?\n")
_LINE = re.compile(rb"^[ \t]*(v|vn|f)[ \t]+([^\r\n#]*)", re.MULTILINE)
_WORD = re.compile(rb"[^ \t]+")


def simplified(data: bytes) -> bytes:
    """The text of an OBJ file as simple readers expect it.

    A line stands for itself, no comment follows a value, and faces count all vertices, texture
    points and normals from 1: relative indices, which count back, depend on where the face stands.
    """
    data = _LONE_RETURN.sub(b"\n", data)
    if not re.search(rb"\\\r?\n|[ \t/]-\d|[^\s#][^\n#]*#", data):
        return data
    counts = {b"v": 0, b"vt": 0, b"vn": 0}
    lines = _CONTINUED.sub(b"  ", data).split(b"\n")
    for number, line in enumerate(lines):
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        if words[0] in counts:
            counts[words[0]] += 1
            lines[number] = b" ".join(words)
        elif words[0] in (b"f", b"l"):
            totals = tuple(counts.values())
            absolute = [b"/".join(map(_absolute, word.split(b"/"), totals)) for word in words[1:]]
            lines[number] = b" ".join([words[0], *absolute])
    return b"\n".join(lines)


def _absolute(text: bytes, total: int) -> bytes:
    return str(total + 1 + int(text)).encode() if re.fullmatch(rb"-\d{1,18}", text) else text


class ObjFile(MovableFile):
    """The text of an OBJ file. Raises InputError if it is damaged or holds no vertex.

    Attributes
    ----------
    kinds : types of the coordinates, as in a PLY file: text has as many digits as it needs.
    """

    kinds = ("f8", "f8", "f8")
    suffix = ".obj"

    def __init__(self, data: bytes, path: Path) -> None:
        self.data, self.path = data, path
        require_memory(path, 20 * len(data))
        # Spaces in place of the line break keep every byte where it is.
        self._lines = _LONE_RETURN.sub(b"\n", data)
        text = _CONTINUED.sub(lambda match: b" " * len(match[0]), self._lines)
        rows: dict[bytes, list[tuple[int, list[tuple[int, int]]]]] = {b"v": [], b"vn": [], b"f": []}
        self._faces: list[tuple[int, int, list[bytes]]] = []  # vertices and normals so far, words
        for match in _LINE.finditer(text):
            kind, begin = match[1], match.start(2)
            if kind == b"f":
                counts = len(rows[b"v"]), len(rows[b"vn"])
                self._faces.append((*counts, match[2].split()))
                continue
            spans = [(begin + w.start(), begin + w.end()) for w in _WORD.finditer(match[2])]
            rows[kind].append((begin, spans))
        if not rows[b"v"]:
            raise InputError(f"{path}: holds no vertex (v x y z), expected some")
        self._spans = self._of_three(rows[b"v"])
        self._normal_spans = self._of_three(rows[b"vn"]) if rows[b"vn"] else None
        coloured = all(len(spans) >= 6 for _, spans in rows[b"v"])
        self._colour_spans = (
            np.array([s[4:7] if len(s) > 6 else s[3:6] for _, s in rows[b"v"]])
            if coloured
            else None
        )
        weights = [s[3:4] for _, s in rows[b"v"] if len(s) in (4, 7)]
        if weights and (self._numbers(np.array(weights)) != 1.0).any():
            warnings.warn(
                f"{path}: some of its vertices have a weight w that is not 1; weights are for "
                "curves, so x, y and z are used as they are",
                stacklevel=4,
            )
        self._points = self._numbers(self._spans)
        self._triangles, self._normals = self._triangulated()

    def _of_three(self, rows: list[tuple[int, list[tuple[int, int]]]]) -> Indices:
        """[N, 3, 2], begin and end of the first three words of each row."""
        for begin, spans in rows:
            if len(spans) < 3:
                line = self._lines.count(b"\n", 0, begin) + 1
                raise InputError(
                    f"{self.path}: line {line} has {len(spans)} numbers, expected x, y and z"
                )
        return np.array([spans[:3] for _, spans in rows], dtype=np.int64)

    def _numbers(self, spans: Indices) -> Array:
        values = np.empty(spans.shape[:2])
        for row, words in enumerate(spans.tolist()):
            for column, (begin, end) in enumerate(words):
                word = self.data[begin:end]
                try:
                    values[row, column] = float(word if b"_" not in word else b"")
                except ValueError:
                    line = self._lines.count(b"\n", 0, begin) + 1
                    text = plain(word.decode("ascii", "backslashreplace"))
                    raise InputError(
                        f"{self.path}: line {line} has {text}, expected a number"
                    ) from None
        return values

    def _triangulated(self) -> tuple[Indices, Indices]:
        """Triangles [F, 3], polygons as fans, and the normal of each corner [F, 3], -1 for none."""
        triangles, normals = [], []
        for vertices, normals_before, words in self._faces:
            corners, directions = [], []
            for word in words:
                parts = word.split(b"/")
                corners.append(self._index(parts[0], vertices, len(self._points), word))
                third = parts[2] if len(parts) > 2 else b""
                count = 0 if self._normal_spans is None else len(self._normal_spans)
                directions.append(self._index(third, normals_before, count, word) if third else -1)
            for k in range(1, len(corners) - 1):
                triangles.append((corners[0], corners[k], corners[k + 1]))
                normals.append((directions[0], directions[k], directions[k + 1]))
        shape = (len(triangles), 3)
        return (
            np.array(triangles, np.int64).reshape(shape),
            np.array(normals, np.int64).reshape(shape),
        )

    def _index(self, text: bytes, before: int, count: int, word: bytes) -> int:
        """The index that a face names; a negative one counts back from the face."""
        try:
            number = int(text)
        except ValueError:
            number = 0
        index = number - 1 if number > 0 else before + number
        if number == 0 or not 0 <= index < count:
            named = plain(word.decode("ascii", "backslashreplace"))
            raise InputError(
                f"{self.path}: a face names {named}, expected vertices 1 to {count}, or -1 and so "
                "on for the last ones"
            )
        return index

    def read(self) -> Array:
        """The vertices [V, 3], in the file's order."""
        return self._points.copy()

    def read_faces(self) -> Indices | None:
        """Triangles [F, 3], polygons as fans; None if the file has no faces."""
        return self._triangles if len(self._triangles) else None

    def read_colours(self) -> Array | None:
        """Red, green and blue [V, 3] in [0, 1] after the coordinates of a vertex, or None."""
        if self._colour_spans is None:
            return None
        colours = self._numbers(self._colour_spans)
        if not (colours.min() >= 0.0 and colours.max() <= 1.0):
            raise InputError(
                f"{self.path}: its colours span {colours.min():g} to {colours.max():g}, expected "
                "0 to 1"
            )
        return colours

    def read_paint(self, pictures: Pictures) -> Paint | None:
        """map_Kd of the materials, or Kd; None if there is no picture and vertices have colours."""
        from . import obj_paint

        libraries, count = self.files_named(self._lines), len(self._triangles)
        paint = obj_paint.read_paint(simplified(self.data), libraries, pictures, count)
        coloured = self._colour_spans is not None
        return paint if paint.textures or not coloured else None

    def read_normals(self) -> Array | None:
        """The normal of each vertex [V, 3]; None unless every vertex has exactly one."""
        with_normal = self._normals >= 0
        if self._normal_spans is None or not with_normal.any():
            return None
        normal_of = np.full(len(self._points), -1)
        normal_of[self._triangles[with_normal]] = self._normals[with_normal]
        if (normal_of < 0).any() or (
            normal_of[self._triangles[with_normal]] != self._normals[with_normal]
        ).any():
            return None
        return self._numbers(self._normal_spans)[normal_of]

    @property
    def contents(self) -> list[str]:
        """What the file holds besides vertices and faces."""
        parts = {
            "materials": re.search(rb"^[ \t]*usemtl\b", self._lines, re.MULTILINE),
            "texture coordinates": re.search(rb"^[ \t]*vt\b", self._lines, re.MULTILINE),
            "colours": self._colour_spans is not None,
            "normals": self._normal_spans is not None,
        }
        return [name for name, there in parts.items() if there]

    def files_named(self, data: bytes) -> list[str]:
        """The .mtl files that the text names."""
        lines = re.findall(rb"^[ \t]*mtllib[ \t]+(.+?)[ \t\r]*$", data, re.MULTILINE)
        return [line.decode("utf-8", "replace") for line in lines]

    def with_points(self, points: Array, matrix: Array | None = None) -> bytes:
        """The file with its vertices moved to ``points`` [V, 3].

        ``matrix`` [4, 4] moved the whole file before: all normals turn along with it.
        """
        move = similarity_of(matrix)
        if move is None and np.array_equal(self._points, points):
            return self.data
        changes = [self._changes(self._spans, self._points, points)]
        with_normal = self._normals >= 0
        if self._normal_spans is not None and (move is not None or with_normal.any()):
            normals = self._numbers(self._normal_spans)
            with np.errstate(all="ignore"):  # of normals that are not finite
                turned = self._turned(normals, points, move)
            changes.append(self._changes(self._normal_spans, normals, turned))
        starts, ends, words = (np.concatenate(part) for part in zip(*changes, strict=True))
        return spliced(self.data, 0, starts, ends, words)

    def _turned(self, normals: Array, points: Array, move: Similarity | None) -> Array:
        """``normals`` [K, 3] turned by ``move``, then as the vertices move on to ``points``."""
        before, with_normal = self._points, self._normals >= 0
        if move is not None:
            normals, before = move.turned(normals), move.apply(before)
            if move.accounts_for(self._points, points, self.kinds):
                return normals
        turn = rigid_turn(before, points)
        if turn is not None:
            turned: Array = normals @ turn.T
            return turned
        whole = with_normal.all(1)
        return turned_normals(normals, self._normals[whole], self._triangles[whole], before, points)

    def _changes(
        self, spans: Indices, old: Array, new: Array
    ) -> tuple[Indices, Indices, NDArray[Any]]:
        """Where numbers change, and their new text, with the digits of a float if that is all
        the old text has.
        """
        single = old.astype(np.float32)
        if np.array_equal(single.astype("S32").astype(np.float64), old) or _few_digits(
            self.data, spans
        ):
            rounded: NDArray[Any] = new.astype(np.float32)
            changed = rounded != single
        else:
            rounded, changed = new, new != old
        return spans[changed][:, 0], spans[changed][:, 1], rounded[changed].astype("S32")


def _few_digits(data: bytes, spans: Indices) -> bool:
    """Whether no number of the text has more than nine digits, as many as a float has."""
    for begin, end in spans.reshape(-1, 2).tolist():
        mantissa = re.split(rb"[eE]", data[begin:end])[0]
        digits = mantissa.lstrip(b"+-").replace(b".", b"").lstrip(b"0")
        if len(digits) > 9:
            return False
    return True
