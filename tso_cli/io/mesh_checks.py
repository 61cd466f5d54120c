"""Whether mesh files are whole and fit into memory, before they are parsed."""

from __future__ import annotations

import re
import struct
from pathlib import Path

from ..errors import InputError
from .checked import Checked
from .gltf_scene import WHOLE_SCENE, document_of, memory_of, objects_of, scene_text
from .guard import reading
from .ply_body import BinaryBody, TextBody
from .ply_header import parse_header
from .reading import require_memory, shown

_HEADER, _TRIANGLE = 84, 50  # bytes of a binary STL file
_GLUED = re.compile(rb"\A(\s*OFF)(?=\d)")
_COUNTS = re.compile(rb"OFF\s*(?:#[^\n]*\n\s*)*(\d{1,18})\s+(\d{1,18})[^\n]*")


def parted(content: bytes) -> bytes:
    """An OFF file whose first line is OFF alone; files of ModelNet have counts after it."""
    return _GLUED.sub(rb"\1\n", content, count=1)


def check_off(content: bytes, path: Path) -> None:
    """Raise InputError if an OFF file lacks lines that it states, or numbers in a line."""
    match = _COUNTS.search(content)
    if match is None:
        raise InputError(
            f"{path}: has no counts of vertices and faces after OFF, expected a whole OFF file"
        )
    vertices, faces = int(match[1]), int(match[2])
    found, first = 0, content.count(b"\n", 0, match.end()) + 1
    for number, line in enumerate(content[match.end() :].splitlines(), first):
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        if found < vertices:
            _check_place(words, number, path)
        elif found < vertices + faces and not (
            words[0].isdigit() and len(words[0]) < 10 and len(words) > int(words[0])
        ):
            raise _wrong_line(
                words, number, path, "the count of corners of a face and its vertices"
            )
        found += 1
    if found < vertices + faces:
        nouns = ("vertex" if vertices == 1 else "vertices", "face" if faces == 1 else "faces")
        raise InputError(
            f"{path}: ends early: it has {found:,} lines after its counts, which state "
            f"{vertices:,} {nouns[0]} and {faces:,} {nouns[1]}, expected a line for each"
        )


def check_glb(content: bytes, path: Path) -> None:
    """Raise InputError if a GLB needs more memory than is free, or lacks values of its meshes."""
    text, _ = scene_text(content, path)
    document = document_of(text, path)
    checked = Checked()
    checked.path = path
    for number, accessor in enumerate(objects_of(checked, document, "accessors")):
        if "bufferView" not in accessor and "sparse" not in accessor and accessor.get("count"):
            raise checked.error(
                f"accessors[{number}]",
                "without values (it has no bufferView)",
                "some; export it again, without compression",
            )
    with reading(checked, WHOLE_SCENE):
        require_memory(path, memory_of(checked, document))


def check_ply(content: bytes, path: Path) -> None:
    """Raise InputError if a PLY file is not one, or ends before the rows that its header states."""
    header = parse_header(content, path)
    body: BinaryBody | TextBody = (
        BinaryBody(content, path, header.size, header.order)
        if header.order
        else TextBody(content, path, header.size, header.lines)
    )
    for element in header.elements.values():
        body.take_rows(element)


def check_stl(content: bytes, path: Path) -> None:
    """Raise InputError if an STL file, text or binary, is not whole."""
    stated = struct.unpack_from("<I", content, 80)[0] if len(content) >= _HEADER else 0
    body = len(content) - _HEADER
    if body == stated * _TRIANGLE:
        return
    if not (re.match(rb"\s*solid", content) and re.search(rb"\bfacet\b", content, re.IGNORECASE)):
        raise InputError(
            f"{path}: has {max(body, 0):,} bytes after its header, expected {_TRIANGLE} for each "
            f"of the {stated:,} triangles that it states; the file ends early or is no STL file"
        )
    counts = dict.fromkeys(("solid", "endsolid", "facet", "endfacet", "vertex"), 0)
    for number, line in enumerate(content.splitlines(), 1):
        words = line.split()
        name = words[0].lower().decode("ascii", "replace") if words else ""
        counts[name] = counts.get(name, 0) + 1
        if name == "vertex":
            _check_place(words[1:], number, path)
    for name in ("facet", "solid"):
        begun, ended = counts[name], counts[f"end{name}"]
        if begun != ended:
            raise InputError(
                f"{path}: ends early: it has {begun:,} lines with {name} and {ended:,} with "
                f"end{name}, expected the same; export it again"
            )
    if counts["vertex"] != 3 * counts["facet"]:
        raise InputError(
            f"{path}: has {counts['vertex']:,} vertices in {counts['facet']:,} facets, expected 3 "
            "in each; export it again"
        )


def _check_place(words: list[bytes], number: int, path: Path) -> None:
    """Raise InputError unless a line begins with x, y and z."""
    try:
        if len([float(word) for word in words[:3]]) < 3:
            raise ValueError
    except ValueError:
        raise _wrong_line(words, number, path, "x, y and z") from None


def _wrong_line(words: list[bytes], number: int, path: Path, expected: str) -> InputError:
    text = shown(b" ".join(words).decode("ascii", "backslashreplace"))
    return InputError(f"{path}: line {number} has {text}, expected {expected}")
