"""``transforms.json`` of NeRF, Blender, nerfstudio, instant-ngp and TRELLIS.

Camera to world, OpenGL axes, pixel centres at halves. Every key of the intrinsics may stand once
for all frames or in each frame.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ...errors import InputError
from ...geometry.distortion import Distortion
from ..guard import reading
from ..reading import is_there, shown
from .own import named_file
from .record import (
    OPENGL,
    Intrinsics,
    PartialCamera,
    from_camera_to_world,
    matrix_of,
    of_horizontal_angle,
    of_pixels,
)
from .source import CameraSource

NEEDS = "frames with transform_matrix"

FILE = "transforms.json"
PARTS = "transforms_*.json"  # such as transforms_train.json
_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "OPENCV_FISHEYE", "perspective")


def recognises(source: CameraSource) -> bool:
    if source.is_folder:
        return bool(_files_in(source.path))
    document = source.json
    frames = document.get("frames") if isinstance(document, dict) else None
    return (
        isinstance(frames, list)
        and bool(frames)
        and isinstance(frames[0], dict)
        and "transform_matrix" in frames[0]
    )


def read(source: CameraSource) -> list[PartialCamera]:
    if source.is_folder:
        files = _files_in(source.path)
        if len(files) != 1:
            names = " and ".join(file.name for file in files) or "no transforms.json"
            raise InputError(f"{source.path}: holds {names}, expected one; name the file itself")
        source = CameraSource(files[0])
    with reading(source, NEEDS):
        frames = source.json["frames"]
        shared = {key: value for key, value in source.json.items() if key != "frames"}
        return [_view(source, shared | frame) for frame in source.each(frames, "frames[{}].")]


def _files_in(folder: Path) -> list[Path]:
    """transforms.json of a folder, or else the files of the parts of a data set."""
    return [folder / FILE] if is_there(folder / FILE) else sorted(folder.glob(PARTS))


def _view(source: CameraSource, values: dict[str, Any]) -> PartialCamera:
    matrix = source.pose("transform_matrix", values["transform_matrix"], (4, 4), (3, 4))
    R, t = from_camera_to_world(matrix, OPENGL)
    size = None
    if "w" in values and "h" in values:
        size = source.pixels("w, h: ", values["w"], values["h"])
    mask, image = (named_file(source, values.get(key)) for key in ("mask_path", "file_path"))
    K, distortion = _intrinsics(source, values, size), _distortion(source, values)
    return PartialCamera(source.title, K, R, t, size, distortion=distortion, mask=mask, image=image)


def _intrinsics(
    source: CameraSource, values: dict[str, Any], size: tuple[int, int] | None
) -> Intrinsics | None:
    if "fl_x" in values:
        fx = source.number("fl_x", values["fl_x"])
        fy = source.number("fl_y", values.get("fl_y", fx))
        if size is None and not {"cx", "cy"} <= values.keys():
            raise source.error("fl_x", "there", "cx and cy, or w and h, with it")
        middle = (side / 2.0 for side in size or (0, 0))
        cx, cy = (
            source.number(key, values.get(key, default))
            for key, default in zip(("cx", "cy"), middle, strict=True)
        )
        return of_pixels(matrix_of(fx, fy, cx, cy, corner=True), size)
    if "camera_angle_x" not in values:
        return None
    angle = source.number("camera_angle_x", values["camera_angle_x"])
    if not 0.0 < angle < 3.14:
        raise source.error("camera_angle_x", f"{angle:g}", "radians between 0 and pi")
    if size is not None and {"cx", "cy"} <= values.keys():
        cx, cy = (source.number(key, values[key]) for key in ("cx", "cy"))
        focal = size[0] / 2.0 / math.tan(angle / 2.0)
        return of_pixels(matrix_of(focal, focal, cx, cy, corner=True), size)
    return of_horizontal_angle(angle)


def _distortion(source: CameraSource, values: dict[str, Any]) -> Distortion | None:
    model = values.get("camera_model", "OPENCV")
    if model not in _MODELS:
        raise source.error(
            "camera_model",
            shown(model),
            f"one of {', '.join(_MODELS[:4])}; undistort the pictures: ns-process-data, or colmap "
            "image_undistorter",
        )
    fisheye = model == "OPENCV_FISHEYE" or bool(values.get("is_fisheye"))
    keys = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    if not fisheye and source.number("k4", values.get("k4", 0.0)) != 0.0:
        raise source.error("k4", values["k4"], "0; undistort the pictures")
    numbers = [source.number(key, values.get(key, 0.0)) for key in keys]
    return Distortion("equidistant" if fisheye else "radial-tangential", tuple(numbers))
