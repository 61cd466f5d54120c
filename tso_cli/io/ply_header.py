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
    properties: dict[str, Property] | None = None
    order: str | None = None
    lines = list(re.compile(rb"[^\r\n]+").finditer(data, first.end(), end.start()))
    for match in lines:
        words = [word.decode("ascii", "backslashreplace") for word in match[0].split()]
        line = f"{path}: header line {shown(match[0].decode('ascii', 'backslashreplace'))}"
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format":
            if len(words) != 3 or words[1] not in FORMATS or words[2] != "1.0":
                raise InputError(f"{line}: expected one of {', '.join(FORMATS)} and version 1.0")
            if order is not None:
                raise InputError(f"{line}: a second format, expected one")
            order = FORMATS[words[1]]
        elif words[0] == "element":
            fits = len(words) == 3 and re.fullmatch(r"[0-9]{1,20}", words[2])
            if not fits or int(words[2]) > 1 << 60:  # it can only be damage
                raise InputError(f"{line}: expected a name and a count")
            if words[1] in elements:
                raise InputError(f"{line}: a second element of that name, expected one")
            properties = {}
            elements[words[1]] = Element(words[1], int(words[2]), properties)
        elif words[0] == "property":
            if properties is None:
                raise InputError(f"{line}: expected an element before it")
            entry = _property(words, match, line)
            if entry.name in properties:
                raise InputError(f"{line}: a second property of that name, expected one")
            properties[entry.name] = entry
        else:
            raise InputError(f"{line}: expected format, comment, obj_info, element or property")
    if order is None:
        raise InputError(f"{path}: the PLY header has no format line, expected one")
    return Header(order, elements, end.end(), len(lines) + 2)


def _property(words: list[str], match: re.Match[bytes], line: str) -> Property:
    if len(words) == 5 and words[1] == "list" and words[2] in KINDS and words[3] in KINDS:
        if KINDS[words[2]].startswith("f"):
            raise InputError(
                f"{line}: the length of a list is a {words[2]}, expected an integer type"
            )
        return Property(words[4], KINDS[words[3]], KINDS[words[2]], (0, 0))
    if len(words) == 3 and words[1] in KINDS:
        start = match.start() + match[0].index(words[1].encode())
        return Property(words[2], KINDS[words[1]], None, (start, start + len(words[1])))
    raise InputError(
        f"{line}: expected 'property TYPE NAME' or 'property list TYPE TYPE NAME' "
        "with types of PLY 1.0 (char to int, float, double); convert the file"
    )
