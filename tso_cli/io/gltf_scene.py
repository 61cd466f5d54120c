"""The JSON of a glTF or GLB scene: its nodes, their places, and changes of a few of its values."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array
from ..geometry.rotations import from_quaternion
from .checked import Checked, kind
from .output import reason
from .reading import json_reason

MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"
MOST_NODES = 100_000
COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# What a reader takes of a node's own copy of a mesh, in bytes.
_BYTES_PER_VERTEX, _BYTES_PER_CORNER = 100, 60
_GLOSS = "KHR_materials_pbrSpecularGlossiness"
_GLOSS_PICTURES = ("diffuseTexture", "specularGlossinessTexture")


def scene_text(data: bytes, path: Path) -> tuple[str, bytes]:
    """The JSON of a scene, and the binary part of a GLB (empty without one)."""
    try:
        if data[:4] != MAGIC:
            return data.decode("utf-8-sig"), b""
        length, form = struct.unpack_from("<I4s", data, 12)
        if form != JSON_CHUNK or 20 + length > len(data):
            raise ValueError("its first part is not JSON")
        text, rest = data[20 : 20 + length].decode(), data[20 + length :]
        if not rest:
            return text, b""
        length, form = struct.unpack_from("<I4s", rest)
        if form != BINARY_CHUNK or 8 + length > len(rest):
            raise ValueError("its second part is not a whole BIN")
        return text, rest[8 : 8 + length]
    except (struct.error, ValueError) as error:
        why = "it ends early" if isinstance(error, struct.error) else reason(error)
        raise InputError(f"{path}: is a damaged GLB or glTF ({why})") from None


def document_of(text: str, path: Path) -> dict[str, Any]:
    """The JSON document of a scene."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is a damaged GLB or glTF ({json_reason(error)})") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: holds {kind(document)}, expected the object of a glTF scene")
    return document


def objects_of(checked: Checked, document: dict[str, Any], key: str) -> list[dict[str, Any]]:
    """The list of objects ``key`` of a scene; empty if it has none."""
    values = document.get(key, [])
    if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
        raise checked.error(key, kind(values), "a list of objects")
    if len(values) > MOST_NODES:
        raise checked.error(key, f"a list of {len(values):,}", f"at most {MOST_NODES:,}")
    return values


def memory_of(document: dict[str, Any]) -> int:
    """About how many bytes the meshes of a scene take; each node has its own copy.

    A few bytes of a file can stand for many: an accessor need not hold its values, and many nodes
    can show one mesh. What is damaged counts as nothing; its reader says so.
    """

    def listed(of: dict[str, Any], key: str) -> list[dict[str, Any]]:
        values = of.get(key)
        values = values if isinstance(values, list) else []
        return [value if isinstance(value, dict) else {} for value in values]

    def at(index: Any, values: list[int]) -> int:
        known = isinstance(index, int) and 0 <= index < len(values)
        return values[index] if known else 0

    counts, stored = [], 0
    for accessor in listed(document, "accessors"):
        count = accessor.get("count")
        counts.append(max(count, 0) if isinstance(count, int) else 0)
        form, component = accessor.get("type"), accessor.get("componentType")
        if isinstance(form, str) and isinstance(component, int):
            size = np.dtype(COMPONENTS.get(component, "i1")).itemsize
            stored += counts[-1] * WIDTHS.get(form, 0) * size
    meshes = []
    for mesh in listed(document, "meshes"):
        meshes.append(0)
        for primitive in listed(mesh, "primitives"):
            attributes = primitive.get("attributes")
            position = attributes.get("POSITION") if isinstance(attributes, dict) else None
            vertices = at(position, counts)
            corners = at(primitive["indices"], counts) if "indices" in primitive else vertices
            meshes[-1] += _BYTES_PER_VERTEX * vertices + _BYTES_PER_CORNER * corners
    return stored + sum(at(node.get("mesh"), meshes) for node in listed(document, "nodes"))


def with_base_colours(data: bytes) -> bytes:
    """The GLB ``data`` with base colours in place of pictures for specular and glossiness.

    trimesh would mix the pictures of such a material in floating point while it reads, 240 bytes
    for a pixel, and whether or not textures are wanted.
    """
    length = struct.unpack_from("<I", data, 12)[0]
    document, changed = json.loads(data[20 : 20 + length]), False
    for material in document.get("materials", ()):
        extensions = material.get("extensions") or {}
        gloss = extensions.get(_GLOSS)
        if isinstance(gloss, dict) and gloss.keys() & set(_GLOSS_PICTURES):
            material["pbrMetallicRoughness"] = base_colour_of(material)
            del extensions[_GLOSS]
            changed = True
    return glb_of(data, json.dumps(document), data[20 + length :]) if changed else data


