"""The cameras of a glTF or GLB scene, at the places of their nodes.

A camera of glTF looks along its -z axis with y up. Its field of view is vertical.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from ...errors import InputError
from ...geometry.arrays import Array
from ...geometry.rotations import from_quaternion
from ..output import reason
from .record import OPENGL, PartialCamera, from_camera_to_world, of_vertical_angle
from .source import CameraSource, kind

MOST_NODES = 100_000


def recognises(source: CameraSource) -> bool:
    if source.data[:4] == b"glTF":
        return True
    document = source.json
    return isinstance(document, dict) and "asset" in document and "nodes" in document


def read(source: CameraSource) -> list[PartialCamera]:
    document = _scene(source)
    nodes, cameras = (_list(source, document, key) for key in ("nodes", "cameras"))
    if not cameras:
        raise InputError(f"{source.path}: is a scene without a camera, expected one; export it too")
    views = []
    for number, matrix in _places(source, nodes).items():
        node = nodes[number]
        index = node.get("camera")
        if index is None:
            continue
        if not isinstance(index, int) or not 0 <= index < len(cameras):
            raise source.error(f"nodes[{number}].camera", kind(index), "the index of a camera")
        camera = cameras[index]
        name = str(node.get("name") or camera.get("name") or f"camera {index}")
        lens = camera.get("perspective")
        if not isinstance(lens, dict):
            raise InputError(
                f"{source.path}: the camera {name} is not perspective, which tso does not read "
                "from glTF; write K, R and t instead"
            )
        angle = source.number(f"cameras[{index}].perspective.yfov", lens.get("yfov"))
        if not 0.0 < angle < 3.14:
            raise source.error(f"{name}: yfov", f"{angle:g}", "radians between 0 and pi")
        # A scale of the node has no meaning for a camera.
        axes = matrix[:3, :3] / np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-300)
        R, t = from_camera_to_world(np.c_[axes, matrix[:3, 3]], OPENGL)
        views.append(PartialCamera(name, of_vertical_angle(angle), R, t, names=(name,)))
    return views


def _scene(source: CameraSource) -> dict[str, Any]:
    data = source.data
    if data[:4] != b"glTF":
        document = source.json
    else:
        try:
            length, form = struct.unpack_from("<I4s", data, 12)
            if form != b"JSON":
                raise ValueError("its first part is not JSON")
            document = json.loads(data[20 : 20 + length])
        except (struct.error, ValueError, RecursionError) as error:
            raise InputError(f"{source.path}: is a damaged GLB ({reason(error)})") from None
    if not isinstance(document, dict):
        raise source.error("the scene", kind(document), "an object")
    return document


def _list(source: CameraSource, document: dict[str, Any], key: str) -> list[dict[str, Any]]:
    values = document.get(key, [])
    if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
        raise source.error(key, kind(values), "a list of objects")
    if len(values) > MOST_NODES:
        raise source.error(key, f"a list of {len(values):,}", f"at most {MOST_NODES:,}")
    return values


def _places(source: CameraSource, nodes: list[dict[str, Any]]) -> dict[int, Array]:
    """Node -> its matrix to the world [4, 4]; nodes in the order of the file."""
    parent: dict[int, int] = {}
    for number, node in enumerate(nodes):
        for child in node.get("children", []):
            if not isinstance(child, int) or not 0 <= child < len(nodes) or child in parent:
                raise source.error(f"nodes[{number}].children", kind(child), "other nodes, once")
            parent[child] = number
    places = {}
    for number in range(len(nodes)):
        matrix, at, steps = np.eye(4), number, 0
        while True:
            matrix = _local(source, at, nodes[at]) @ matrix
            if at not in parent:
                break
            at, steps = parent[at], steps + 1
            if steps > len(nodes):
                raise source.error("nodes", "a circle", "a tree")
        places[number] = matrix
    return places


def _local(source: CameraSource, number: int, node: dict[str, Any]) -> Array:
    where = f"nodes[{number}]"
    if "matrix" in node:
        return source.matrix(f"{where}.matrix", node["matrix"], (16,)).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = source.matrix(
        f"{where}.rotation", node.get("rotation", [0, 0, 0, 1]), (4,)
    ).tolist()
    matrix[:3, :3] = from_quaternion(w, x, y, z)
    matrix[:3, :3] *= source.matrix(f"{where}.scale", node.get("scale", [1, 1, 1]), (3,))
    matrix[:3, 3] = source.matrix(f"{where}.translation", node.get("translation", [0, 0, 0]), (3,))
    return matrix
