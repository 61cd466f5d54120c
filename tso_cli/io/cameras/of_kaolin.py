"""kaolin's camera as JSON: OpenGL axes, the principal point relative to the middle."""

from __future__ import annotations

from ...errors import InputError
from .record import OPENGL, PartialCamera, from_world_to_camera, matrix_of, of_pixels
from .source import CameraSource

NEEDS = "extrinsics, intrinsics.focal_x, width and height"


def recognises(source: CameraSource) -> bool:
    document = source.json
    inner = document.get("intrinsics") if isinstance(document, dict) else None
    return isinstance(inner, dict) and "focal_x" in inner and "extrinsics" in document


def read(source: CameraSource) -> list[PartialCamera]:
    document = source.json
    inner = document["intrinsics"]
    size = source.pixels("", document["width"], document["height"])
    fx = source.number("intrinsics.focal_x", inner["focal_x"])
    fy = source.number("intrinsics.focal_y", inner.get("focal_y", fx))
    for key in ("x0", "y0"):
        if source.number(f"intrinsics.{key}", inner.get(key, 0.0)) != 0.0:
            raise InputError(
                f"{source.path}: intrinsics.{key} is {inner[key]:g}, expected 0: the principal "
                "point in the middle; write K, R and t instead"
            )
    matrix = source.pose("extrinsics", document["extrinsics"], (4, 4), (1, 4, 4))
    R, t = from_world_to_camera(matrix, OPENGL)
    K = matrix_of(fx, fy, size[0] / 2.0, size[1] / 2.0, corner=True)
    return [PartialCamera("", of_pixels(K, size), R, t, size)]
