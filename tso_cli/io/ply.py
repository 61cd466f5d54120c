"""PLY files whose vertices can be moved while every other byte stays as it is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .ply_header import Element, Header, Property, parse_header
from .ply_rows import Rows, find_rows
from .reading import shown
from .text import Integers, TextTable

Points = NDArray[np.float64]
AXES = ("x", "y", "z")
COLOURS = ("red", "green", "blue")
CORNERS = ("vertex_indices", "vertex_index")
_CHUNK = 1 << 16  # points of a text rewritten at a time


class PlyFile:
    """The bytes of a PLY file and the places of its vertex coordinates.

    Text and both binary forms are read; the vertex element may stand anywhere among others, and have lists. Whatever
    the header does not account for, other than white space at the end, is an error: a count that is too low would lose
    points.

    Parameters
    ----------
    data : the whole file.
    path : for messages.

    Raises
    ------
    InputError
        It is not a PLY file, has no x, y, z, or its body is shorter or longer than the header says.
    """

    def __init__(self, data: bytes, path: Path) -> None:
        self.data = data
        self.path = path
        self.header: Header = parse_header(data, path)
        self.vertex = self._vertex()
        self.kinds = [p.kind for axis in AXES for p in self.vertex.properties if p.name == axis]
        self._table: TextTable | None = None
        self._rows: Rows | None = None
        self._words: Integers | None = None  # [N, 3], of a text body
        if self.header.order:
            self._rows = find_rows(data, self.header, self.vertex, AXES, path)
        else:
            self._table = TextTable(data, path, self.header.size, self.header.lines)
            self._words = self._find_words(self._table, self.vertex, AXES)

    def _vertex(self) -> Element:
        for element in self.header.elements:
            if element.name == "vertex":
                for axis in AXES:
                    found = [p for p in element.properties if p.name == axis]
                    if not found:
                        names = ", ".join(p.name for p in element.properties) or "none"
                        raise InputError(f"{self.path}: its vertices have no {axis} (properties: {shown(names)})")
                    if found[0].length_kind:
                        raise InputError(f"{self.path}: {axis} of its vertices is a list, expected one number")
                return element
        names = ", ".join(element.name for element in self.header.elements) or "none"
        raise InputError(f"{self.path}: has no vertex element (elements: {shown(names)})")

    @property
    def has_normals(self) -> bool:
        """Whether the vertices carry normals, which moving them makes stale."""
        return any(p.name in ("nx", "ny", "nz", "normal_x", "normal_y", "normal_z") for p in self.vertex.properties)

    def read(self) -> Points:
        """The coordinates [N, 3] of the vertices, in the file's order."""
        if self._rows is not None:
            columns = [self._rows.get(self.data, k, self.kinds[k]) for k in range(3)]
            with np.errstate(invalid="ignore"):  # NaN of the kind that signals
                return np.stack(columns, axis=1, dtype=np.float64)
        assert self._table is not None
        assert self._words is not None
        return self._table.values(self._words)

    def read_colours(self) -> Points | None:
        """Red, green and blue [N, 3] of the vertices in [0, 1], None where the file has none.

        Raises InputError where numbers of a floating-point type lie outside.
        """
        kinds = {p.name: p.kind for p in self.vertex.properties if p.name in COLOURS and not p.length_kind}
        if len(kinds) < len(COLOURS):
            return None
        if self.header.order:
            rows = find_rows(self.data, self.header, self.vertex, COLOURS, self.path)
            found = np.stack([rows.get(self.data, k, kinds[name]) for k, name in enumerate(COLOURS)], axis=1, dtype=np.float64)
        else:
            assert self._table is not None
            found = self._table.values(self._find_words(self._table, self.vertex, COLOURS))
        full = [1.0 if kinds[name].startswith("f") else float(np.iinfo(kinds[name]).max) for name in COLOURS]
        found = found / full
        if not (found.min() >= 0.0 and found.max() <= 1.0):
            raise InputError(
                f"{self.path}: its colours span {found.min():g} to {found.max():g} of their type's range, expected 0 to 1"
            )
        return found

    def read_faces(self) -> Integers | None:
        """Triangles [F, 3] of the faces, polygons as fans around their first corner; None where the file has no faces.

        Raises InputError where a face names a vertex that is not there.
        """
        faces = [element for element in self.header.elements if element.name == "face" and element.count]
        lists = [(own, p) for own in faces for p in own.properties if p.name in CORNERS and p.length_kind]
        if not lists:
            return None
        element, corners = lists[0]
        fans = [np.empty((0, 3), dtype=np.int64)]
        for own in self._read_lists(element, corners):
            wrong = ~((own >= 0) & (own < self.vertex.count) & (own == np.floor(own)))
            if wrong.any():
                last = self.vertex.count - 1
                raise InputError(f"{self.path}: a face names vertex {own[wrong][0]:g}, expected 0 to {last}")
            polygons = own.astype(np.int64)
            ends = polygons[:, 1:-1], polygons[:, 2:]
            fans.append(np.stack([polygons[:, :1].repeat(own.shape[1] - 2, axis=1), *ends], axis=2).reshape(-1, 3))
        return np.concatenate(fans)

    def _read_lists(self, element: Element, wanted: Property) -> Iterator[NDArray[Any]]:
        """The lists ``wanted`` of the rows that hold three values or more, those of one length together: [rows, length]."""
        assert wanted.length_kind is not None
        lengths: NDArray[Any]
        if self.header.order:
            rows = find_rows(self.data, self.header, element, (wanted.name,), self.path)
            lengths = rows.get(self.data, 0, wanted.length_kind)
        else:
            assert self._table is not None
            table, words = self._table, self._find_words(self._table, element, (wanted.name,))
            lengths = table.values(words)[:, 0]
        for length in np.unique(lengths[lengths >= 3]).astype(int).tolist():
            own = np.flatnonzero(lengths == length)
            if self.header.order:
                yield rows.get_lists(self.data, own, length, wanted)
            else:
                yield table.values(words[own] + 1 + np.arange(length))

    def with_points(self, points: Points) -> bytes:
        """The file with its vertices moved to ``points`` [N, 3]; what is not a coordinate keeps its bytes.

        Numbers are rounded to the type the file declares; integer coordinates become double. In text only numbers that
        change are rewritten, with as many digits as tell apart two values of the type; where the text holds more digits
        than its type, those of a double.
        """
        old = self.read()
        if np.array_equal(old, points):
            return self.data
        promoted = [k for k in range(3) if not self.kinds[k].startswith("f")]
        head = self._head(promoted)
        if self._rows is not None:
            columns = [points[:, k].astype(self.header.order + self._kind(k)) for k in range(3)]
            return head + self._rows.put(self.data, self.header.size, columns, self.kinds)
        return head + self._text(old, points)

    def _kind(self, k: int) -> str:
        return self.kinds[k] if self.kinds[k].startswith("f") else "f8"

    def _head(self, promoted: list[int]) -> bytes:
        head = self.data[: self.header.size]
        spans = [p.type_span for p in self.vertex.properties if p.name in [AXES[k] for k in promoted]]
        for begin, end in sorted(spans, reverse=True):
            head = head[:begin] + b"double" + head[end:]
        return head

    def _find_words(self, table: TextTable, wanted: Element, names: tuple[str, ...]) -> Integers:
        """Which words of the text are the ``names`` of the rows ``wanted``, of a list its length, [N, names]."""
        begin = 0
        words = np.empty((0, len(names)), dtype=np.int64)
        for element in self.header.elements:
            count = element.count if element.properties else 0
            if begin + count > table.first.size:
                found = f"{table.first.size - begin} of {count}"
                raise InputError(f"{self.path}: ends after {found} rows of element {shown(element.name)}")
            lines = slice(begin, begin + count)
            places = self._columns(element, table, lines, names if element is wanted else ())
            if element is wanted:
                words = table.first[lines, None] + places
            begin += count
        if begin < table.first.size:
            raise InputError(
                f"{self.path}: has {table.first.size} lines of data, the header accounts for {begin}, expected the same"
            )
        return words

    def _columns(self, element: Element, table: TextTable, lines: slice, names: tuple[str, ...]) -> Integers:
        """Check the number of words of each line; return the columns of ``names`` in it, [N, names]."""
        found = table.counts[lines]
        expected = np.zeros(found.size, dtype=np.int64)
        places = np.zeros((found.size, len(names)), dtype=np.int64)
        for p in element.properties:
            if p.name in names:
                places[:, names.index(p.name)] = expected
            if p.length_kind:
                # Past the end of a short line any word will do: the line is refused below.
                words = np.minimum(table.first[lines] + expected, table.starts.size - 1)
                lengths = table.values(words)
                bad = ~((lengths >= 0) & (lengths <= found) & (lengths == np.floor(lengths)))
                if bad.any():
                    line, length = table.numbers[lines][bad.argmax()], lengths[bad.argmax()]
                    raise InputError(f"{self.path}: line {line} has a list of {length:g} values, more than the line holds")
                expected += lengths.astype(np.int64)
            expected += 1
        wrong = found != expected
        if wrong.any():
            row = int(wrong.argmax())
            raise InputError(
                f"{self.path}: line {table.numbers[lines][row]} has {found[row]} values, "
                f"expected {expected[row]} for element {shown(element.name)}"
            )
        return places

    def _text(self, old: Points, points: Points) -> bytes:
        assert self._table is not None
        assert self._words is not None
        narrow = [self.kinds[k] == "f4" and _is_single(old[:, k]) for k in range(3)]
        out = bytearray()
        at = self.header.size
        for begin in range(0, len(points), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            found: list[tuple[int, int, bytes]] = []
            for k in range(3):
                new, was = points[part, k], old[part, k]
                if narrow[k]:
                    new, was = new.astype(np.float32), was.astype(np.float32)
                moved = new != was
                index = self._words[part, k][moved]
                digits = new[moved].astype("S32").tolist() if narrow[k] else [repr(v).encode() for v in new[moved].tolist()]
                found += zip(self._table.starts[index].tolist(), self._table.ends[index].tolist(), digits, strict=True)
            for start, end, word in sorted(found):
                out += self.data[at:start]
                out += word
                at = end
        return bytes(out + self.data[at:])


def _is_single(values: Points) -> bool:
    """Whether numbers read from text have no more digits than their nearest float32 needs."""
    for begin in range(0, len(values), _CHUNK):
        part = values[begin : begin + _CHUNK]
        with np.errstate(over="ignore"):
            single = part.astype(np.float32)
        if not np.array_equal(single.astype("S32").astype(np.float64), part):
            return False
    return True
