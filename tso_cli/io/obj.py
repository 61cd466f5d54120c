"""Wavefront OBJ: the vertices of all objects, and the file again with these vertices moved.

Normals are turned with the whole file and with the surface. Every other byte of the file stays:
objects, groups, materials, texture coordinates and comments.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array, Indices
from ..geometry.normals import rigid_turn, turned_normals
from ..geometry.polygons import triangulated
from .movable import MovableFile, in_unit
from .paint import Paint, Pictures
from .ply_body import spliced
from .reading import plain, require_memory
from .similarity import Similarity, similarity_of

# The end of a line on old Macs. A line feed in its place keeps every byte where it is.
_LONE_RETURN = re.compile(rb"\r(?!\n)")
# A line that continues on the next one ends with a backslash.
_CONTINUED = re.compile(rb"\\\r?\n")
_LINE_START = rb"^(?:\xef\xbb\xbf)?[ \t]*"  # the first line may begin with a byte-order mark
_LINE = re.compile(
    _LINE_START + rb"(?:(v|vt|vn|f)[ \t]+([^\r\n#]*)|usemtl[ \t]+([^\r\n]*))", re.MULTILINE
)
# Names may hold blanks, a line several names, and a comment may follow.
_LIBRARIES = re.compile(_LINE_START + rb"mtllib[ \t]+(.+?)[ \t\r]*$", re.MULTILINE)
_LIBRARY = re.compile(rb"\S.*?\.mtl(?=\s|$)", re.IGNORECASE)
_WORD = re.compile(rb"[^ \t]+")


_Row = tuple[int, list[tuple[int, int]]]
"""Where a row of numbers begins in the file, and begin and end of each number."""


class _Face(NamedTuple):
    """The words of a face, split at /; ``before``: how many lines of v, vt and vn precede it."""

    words: list[list[bytes]]
    before: tuple[int, int, int]
    material: bytes


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
        self._lines = _LONE_RETURN.sub(b"\n", data)
        # Spaces in place of the line break keep every byte where it is.
        text = _CONTINUED.sub(lambda match: b" " * len(match[0]), self._lines)
        rows: dict[bytes, list[_Row]] = {b"v": [], b"vt": [], b"vn": []}
        self._faces: list[_Face] = []
        material = b""
        for match in _LINE.finditer(text):
            kind, begin = match[1], match.start(2)
            if kind is None:
                material = match[3].strip()
            elif kind == b"f":
                before = len(rows[b"v"]), len(rows[b"vt"]), len(rows[b"vn"])
                words = [word.split(b"/") for word in match[2].split()]
                self._faces.append(_Face(words, before, material))
            else:
                spans = [(begin + w.start(), begin + w.end()) for w in _WORD.finditer(match[2])]
                rows[kind].append((begin, spans))
        if not rows[b"v"]:
            raise InputError(f"{path}: holds no vertex (v x y z), expected some")
        self._spans = self._first_three(rows[b"v"])
        self._normal_spans = self._first_three(rows[b"vn"]) if rows[b"vn"] else None
        self._texture_rows = rows[b"vt"]
        self._coloured = sum(len(spans) >= 6 for _, spans in rows[b"v"])
        self._colour_spans = (
            np.array([s[4:7] if len(s) > 6 else s[3:6] for _, s in rows[b"v"]])
            if self._coloured == len(rows[b"v"])
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
        corners = self._indices(0, len(self._points))
        lengths = np.array([len(face.words) for face in self._faces], dtype=np.int64)
        # Where the corners of the triangles [F, 3] are among those of all faces.
        self._places = triangulated(self._points, corners, lengths)
        self._triangles = corners[self._places]
        count = 0 if self._normal_spans is None else len(self._normal_spans)
        self._normals = self._indices(2, count)[self._places]  # [F, 3], -1 for none

    def _first_three(self, rows: list[_Row]) -> Indices:
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

    def _indices(self, part: int, count: int) -> Indices:
        """What all faces name: of ``count`` vertices (``part`` 0), texture points (1), normals (2).

        Negative indices count back from the face. -1 is a corner that names none.
        """
        indices = []
        for face in self._faces:
            before = face.before[part]
            for word in face.words:
                text = word[part] if part < len(word) else b""
                if not text and part > 0:
                    indices.append(-1)
                    continue
                try:
                    number = int(text)
                except ValueError:
                    number = 0
                index = number - 1 if number > 0 else before + number
                if number == 0 or not 0 <= index < count:
                    named = plain(b"/".join(word).decode("ascii", "backslashreplace"))
                    kind = ("vertices", "texture points", "normals")[part]
                    raise InputError(
                        f"{self.path}: a face names {named}, expected {kind} 1 to {count}, or -1 "
                        "and so on for the last ones"
                    )
                indices.append(index)
        return np.array(indices, dtype=np.int64)

    def read(self) -> Array:
        """The vertices [V, 3], in the file's order."""
        return self._points.copy()

    def read_faces(self) -> Indices | None:
        """Triangles [F, 3]; None if the file has no faces."""
        return self._triangles if len(self._triangles) else None

    def read_colours(self) -> Array | None:
        """Red, green and blue [V, 3] in [0, 1] after the coordinates of a vertex, or None."""
        if self._colour_spans is None:
            return None
        return in_unit(self._numbers(self._colour_spans), self.path)

    def read_paint(self, pictures: Pictures) -> Paint | None:
        """map_Kd of the materials, or Kd; None if there is no picture and vertices have colours."""
        from . import obj_paint

        names = [face.material for face in self._faces for _ in face.words]
        of_faces = [names[place] for place in self._places[:, 0].tolist()]
        materials = obj_paint.read_materials(self.files_named(self._lines), pictures)
        points = self._indices(1, len(self._texture_rows))[self._places]
        coordinates = np.zeros((len(self._texture_rows), 2))  # v may be missing
        for part in (0, 1):
            rows = [row for row, (_, spans) in enumerate(self._texture_rows) if len(spans) > part]
            spans = [self._texture_rows[row][1][part : part + 1] for row in rows]
            coordinates[rows, part] = self._numbers(np.array(spans).reshape(-1, 1, 2))[:, 0]
        paint = obj_paint.painted(of_faces, materials, points, coordinates, pictures)
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
            "colours": self._coloured > 0,
            "normals": self._normal_spans is not None,
        }
        return [name for name, there in parts.items() if there]

    def files_named(self, data: bytes) -> list[str]:
        """The .mtl files that the text names."""
        lines = _LIBRARIES.findall(data)
        names = [name for line in lines for name in _LIBRARY.findall(line) or [line]]
        return [name.decode("utf-8", "replace") for name in names]

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
        """Where numbers change, and their new text.

        It has the digits of a float32 if the old text has no more, and every number has a float32.
        """
        single: NDArray[Any]
        rounded: NDArray[Any]
        with np.errstate(over="ignore"):
            single, rounded = old.astype(np.float32), new.astype(np.float32)
        fits = all(
            np.array_equal(np.isfinite(short), np.isfinite(long))
            for short, long in ((single, old), (rounded, new))
        )
        of_single = np.array_equal(single.astype("S32").astype(np.float64), old)
        if not (fits and (of_single or _few_digits(self.data, spans))):
            single, rounded = old, new
        changed = rounded != single
        return spans[changed][:, 0], spans[changed][:, 1], rounded[changed].astype("S32")


def _few_digits(data: bytes, spans: Indices) -> bool:
    """Whether no number of the text has more than nine digits, as many as a float32 has."""
    for begin, end in spans.reshape(-1, 2).tolist():
        mantissa = re.split(rb"[eE]", data[begin:end])[0]
        digits = mantissa.lstrip(b"+-").replace(b".", b"").lstrip(b"0")
        if len(digits) > 9:
            return False
    return True
