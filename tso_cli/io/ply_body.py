"""The body of a PLY file: the places of its values, the values, and the body with moved points.

A place is a number that says where a value is in the file. `BinaryBody` counts bytes, `TextBody`
counts words. Otherwise the two do the same, by methods of the same names.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array, Indices
from .ply_header import Element
from .reading import TextTable, shown


class Change(NamedTuple):
    """Values that change: their places [N, K], the kinds of the K columns, old and new [N, K]."""

    places: Indices
    kinds: Sequence[str]
    old: Array
    new: Array


def layout(
    body: BinaryBody | TextBody, element: Element, rows: Indices, names: tuple[str, ...] = ()
) -> tuple[dict[str, Indices], Indices]:
    """Where the properties ``names`` and the ends of rows are, for rows that start at ``rows`` [N].

    Returns name -> places [N], and the places [N] at which the rows end.
    """
    at, places = rows, {}
    for p in element.properties.values():
        if p.name in names:
            places[p.name] = at
        size: Indices | int = body.width(p.kind)
        if p.length_kind:
            lengths = body.lengths(rows, at, p.length_kind)
            size = body.width(p.length_kind) + size * lengths
        at = at + size
    return places, at


def _truncated(path: Path, element: Element, rows: int) -> InputError:
    return InputError(
        f"{path}: ends after {rows} of {element.count} rows of element {shown(element.name)}, "
        "expected a whole file"
    )


class BinaryBody:
    """The rows of a binary file. The place of a value is its first byte in the file."""

    def __init__(self, data: bytes, path: Path, start: int, order: str) -> None:
        self.data, self.path, self._start, self._order = data, path, start, order
        self._at = start  # where the next rows start

    def width(self, kind: str) -> int:
        """The number of places that a value of ``kind`` takes."""
        return int(kind[1])

    def values(self, places: Indices, kind: str) -> NDArray[Any]:
        """The values of ``kind`` at ``places`` [...]."""
        return self._view(self.data, kind)[places]

    def columns(self, places: Indices, kinds: Sequence[str]) -> Array:
        """The values [N, K] at ``places`` [N, K]; column k is of the k-th kind."""
        with np.errstate(invalid="ignore"):  # signalling NaN
            return np.stack(
                [self.values(places[:, k], kind) for k, kind in enumerate(kinds)],
                axis=1,
                dtype=np.float64,
            )

    def lengths(self, rows: Indices, places: Indices, kind: str) -> Indices:
        """The lengths [N] of lists at ``places`` [N] in the rows that start at ``rows`` [N]."""
        return self.values(places.clip(0, len(self.data) - self.width(kind)), kind).astype(np.int64)

    def _view(self, data: bytes | bytearray, kind: str) -> NDArray[Any]:
        """What a value of ``kind`` would be at each byte of ``data``."""
        dtype = np.dtype(self._order + kind)
        return np.ndarray((max(len(data) - dtype.itemsize + 1, 0),), dtype, data, 0, (1,))

    def take_rows(self, element: Element) -> Indices:
        """Where the next rows start; InputError if the file ends before the last of them.

        Rows that the header promises and the file lacks take no memory.
        """
        if not element.count or not element.properties:
            return np.empty(0, dtype=np.int64)
        size = self._row_end(element, self._at, 0) - self._at
        if self._at + size * element.count <= len(self.data):
            rows = self._at + size * np.arange(element.count)
            if (layout(self, element, rows)[1] == rows + size).all():
                self._at += size * element.count
                return rows
        starts = []
        for row in range(element.count):
            starts.append(self._at)
            self._at = self._row_end(element, self._at, row)
        return np.array(starts, dtype=np.int64)

    def _row_end(self, element: Element, at: int, row: int) -> int:
        for p in element.properties.values():
            count = 1
            if p.length_kind:
                start, at = at, at + self.width(p.length_kind)
                if at > len(self.data):
                    break
                order: Literal["big", "little"] = "big" if self._order == ">" else "little"
                count = int.from_bytes(self.data[start:at], order, signed=p.length_kind[0] == "i")
                if count < 0:
                    where = f"row {row} of element {shown(element.name)}"
                    raise InputError(
                        f"{self.path}: {where} has a list of {count} values, expected 0 or more"
                    )
            at += count * self.width(p.kind)
        if at > len(self.data):
            raise _truncated(self.path, element, row)
        return at

    def check_end(self) -> None:
        """Raise InputError if anything follows the last row."""
        rest = self.data[self._at :]
        if rest.strip():
            raise InputError(
                f"{self.path}: {len(rest):,} bytes follow the data that the header describes, "
                "expected none"
            )

    def changed(self, changes: Iterable[Change]) -> bytes:
        """The body with its ``changes``; integers become double."""
        out = bytearray(self.data)
        starts, ends = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
        words: list[NDArray[Any]] = [np.empty(0, "V8")]
        for places, kinds, _, new in changes:
            for k, kind in enumerate(kinds):
                if kind[0] == "f":
                    self._view(out, kind)[places[:, k]] = new[:, k]
                else:
                    starts.append(places[:, k])
                    ends.append(places[:, k] + self.width(kind))
                    words.append(new[:, k].astype(self._order + "f8").view("V8"))
        spans = np.concatenate(starts), np.concatenate(ends), np.concatenate(words)
        return spliced(out, self._start, *spans)

    def without(self, rows: Indices, ends: Indices, corners: Sequence[Change]) -> bytes:
        """The body without the rows [R] that end at ``ends`` [R], and with other ``corners``."""
        spans = [(rows, ends, np.full(len(rows), b"", object))]
        for places, (kind,), _, new in corners:
            values = new.astype(self._order + kind)
            words = np.array([value.tobytes() for value in values.ravel()], object)
            spans.append((places.ravel(), places.ravel() + self.width(kind), words))
        return spliced(self.data, self._start, *map(np.concatenate, zip(*spans, strict=True)))

    def with_floats(self, places: Indices, kind: str, values: Array) -> bytes:
        """The body with ``values`` [N] as floats after the values of ``kind`` at ``places`` [N]."""
        at = places + self.width(kind)
        return spliced(self.data, self._start, at, at, values.astype(self._order + "f4").view("V4"))


class TextBody:
    """The rows of a text file, one per line. The place of a value is the index of its word."""

    def __init__(self, data: bytes, path: Path, start: int, lines_before: int) -> None:
        self.path, self._start = path, start
        self._table = TextTable(data, path, start, lines_before)
        self._used = 0  # lines of the rows taken so far

    def width(self, kind: str) -> int:
        return 1

    def values(self, places: Indices, kind: str) -> NDArray[Any]:
        return self._table.values(places)

    def columns(self, places: Indices, kinds: Sequence[str]) -> Array:
        return self._table.values(places)

    def lengths(self, rows: Indices, places: Indices, kind: str) -> Indices:
        lines = np.searchsorted(self._table.first, rows)
        # Past the end of a short line any word will do: `take_rows` refuses the short line.
        lengths = self.values(np.minimum(places, len(self._table.starts) - 1), kind)
        fits = (lengths >= 0) & (lengths <= self._table.counts[lines])
        bad = ~(fits & (lengths == np.floor(lengths)))
        if bad.any():
            line, length = self._table.numbers[lines][bad.argmax()], lengths[bad.argmax()]
            raise InputError(
                f"{self.path}: line {line} has a list of {length:g} values, "
                "expected a whole number, at most the values in the line"
            )
        return lengths.astype(np.int64)

    def take_rows(self, element: Element) -> Indices:
        """The first words of the next rows; InputError if a row has too few or too many words."""
        lines = slice(self._used, self._used + (element.count if element.properties else 0))
        rows, counts = self._table.first[lines], self._table.counts[lines]
        if len(rows) < lines.stop - lines.start:
            raise _truncated(self.path, element, len(rows))
        expected = layout(self, element, rows)[1] - rows
        if (wrong := counts != expected).any():
            row = int(wrong.argmax())
            raise InputError(
                f"{self.path}: line {self._table.numbers[lines][row]} has {counts[row]} values, "
                f"expected {expected[row]} for element {shown(element.name)}"
            )
        self._used = lines.stop
        return rows

    def check_end(self) -> None:
        lines = len(self._table.first)
        if self._used < lines:
            raise InputError(
                f"{self.path}: has {lines} lines of data, the header describes {self._used}, "
                "expected the same"
            )

    def changed(self, changes: Iterable[Change]) -> bytes:
        starts, ends, words = [], [], []
        for change in changes:
            for k, kind in enumerate(change.kinds):
                new: NDArray[Any] = change.new[:, k]
                was: NDArray[Any] = change.old[:, k]
                with np.errstate(over="ignore"):
                    single = was.astype(np.float32)
                if kind == "f4" and np.array_equal(single.astype("S32").astype(np.float64), was):
                    # The text has no more digits than its type.
                    new, was = new.astype(np.float32), single
                differs = new != was
                starts.append(self._table.starts[change.places[differs, k]])
                ends.append(self._table.ends[change.places[differs, k]])
                words.append(new[differs].astype("S32"))
        spans = np.concatenate(starts), np.concatenate(ends), np.concatenate(words)
        return spliced(self._table.data, self._start, *spans)

    def without(self, rows: Indices, ends: Indices, corners: Sequence[Change]) -> bytes:
        # A row ends where the next one starts, so that no line stays empty.
        starts = np.append(self._table.starts, len(self._table.data))
        spans = [(starts[rows], starts[ends], np.full(len(rows), b"", object))]
        for places, _, _, new in corners:
            words = np.array([b"%d" % value for value in new.ravel().astype(int).tolist()], object)
            at = places.ravel()
            spans.append((self._table.starts[at], self._table.ends[at], words))
        return spliced(
            self._table.data, self._start, *map(np.concatenate, zip(*spans, strict=True))
        )

    def with_floats(self, places: Indices, kind: str, values: Array) -> bytes:
        at, words = self._table.ends[places], values.astype(np.float32).astype("S32")
        return spliced(self._table.data, self._start, at, at, np.char.add(b" ", words))


def spliced(
    data: bytes | bytearray, at: int, starts: Indices, ends: Indices, words: NDArray[Any]
) -> bytes:
    """``data[at:]`` with the bytes from ``starts`` to ``ends`` [W] replaced by ``words`` [W]."""
    out = bytearray()
    # About 65,536 values at once, which bounds the memory.
    for part in np.array_split(np.argsort(starts), 1 + len(starts) // (1 << 16)):
        for start, end, word in zip(
            starts[part].tolist(), ends[part].tolist(), words[part].tolist(), strict=True
        ):
            out += data[at:start]
            out += word
            at = end
    return bytes(out + data[at:])
