"""``cameras.json`` of 3D Gaussian splatting: a list; rotation and position are camera to world.

The principal point is the middle of the picture.
"""

from __future__ import annotations

import numpy as np

from ..checked import kind
from .own import named_file
from .record import PartialCamera, from_camera_to_world, matrix_of, of_pixels
from .source import CameraSource

_KEYS = {"rotation", "position", "fx", "fy", "width", "height"}


def recognises(source: CameraSource) -> bool:
    document = source.json
    return isinstance(document, list) and bool(document) and _is_camera(document[0])


def _is_camera(entry: object) -> bool:
    return isinstance(entry, dict) and entry.keys() >= _KEYS


def read(source: CameraSource) -> list[PartialCamera]:
    document = source.json if isinstance(source.json, list) else [source.json]
    views = []
    for number, entry in enumerate(document):
        where = f"[{number}]"
        if not _is_camera(entry):
            raise source.error(where, kind(entry), f"an object with {', '.join(sorted(_KEYS))}")
        size = source.pixels(f"{where}.", entry["width"], entry["height"])
        fx, fy = (source.number(f"{where}.{key}", entry[key]) for key in ("fx", "fy"))
        rotation = source.matrix(f"{where}.rotation", entry["rotation"], (3, 3))
        position = source.matrix(f"{where}.position", entry["position"], (3,))
        R, t = from_camera_to_world(np.c_[rotation, position])
        K = matrix_of(fx, fy, size[0] / 2.0, size[1] / 2.0, corner=True)
        image = named_file(source, entry.get("img_name"))
        views.append(PartialCamera(where, of_pixels(K, size), R, t, size, image=image))
    return views
