"""Where the vertex coordinates lie in the body of a binary PLY file."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .ply_header import Element, Header, Property
from .reading import shown
from .text import Integers

_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I"}


@dataclass(frozen=True)
class Rows:
    """The rows of one element and K values in each; of a list its length.

    Either all rows are ``stride`` bytes long and the values lie at ``offsets`` [K] in each, or ``places`` [N, K] gives
    the byte of each value in the file.
    """

    start: int
    end: int
    count: int
    order: str
    stride: int = 0
    offsets: tuple[int, ...] = ()
    places: Integers | None = None

    def get(self, data: bytes, k: int, kind: str) -> NDArray[Any]:
        """The ``k``-th value [N] of each row."""
        dtype = np.dtype(self.order + kind)
        if self.places is None:
            if self.count == 0:
                return np.empty(0, dtype)
            return np.ndarray((self.count,), dtype, data, self.start + self.offsets[k], (self.stride,))
        letters = np.frombuffer(data, dtype=np.uint8)[self.places[:, k, None] + np.arange(dtype.itemsize)]
        return letters.view(dtype)[:, 0]

    def get_lists(self, data: bytes, which: Integers, length: int, wanted: Property) -> NDArray[Any]:
        """The values [n, length] of the list ``wanted``, the first of the K, in the rows ``which`` [n], all of that length."""
        assert wanted.length_kind is not None
        dtype, width = np.dtype(self.order + wanted.kind), int(wanted.length_kind[1])
        if self.places is None:
            # Rows of one stride hold lists of one length: these are all of them.
            start, strides = self.start + self.offsets[0] + width, (self.stride, dtype.itemsize)
            return np.ndarray((self.count, length), dtype, data, start, strides)
        steps = np.arange(width, width + length * dtype.itemsize)
        return np.frombuffer(data, dtype=np.uint8)[self.places[which, :1] + steps].view(dtype)

    def put(self, data: bytes, begin: int, columns: list[NDArray[np.generic]], kinds: list[str]) -> bytes:
        """``data[begin:]`` with the values replaced by ``columns``, whose types may be wider than ``kinds``."""
        old = [int(kind[1]) for kind in kinds]
        new = [column.dtype.itemsize for column in columns]
        body = np.frombuffer(data, dtype=np.uint8, offset=begin)
        if old == new and all(kind.startswith("f") for kind in kinds):
            out = body.copy()
            for k, column in enumerate(columns):
                letters = column.view(np.uint8).reshape(self.count, new[k])
                steps = np.arange(new[k])
                if self.places is None:
                    first, last = self.start - begin, self.end - begin
                    out[first:last].reshape(self.count, self.stride)[:, self.offsets[k] + steps] = letters
                else:
                    out[self.places[:, k, None] - begin + steps] = letters
            return out.tobytes()
        places = self.places
        if places is None:
            places = self.start + self.stride * np.arange(self.count)[:, None] + np.array(self.offsets)
        pieces = []
        at = begin
        source = memoryview(data)
        by_place = np.argsort(places[0])
        values = [column.view(f"V{size}").tolist() for column, size in zip(columns, new, strict=True)]
        for row, starts in enumerate(places.tolist()):
            for k in by_place.tolist():
                pieces += [source[at : starts[k]], values[k][row]]
                at = starts[k] + old[k]
        pieces.append(source[at:])
        return b"".join(pieces)


def find_rows(data: bytes, header: Header, wanted: Element, names: tuple[str, ...], path: Path) -> Rows:
    """The rows of the element ``wanted`` and the places of its properties ``names``.

    Raises
    ------
    InputError
        The body is shorter or longer than ``header`` says. Nothing is allocated for rows that are not there.
    """
    found = None
    at = header.size
    for element in header.elements:
        own = names if element is wanted else ()
        rows = _uniform(data, at, element, header.order, own) or _walk(data, at, element, header.order, own, path)
        if element is wanted:
            found = rows
        at = rows.end
    rest = data[at:]
    if rest.strip():
        raise InputError(f"{path}: {len(rest):,} bytes follow the data that the header accounts for, expected none")
    assert found is not None
    return found


def _uniform(data: bytes, start: int, element: Element, order: str, names: tuple[str, ...]) -> Rows | None:
    """The rows if all have the lengths of the first one (always so without lists), else None."""
    offsets: dict[str, int] = {}
    lengths: list[tuple[int, int]] = []  # offset and size of the length of each list
    size = 0
    for p in element.properties:
        offsets[p.name] = size
        if p.length_kind:
            width = int(p.length_kind[1])
            first = data[start + size : start + size + width]
            if element.count == 0 or len(first) < width:
                return None
            lengths.append((size, width))
            (length,) = struct.unpack(order + _CODES[p.length_kind], first)
            if length < 0:
                return None
            size += width + length * p.size
        else:
            size += p.size
    end = start + size * element.count
    if end > len(data):
        return None
    if lengths and element.count:
        rows = np.frombuffer(data, np.uint8, element.count * size, start).reshape(element.count, size)
        for offset, width in lengths:
            if (rows[:, offset : offset + width] != rows[0, offset : offset + width]).any():
                return None
    return Rows(start, end, element.count, order, size, tuple(offsets[name] for name in names))


def _walk(data: bytes, start: int, element: Element, order: str, names: tuple[str, ...], path: Path) -> Rows:
    """The rows one by one: for lists of different lengths, and to say where a body that is too short ends."""
    at = start
    places: list[int] = []
    if not element.has_lists:
        size = sum(p.size for p in element.properties)
        raise _short(path, element, (len(data) - start) // max(size, 1))
    steps = [
        (struct.Struct(order + _CODES[p.length_kind]) if p.length_kind else None, p.size, p.name in names)
        for p in element.properties
    ]
    for row in range(element.count):
        for length, size, keep in steps:
            if keep:
                places.append(at)
            if length is None:
                at += size
            elif at + length.size > len(data):
                raise _short(path, element, row)
            else:
                (number,) = length.unpack_from(data, at)
                if number < 0:
                    where = f"row {row} of element {shown(element.name)}"
                    raise InputError(f"{path}: {where} has a list of {number} values, expected 0 or more")
                at += length.size + number * size
        if at > len(data):
            raise _short(path, element, row)
    table = np.array(places, dtype=np.int64).reshape(element.count, len(names)) if names else None
    if table is not None:
        order_in_row = [p.name for p in element.properties if p.name in names]
        table = table[:, [order_in_row.index(name) for name in names]]
    return Rows(start, at, element.count, order, places=table)


def _short(path: Path, element: Element, rows: int) -> InputError:
    return InputError(f"{path}: ends after {rows} of {element.count} rows of element {shown(element.name)}")
