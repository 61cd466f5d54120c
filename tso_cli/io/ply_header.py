"""The header of a PLY file: what the body holds, and where in the header that is said."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from .reading import shown

HEADER_LIMIT = 1 << 20  # bytes; a real header is a few hundred, a long list of comments some thousand
COUNT_LIMIT = 1 << 60
FORMS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True)
class Property:
    """One value of an element, or a list of values where ``length_kind`` is set. Kinds are numpy's: "f4", "u1"."""

    name: str
    kind: str
    length_kind: str | None
    type_span: tuple[int, int]  # where in the file the name of the type stands

    @property
    def size(self) -> int:
        """Bytes of one value."""
        return int(self.kind[1])


@dataclass(frozen=True)
class Element:
    """``count`` rows, each with the same properties."""

    name: str
    count: int
    properties: list[Property]

    @property
    def has_lists(self) -> bool:
        """Whether rows may differ in length."""
        return any(p.length_kind for p in self.properties)


@dataclass(frozen=True)
class Header:
    """``order`` is the byte order ("<" or ">"), "" for a text body; the body starts at byte ``size``."""

    order: str
    elements: list[Element]
    size: int
    lines: int


def parse_header(data: bytes, path: Path) -> Header:
    """Read the header at the start of ``data``.

    Raises
    ------
    InputError
        It is not a PLY header, is longer than 1 MiB, or says something that cannot be.
    """
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    if first is None:
        raise InputError(f"{path}: is not a PLY file (starts with {shown(data[:12])}), expected a first line 'ply'")
    # Where lines end in a bare \r, a \n after the header already belongs to a binary body.
    ending = rb"\r" if first[1] == b"\r" else rb"(?:\r\n|\n|\r)"
    end = re.compile(rb"[\r\n]end_header[ \t]*" + ending).search(data, 0, HEADER_LIMIT)
    if end is None:
        raise InputError(f"{path}: the PLY header has no end_header line within its first {HEADER_LIMIT:,} bytes")
    elements: list[Element] = []
    order: str | None = None
    number = 1
    for match in re.compile(rb"[^\r\n]+").finditer(data, first.end(), end.start()):
        number += 1
        words = [word[0].decode("ascii", "backslashreplace") for word in re.finditer(rb"\S+", match[0])]
        line = f"{path}: header line {shown(match[0].decode('ascii', 'backslashreplace'))}"
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format":
            if len(words) != 3 or words[1] not in FORMS or words[2] != "1.0":
                raise InputError(f"{line}: expected one of {', '.join(FORMS)} and version 1.0")
            if order is not None:
                raise InputError(f"{line}: a second format, expected one")
            order = FORMS[words[1]]
        elif words[0] == "element":
            if len(words) != 3 or not re.fullmatch(r"[0-9]{1,20}", words[2]) or int(words[2]) > COUNT_LIMIT:
                raise InputError(f"{line}: expected a name and a count")
            if any(element.name == words[1] for element in elements):
                raise InputError(f"{line}: a second element of that name, expected one")
            elements.append(Element(words[1], int(words[2]), []))
        elif words[0] == "property":
            if not elements:
                raise InputError(f"{line}: expected an element before it")
            entry = _property(words, match, line)
            if any(other.name == entry.name for other in elements[-1].properties):
                raise InputError(f"{line}: a second property of that name, expected one")
            elements[-1].properties.append(entry)
        else:
            raise InputError(f"{line}: expected format, comment, obj_info, element or property")
    if order is None:
        raise InputError(f"{path}: the PLY header has no format line")
    return Header(order, elements, end.end(), number + 1)


def _property(words: list[str], match: re.Match[bytes], line: str) -> Property:
    if len(words) == 5 and words[1] == "list" and words[2] in KINDS and words[3] in KINDS:
        if KINDS[words[2]].startswith("f"):
            raise InputError(f"{line}: the length of a list is a {words[2]}, expected an integer type")
        return Property(words[4], KINDS[words[3]], KINDS[words[2]], (0, 0))
    if len(words) == 3 and words[1] in KINDS:
        word = list(re.finditer(rb"\S+", match[0]))[1]
        return Property(words[2], KINDS[words[1]], None, (match.start() + word.start(), match.start() + word.end()))
    raise InputError(f"{line}: expected 'property TYPE NAME' or 'property list TYPE TYPE NAME' with types of PLY 1.0")
