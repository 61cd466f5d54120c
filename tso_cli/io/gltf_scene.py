"""The JSON of a glTF or GLB scene: its nodes and their places."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array
from ..geometry.rotations import from_quaternion
from .checked import Checked, kind
from .output import reason
from .reading import json_reason

T = TypeVar("T")
MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"
MOST_NODES = 100_000
WHOLE_SCENE = "a scene as glTF 2.0 has it; export it again"
COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# What a reader takes of a node's own copy of a mesh, in bytes.
_BYTES_PER_VERTEX, _BYTES_PER_CORNER = 100, 60
# The most that all copies may take. A scene without copies takes under 64 for each of its bytes.
_MOST_OF_COPIES, _MOST_PER_BYTE = 1 << 30, 64
_GLOSS = "KHR_materials_pbrSpecularGlossiness"


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


def entry(values: Sequence[T], index: Any) -> T:
    """The value that a scene names by its ``index``; a ValueError without one."""
    if type(index) is not int or not 0 <= index < len(values):
        raise ValueError(f"{kind(index)} where an index belongs, under {len(values)}")
    return values[index]


def whole(value: Any) -> int:
    """``value`` if it is a whole number, 0 or more, of a file; a ValueError otherwise."""
    if type(value) is not int or not 0 <= value < 1 << 48:
        raise ValueError(f"{kind(value)} where a whole number belongs, 0 or more, under 2^48")
    return value


def memory_of(checked: Checked, document: dict[str, Any], stored_bytes: int) -> int:
    """About how many bytes the meshes of a scene take; each node has its own copy.

    A few bytes of a file can stand for many: an accessor need not hold its values, and many nodes
    can show one mesh. Raises InputError if the ``stored_bytes`` of the buffers stand for too many.
    """
    counts, stored = [], 0
    for number, accessor in enumerate(document.get("accessors", [])):
        checked.place = f"accessors[{number}]."
        counts.append(whole(accessor.get("count", 0)))
        # Other types are an error of the reader.
        size = np.dtype(COMPONENTS.get(accessor["componentType"], "i1")).itemsize
        stored += counts[-1] * WIDTHS.get(accessor["type"], 0) * size
    meshes = []
    for number, mesh in enumerate(document.get("meshes", [])):
        checked.place = f"meshes[{number}]."
        meshes.append(0)
        for primitive in mesh["primitives"]:
            vertices = entry(counts, primitive["attributes"]["POSITION"])
            corners = entry(counts, primitive.get("indices", primitive["attributes"]["POSITION"]))
            meshes[-1] += _BYTES_PER_VERTEX * vertices + _BYTES_PER_CORNER * corners
    for number, node in enumerate(document.get("nodes", [])):
        checked.place = f"nodes[{number}]."
        stored += entry(meshes, node["mesh"]) if "mesh" in node else 0
    checked.place = ""
    if stored > (most := max(_MOST_OF_COPIES, _MOST_PER_BYTE * stored_bytes)):
        raise InputError(
            f"{checked.path}: its accessors, nodes and primitives stand for about "
            f"{stored / 2**30:.3g} GiB, expected at most {most / 2**30:.3g} for its size"
        )
    return stored


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
    stated_length = struct.unpack_from("<I", data, 8)[0]
    total = max(20 + len(head) + len(rest) - max(len(data) - stated_length, 0), 0)
    chunk = struct.pack("<I4s", len(head), JSON_CHUNK) + head
    return data[:8] + struct.pack("<I", total) + chunk + rest


def places_of(checked: Checked, nodes: list[dict[str, Any]]) -> list[Array]:
    """The matrix [4, 4] of each node to the world."""
    parent: dict[int, int] = {}
    for number, node in enumerate(nodes):
        checked.place = f"nodes[{number}]."
        for child in node.get("children", []):
            if type(child) is not int or not 0 <= child < len(nodes) or child in parent:
                raise checked.error("children", kind(child), "other nodes, once")
            parent[child] = number
    checked.place = ""
    local = [_local(checked, number, node) for number, node in enumerate(nodes)]
    places: dict[int, Array] = {}
    for number in range(len(nodes)):
        chain: dict[int, None] = {}  # in this order
        at = number
        while at not in places:
            chain[at] = None
            if at not in parent:
                break
            at = parent[at]
            if at in chain:
                raise InputError(
                    f"{checked.path}: node {at} is its own ancestor, expected a tree of nodes; "
                    "export the scene again"
                )
        for node_number in reversed(chain):
            above = places.get(parent.get(node_number, -1))
            places[node_number] = (
                local[node_number] if above is None else above @ local[node_number]
            )
    return [places[number] for number in range(len(nodes))]


def _local(checked: Checked, number: int, node: dict[str, Any]) -> Array:
    where = f"nodes[{number}]"
    if "matrix" in node:
        return checked.matrix(f"{where}.matrix", node["matrix"], (16,)).reshape(4, 4).T
    matrix = np.eye(4)
    if "rotation" in node:
        x, y, z, w = checked.matrix(f"{where}.rotation", node["rotation"], (4,)).tolist()
        matrix[:3, :3] = from_quaternion(w, x, y, z)
    if "scale" in node:
        matrix[:3, :3] *= checked.matrix(f"{where}.scale", node["scale"], (3,))
    if "translation" in node:
        matrix[:3, 3] = checked.matrix(f"{where}.translation", node["translation"], (3,))
    return matrix
