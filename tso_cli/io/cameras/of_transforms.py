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
from ..checked import kind
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
    document = source.json
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list):
        raise source.error("frames", kind(frames), "a list of frames with transform_matrix")
    shared = {key: value for key, value in document.items() if key != "frames"}
    return [_view(source, f"frames[{i}]", shared, frame) for i, frame in enumerate(frames)]


def _files_in(folder: Path) -> list[Path]:
    """transforms.json of a folder, or else the files of the parts of a data set."""
    return [folder / FILE] if is_there(folder / FILE) else sorted(folder.glob(PARTS))


def _view(source: CameraSource, where: str, shared: dict[str, Any], frame: Any) -> PartialCamera:
    if not isinstance(frame, dict) or "transform_matrix" not in frame:
        raise source.error(where, kind(frame), "an object with transform_matrix")
    values = shared | frame
    matrix = source.pose(f"{where}.transform_matrix", values["transform_matrix"], (4, 4), (3, 4))
    R, t = from_camera_to_world(matrix, OPENGL)
    size = None
    if "w" in values and "h" in values:
        size = source.pixels(f"{where}: w, h: ", values["w"], values["h"])
    mask, image = (named_file(source, values.get(key)) for key in ("mask_path", "file_path"))
    return PartialCamera(
        where,
        _intrinsics(source, where, values, size),
        R,
        t,
        size,
        distortion=_distortion(source, where, values),
        mask=mask,
        image=image,
    )


def _intrinsics(
    source: CameraSource, where: str, values: dict[str, Any], size: tuple[int, int] | None
) -> Intrinsics | None:
    if "fl_x" in values:
        fx = source.number(f"{where}: fl_x", values["fl_x"])
        fy = source.number(f"{where}: fl_y", values.get("fl_y", fx))
        if size is None and not {"cx", "cy"} <= values.keys():
            raise InputError(f"{source.path}: {where} has fl_x, expected cx and cy, or w and h")
        middle = (side / 2.0 for side in size or (0, 0))
        cx, cy = (
            source.number(f"{where}: {key}", values.get(key, default))
            for key, default in zip(("cx", "cy"), middle, strict=True)
        )
        return of_pixels(matrix_of(fx, fy, cx, cy, corner=True), size)
    if "camera_angle_x" not in values:
        return None
    angle = source.number(f"{where}: camera_angle_x", values["camera_angle_x"])
    if not 0.0 < angle < 3.14:
        raise source.error(f"{where}: camera_angle_x", f"{angle:g}", "radians between 0 and pi")
    if size is not None and {"cx", "cy"} <= values.keys():
        cx, cy = (source.number(f"{where}: {key}", values[key]) for key in ("cx", "cy"))
        focal = size[0] / 2.0 / math.tan(angle / 2.0)
        return of_pixels(matrix_of(focal, focal, cx, cy, corner=True), size)
    return of_horizontal_angle(angle)


def _distortion(source: CameraSource, where: str, values: dict[str, Any]) -> Distortion | None:
    model = values.get("camera_model", "OPENCV")
    if model not in _MODELS:
        raise InputError(
            f"{source.path}: {where}: camera_model is {shown(model)}, expected one of "
            f"{', '.join(_MODELS[:4])}; undistort the pictures: ns-process-data, or colmap "
            "image_undistorter"
        )
    fisheye = model == "OPENCV_FISHEYE" or bool(values.get("is_fisheye"))
    keys = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    if not fisheye and source.number(f"{where}: k4", values.get("k4", 0.0)) != 0.0:
        raise InputError(
            f"{source.path}: {where}: k4 is {values['k4']}, expected 0; undistort the pictures"
        )
    numbers = [source.number(f"{where}: {key}", values.get(key, 0.0)) for key in keys]
    return Distortion("equidistant" if fisheye else "radial-tangential", tuple(numbers))
