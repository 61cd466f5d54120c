"""A table of RealityCapture: the export "Internal/External camera parameters".

Poses lead from camera to world, whose z is up; the camera has x right, y up and z backward. f, px
and py are in mm of a picture whose longer side is 36 mm; px and py lead from its middle.
"""

from __future__ import annotations

import numpy as np

from ...geometry.arrays import Array
from ...geometry.distortion import Distortion
from ...geometry.rotations import from_vectors
from .own import relative_to
from .record import OPENGL, PartialCamera, from_camera_to_world, matrix_of
from .source import CameraSource

NEEDS = "#name, x, y, alt, heading, pitch, roll, f, px and py of each picture"

_FILM = 36.0
_KEYS = {"#name", "x", "y", "alt", "heading", "pitch", "roll", "f", "px", "py"}


def recognises(source: CameraSource) -> bool:
    return {*source.columns} >= _KEYS


def read(source: CameraSource) -> list[PartialCamera]:
    return [_view(source, row.pop("#name"), row) for row in source.table]


def _view(source: CameraSource, name: str, row: dict[str, str]) -> PartialCamera:
    number = {key: source.number(key, float(value)) for key, value in row.items()}
    for key in ("k4", "t1", "t2"):
        if number.get(key):
            raise source.error(key, f"{number[key]:g}", "0; export undistorted pictures")
    k1, k2, k3 = (number.get(key, 0.0) for key in ("k1", "k2", "k3"))
    heading, pitch, roll = np.radians([number[key] for key in ("heading", "pitch", "roll")])
    about_x, about_y, about_z = from_vectors(np.diag([pitch, roll, -heading]))
    to_world = about_z @ about_x @ about_y
    R, t = from_camera_to_world(np.c_[to_world, [number[key] for key in ("x", "y", "alt")]], OPENGL)

    def in_pixels(width: int, height: int) -> Array:
        f, px, py = (number[key] * max(width, height) / _FILM for key in ("f", "px", "py"))
        return matrix_of(f, f, width / 2.0 + px, height / 2.0 + py, corner=True)

    lens = Distortion("radial-tangential", (k1, k2, 0.0, 0.0, k3))
    image = relative_to(source.path, name)
    return PartialCamera(source.title, in_pixels, R, t, distortion=lens, image=image)