def base_colour_of(material: dict[str, Any]) -> dict[str, Any]:
    """``baseColorFactor`` and ``baseColorTexture`` of a material.

    Of one for specular and glossiness they are its diffuse colours.
    """
    gloss = (material.get("extensions") or {}).get(_GLOSS)
    if "pbrMetallicRoughness" in material or not isinstance(gloss, dict):
        return material.get("pbrMetallicRoughness") or {}
    base = {"baseColorFactor": gloss.get("diffuseFactor", [1, 1, 1, 1])}
    if "diffuseTexture" in gloss:
        base["baseColorTexture"] = gloss["diffuseTexture"]
    return base


def glb_of(data: bytes, text: str, rest: bytes) -> bytes:
    """The GLB ``data`` with the JSON ``text``, and ``rest`` in place of what follows the JSON."""
    head = text.rstrip(" ").encode()
    head += b" " * (-len(head) % 4)
    # Bytes after the length that the file states stay outside of it.
    stated = struct.unpack_from("<I", data, 8)[0]
    total = max(20 + len(head) + len(rest) - max(len(data) - stated, 0), 0)
    chunk = struct.pack("<I4s", len(head), JSON_CHUNK) + head
    return data[:8] + struct.pack("<I", total) + chunk + rest


def places_of(checked: Checked, nodes: list[dict[str, Any]]) -> list[Array]:
    """The matrix [4, 4] of each node to the world."""
    parent: dict[int, int] = {}
    for number, node in enumerate(nodes):
        children = node.get("children", [])
        for child in children if isinstance(children, list) else [children]:
            if not isinstance(child, int) or not 0 <= child < len(nodes) or child in parent:
                raise checked.error(f"nodes[{number}].children", kind(child), "other nodes, once")
            parent[child] = number
    local = [_local(checked, number, node) for number, node in enumerate(nodes)]
    places: dict[int, Array] = {}
    for number in range(len(nodes)):
        chain, at = [], number
        while at not in places:
            chain.append(at)
            if at not in parent:
                break
            at = parent[at]
            if at in chain:
                raise InputError(
                    f"{checked.path}: node {at} is its own ancestor, expected a tree of nodes; "
                    "export the scene again"
                )
        for one in reversed(chain):
            above = places.get(parent.get(one, -1))
            places[one] = local[one] if above is None else above @ local[one]
    return [places[number] for number in range(len(nodes))]


def _local(checked: Checked, number: int, node: dict[str, Any]) -> Array:
    where = f"nodes[{number}]"
    if "matrix" in node:
        return checked.matrix(f"{where}.matrix", node["matrix"], (16,)).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = checked.matrix(
        f"{where}.rotation", node.get("rotation", [0, 0, 0, 1]), (4,)
    ).tolist()
    matrix[:3, :3] = from_quaternion(w, x, y, z)
    matrix[:3, :3] *= checked.matrix(f"{where}.scale", node.get("scale", [1, 1, 1]), (3,))
    matrix[:3, 3] = checked.matrix(f"{where}.translation", node.get("translation", [0, 0, 0]), (3,))
    return matrix


def _values_in(text: str, at: int) -> Iterator[tuple[str | int, int, int]]:
    """The members of the object or list that begins at ``text[at]``: key, begin and end."""
    decoder = json.JSONDecoder()

    def skip(place: int) -> int:
        while text[place] in " \t\r\n":
            place += 1
        return place

    is_object = text[at] == "{"
    at, number = skip(at + 1), 0
    while text[at] not in "}]":
        key: str | int = number
        if is_object:
            key, at = decoder.raw_decode(text, at)
            at = skip(skip(at) + 1)
        _, end = decoder.raw_decode(text, at)
        yield key, at, end
        at, number = skip(end), number + 1
        if text[at] == ",":
            at = skip(at + 1)


def _member(text: str, at: int, key: str | int) -> tuple[int, int] | None:
    return next(((begin, end) for name, begin, end in _values_in(text, at) if name == key), None)


def with_bounds(text: str, bounds: dict[int, tuple[list[float], list[float]]]) -> str:
    """The JSON ``text`` of a scene with other ``min`` and ``max`` of these accessors."""
    listed = _member(text, text.index("{"), "accessors")
    assert listed is not None
    changes = []
    for number, begin, _ in _values_in(text, listed[0]):
        if number not in bounds:
            continue
        for name, values in zip(("min", "max"), bounds[int(number)], strict=True):
            if place := _member(text, begin, name):
                changes.append((*place, json.dumps(values)))
    for begin, end, new in sorted(changes, reverse=True):
        text = text[:begin] + new + text[end:]
    return text


def with_uri(text: str, number: int, encoded: str) -> str:
    listed = _member(text, text.index("{"), "buffers")
    assert listed is not None
    of_buffer = _member(text, listed[0], number)
    assert of_buffer is not None
    place = _member(text, of_buffer[0], "uri")
    assert place is not None
    return text[: place[0]] + encoded + text[place[1] :]
