"""The header of a PLY file: the elements of the body, their properties and types."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from .reading import shown

# Bytes. Real headers have a few hundred bytes, with many comments a few thousand.
HEADER_LIMIT = 1 << 20
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
KINDS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip

_LENGTHS = [name for name, kind in KINDS.items() if kind[0] != "f"]  # types of a list's length
_COUNT = re.compile(r"[0-9]{1,18}")  # a longer one can only be damage
_EXPECTED = {
    "format": f"one of {', '.join(FORMATS)}, version 1.0, and one such line",
    "element": "a name that no other element has, and a count",
    "property": "'property TYPE NAME' or 'property list TYPE TYPE NAME' after an element, with "
    "types of PLY 1.0 (char to int, float, double; integers for lengths) and a name that no other "
    "property of it has; convert the file",
}


@dataclass(frozen=True)
class Property:
    """One value of an element, or a list if ``length_kind`` is set. Kinds are numpy's: "f4"."""

    name: str
    kind: str
    length_kind: str | None
    type_span: tuple[int, int]  # bytes of the file where a scalar's type is named


@dataclass(frozen=True)
class Element:
    name: str
    count: int
    properties: dict[str, Property]


@dataclass(frozen=True)
class Header:
    """A PLY header that was read."""

    order: str  # byte order of the body, "<" or ">"; "" for a text body
    elements: dict[str, Element]
    size: int  # bytes of the header: the body starts there
    lines: int


def parse_header(data: bytes, path: Path) -> Header:
    """Read the header at the start of ``data``.

    Raises InputError if ``data`` does not start with a header, or if the header contradicts itself.
    """
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    if first is None:
        beginning = shown(data[:12])
        raise InputError(
            f"{path}: is not a PLY file (starts with {beginning}), expected a first line 'ply'"
        )
    # If lines end in a bare \r, a \n after the header already belongs to a binary body.
    ending = rb"\r" if first[1] == b"\r" else rb"(?:\r\n|\n|\r)"
    end = re.compile(rb"[\r\n]end_header[ \t]*" + ending).search(data, 0, HEADER_LIMIT)
    if end is None:
        raise InputError(
            f"{path}: the PLY header has no end_header line, "
            f"expected one within its first {HEADER_LIMIT:,} bytes"
        )
    elements: dict[str, Element] = {}
    properties: dict[str, Property] = {}
    order: str | None = None
    lines = list(re.compile(rb"[^\r\n]+").finditer(data, first.end(), end.start()))
    for line in lines:
        text = line[0].decode("ascii", "backslashreplace")
        match text.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", form, "1.0"] if form in FORMATS and order is None:
                order = FORMATS[form]
            case ["element", name, count] if name not in elements and _COUNT.fullmatch(count):
                properties = {}
                elements[name] = Element(name, int(count), properties)
            case ["property", "list", length, kind, name] if (
                elements and name not in properties and kind in KINDS and length in _LENGTHS
            ):
                properties[name] = Property(name, KINDS[kind], KINDS[length], (0, 0))
            case ["property", kind, name] if elements and name not in properties and kind in KINDS:
                start = line.start() + line[0].index(kind.encode())
                span = start, start + len(kind)
                properties[name] = Property(name, KINDS[kind], None, span)
            case [word, *_]:
                expected = _EXPECTED.get(word, f"{', '.join(_EXPECTED)}, comment or obj_info")
                raise InputError(f"{path}: header line {shown(text)}: expected {expected}")
    if order is None:
        raise InputError(f"{path}: the PLY header has no format line, expected one")
    return Header(order, elements, end.end(), len(lines) + 2)
