"""``cameras.json`` of 3D Gaussian splatting: a list; rotation and position are camera to world.

The principal point is the middle of the picture.
"""

from __future__ import annotations

import numpy as np

from .own import named_file
from .record import PartialCamera, from_camera_to_world, matrix_of, of_pixels
from .source import CameraSource, has_keys

NEEDS = "rotation, position, fx, fy, width and height of each camera"

_KEYS = {"rotation", "position", "fx", "fy", "width", "height"}


def recognises(source: CameraSource) -> bool:
    document = source.json
    return isinstance(document, list) and bool(document) and has_keys(document[0], _KEYS)


def read(source: CameraSource) -> list[PartialCamera]:
    views = []
    for entry in source.each(source.objects, "[{}]."):
        size = source.pixels("", entry["width"], entry["height"])
        fx, fy = (source.number(key, entry[key]) for key in ("fx", "fy"))
        rotation = source.matrix("rotation", entry["rotation"], (3, 3))
        position = source.matrix("position", entry["position"], (3,))
        R, t = from_camera_to_world(np.c_[rotation, position])
        K = matrix_of(fx, fy, size[0] / 2.0, size[1] / 2.0, corner=True)
        image = named_file(source, entry.get("img_name"))
        views.append(PartialCamera(source.title, of_pixels(K, size), R, t, size, image=image))
    return views
