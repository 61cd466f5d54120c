"""Annotations of Pix3D: one object, or the list of ``pix3d.json``.

``rot_mat x + trans_mat`` has x to the left, y up and z into the picture. ``focal_length`` is in mm
of a sensor that is 32 mm wide, and the principal point is the middle of the picture.
"""

from __future__ import annotations

import numpy as np

from .own import named_file
from .record import PYTORCH3D, PartialCamera, from_world_to_camera, of_widths
from .source import CameraSource, has_keys

NEEDS = "rot_mat, trans_mat, focal_length and img_size"

SENSOR_WIDTH = 32.0  # mm
_KEYS = {"rot_mat", "trans_mat", "focal_length", "img_size"}


def recognises(source: CameraSource) -> bool:
    document = source.json
    first = document[0] if isinstance(document, list) and document else document
    return has_keys(first, _KEYS)


def read(source: CameraSource) -> list[PartialCamera]:
    views = []
    for entry in source.each(source.objects, "entry {}: "):
        focal = source.number("focal_length", entry["focal_length"])
        if focal <= 0.0:
            raise source.error("focal_length", f"{focal:g}", "more than 0 (mm)")
        rotation = source.matrix("rot_mat", entry["rot_mat"], (3, 3))
        translation = source.matrix("trans_mat", entry["trans_mat"], (3,))
        width, height = source.matrix("img_size", entry["img_size"], (2,))
        R, t = from_world_to_camera(np.c_[rotation, translation], PYTORCH3D)
        mask, image = (named_file(source, entry.get(key)) for key in ("mask", "img"))
        size = source.pixels("img_size: ", width, height)
        K = of_widths(focal / SENSOR_WIDTH)
        views.append(PartialCamera(source.title, K, R, t, size, mask=mask, image=image))
    return views
