"""The cameras of a glTF or GLB scene, at the places of their nodes.

A camera of glTF looks along its -z axis with y up. Its field of view is vertical.
"""

from __future__ import annotations

import numpy as np

from ...errors import InputError
from ..gltf_scene import MAGIC, document_of, entry, objects_of, places_of, scene_text
from .record import OPENGL, PartialCamera, from_camera_to_world, of_vertical_angle
from .source import CameraSource

NEEDS = "nodes with a perspective camera"


def recognises(source: CameraSource) -> bool:
    if source.data[:4] == MAGIC:
        return True
    document = source.json
    return isinstance(document, dict) and "asset" in document and "nodes" in document


def read(source: CameraSource) -> list[PartialCamera]:
    document = document_of(scene_text(source.data, source.path)[0], source.path)
    nodes, cameras = (objects_of(source, document, key) for key in ("nodes", "cameras"))
    if not cameras:
        raise InputError(f"{source.path}: is a scene without a camera, expected one; export it too")
    views = []
    for number, matrix in enumerate(places_of(source, nodes)):
        node = nodes[number]
        index = node.get("camera")
        if index is None:
            continue
        source.place = f"nodes[{number}]."
        camera = entry(cameras, index)
        source.place = ""
        name = str(node.get("name") or camera.get("name") or f"camera {index}")
        lens = camera.get("perspective")
        if not isinstance(lens, dict):
            raise InputError(
                f"{source.path}: the camera {name} is not perspective, which tso does not read "
                "from glTF; write K, R and t instead"
            )
        source.place = f"cameras[{index}].perspective."
        angle = source.number("yfov", lens["yfov"])
        source.place = ""
        if not 0.0 < angle < 3.14:
            raise source.error(f"{name}: yfov", f"{angle:g}", "radians between 0 and pi")
        # A scale of the node has no meaning for a camera.
        axes = matrix[:3, :3] / np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-300)
        R, t = from_camera_to_world(np.c_[axes, matrix[:3, 3]], OPENGL)
        views.append(PartialCamera(name, of_vertical_angle(angle), R, t, names=(name,)))
    return views
