"""Poses of ARKit: JSON of Polycam, 3D Scanner App and Record3D, and of a frame of ARKit itself.

Camera to world. The camera has x right, y up and z backward; pixels are counted from the corner of
the picture. A folder of Polycam or 3D Scanner App has a file for each picture.
"""

from __future__ import annotations

import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...geometry.arrays import Array
from ..guard import reading
from ..reading import is_there
from .record import OPENGL, PartialCamera, from_camera_to_world, matrix_of, of_pixels
from .source import CameraSource, has_keys

NEEDS = "camera poses of ARKit with their intrinsics"

_POLYCAM = {f"t_{row}{column}" for row in range(3) for column in range(4)}
_RECORD3D = {"poses", "K", "w", "h"}
_KEYS = (
    _POLYCAM, _RECORD3D, {"cameraPoseARFrame", "intrinsics"},
    {"transform", "intrinsics", "imageResolution"},
)  # fmt: skip
# Where the files of a recording are; Polycam has corrected some cameras.
_PLACES = (
    "frame_*.json", "metadata", "metadata.json", "*.json", "keyframes/corrected_cameras/*.json",
    "keyframes/cameras/*.json",
)  # fmt: skip
# Of Polycam, in the folder of the recording.
_MESH, _ALIGNMENT = "mesh_info.json", "alignmentTransform"


def recognises(source: CameraSource) -> bool:
    if source.is_folder:
        return bool(_files_in(source.path))
    return any(has_keys(source.json, keys) for keys in _KEYS)


def _files_in(folder: Path) -> list[Path]:
    for place in _PLACES:
        files = sorted(filter(is_there, folder.glob(place)))
        with suppress(InputError):  # a file that nobody named may be anything
            if files and recognises(CameraSource(files[0])):
                return files
    return []


def read(source: CameraSource) -> list[PartialCamera]:
    files = _files_in(source.path) if source.is_folder else [source.path]
    to_mesh = _to_mesh(files[0])
    return [view for file in files for view in _views(CameraSource(file), to_mesh)]


def _views(source: CameraSource, to_mesh: Array) -> list[PartialCamera]:
    with reading(source, NEEDS):
        document, name, size = source.json, source.path.stem, None
        if has_keys(document, _RECORD3D):
            return _of_record3d(source, document)
        if has_keys(document, _POLYCAM):
            rows = [[document[f"t_{i}{j}"] for j in range(4)] for i in range(3)]
            pose = to_mesh @ source.pose("t_00 to t_23", rows, (3, 4))
            numbers = [source.number(key, document[key]) for key in ("fx", "fy", "cx", "cy")]
            size = source.pixels("", document["width"], document["height"])
            return [_view(name, numbers, pose, size)]
        K = source.matrix("intrinsics", document["intrinsics"], (9,), (3, 3)).reshape(3, 3)
        key = "transform" if "transform" in document else "cameraPoseARFrame"
        matrix = source.matrix(key, document[key], (16,), (4, 4)).reshape(4, 4)
        if K[2, :2].any():  # both are by columns
            K, matrix = K.T, matrix.T
        if "imageResolution" in document:
            size = source.pixels("imageResolution: ", *document["imageResolution"])
        return [_view(name, _numbers(K), source.pose(key, matrix), size)]


def _numbers(K: Array) -> list[float]:
    """fx, fy, cx and cy."""
    return [float(value) for value in K[[0, 1, 0, 1], [0, 1, 2, 2]]]


def _view(
    name: str, numbers: list[float], pose: Array | None, size: tuple[int, int] | None
) -> PartialCamera:
    """The view of the picture ``name``, whose fx, fy, cx and cy are the ``numbers``."""
    R, t = (None, None) if pose is None else from_camera_to_world(pose, OPENGL)
    K = of_pixels(matrix_of(*numbers, corner=True), size)
    return PartialCamera(name, K, R, t, size, names=(name,))


def _of_record3d(source: CameraSource, document: dict[str, Any]) -> list[PartialCamera]:
    """A pose is a quaternion x, y, z, w and a position."""
    size = source.pixels("", document["w"], document["h"])
    shared = _numbers(source.matrix("K", document["K"], (9,)).reshape(3, 3).T)
    of_pictures = document.get("perFrameIntrinsicCoeffs") or []
    views = []
    for number, values in enumerate(source.each(document["poses"], "poses[{}]")):
        x, y, z, w, *position = source.matrix("", values, (7,)).tolist()
        pose = np.c_[source.quaternion("", [w, x, y, z]), position]
        K = of_pictures[number] if of_pictures else shared
        K = source.matrix(": perFrameIntrinsicCoeffs", K, (4,)).tolist()
        views.append(_view(str(number), K, pose, size))
    return views or [_view("", shared, None, size)]


def _to_mesh(path: Path) -> Array:
    """From the frame of Polycam's poses to that of its raw.glb; 1 where nothing says it."""
    file = next(filter(is_there, (folder / _MESH for folder in path.absolute().parents[:3])), None)
    source = None if file is None else CameraSource(file)
    if source is None or not has_keys(source.json, {_ALIGNMENT}):
        return np.eye(4)
    warnings.warn(
        f"{file}: the cloud is taken to be in the frame of raw.glb; without this file it is taken "
        "to be in the frame of the poses",
        stacklevel=2,
    )
    columns = source.matrix(_ALIGNMENT, source.json[_ALIGNMENT], (16,))
    return source.pose(_ALIGNMENT, columns.reshape(4, 4).T)
