"""Open3D: ``PinholeCameraParameters``, ``PinholeCameraTrajectory`` and the trajectory log.

The JSON files store world-to-camera matrices by columns. The log stores camera-to-world matrices by
rows, and no intrinsics.
"""

from __future__ import annotations

from typing import Any

from ...errors import InputError
from ..checked import kind
from .record import PartialCamera, from_camera_to_world, from_world_to_camera, of_pixels
from .source import CameraSource

_CLASSES = ("PinholeCameraParameters", "PinholeCameraTrajectory", "PinholeCameraIntrinsic")
_ROWS = 5  # of the log: numbers of the frame, and a matrix


def recognises(source: CameraSource) -> bool:
    if source.looks_like_json:
        return isinstance(source.json, dict) and source.json.get("class_name") in _CLASSES
    counts = [len(words) for words in source.words[:_ROWS]]
    return counts == [3, 4, 4, 4, 4]


def read(source: CameraSource) -> list[PartialCamera]:
    if not source.looks_like_json:
        return _log(source)
    document = source.json if isinstance(source.json, dict) else {}
    if document.get("class_name") == "PinholeCameraTrajectory":
        parameters = document.get("parameters")
        if not isinstance(parameters, list):
            raise source.error("parameters", kind(parameters), "a list of cameras")
        return [_view(source, f"parameters[{i}]", one) for i, one in enumerate(parameters)]
    if document.get("class_name") == "PinholeCameraIntrinsic":
        document = {"intrinsic": document}
    return [_view(source, "", document)]


def _view(source: CameraSource, where: str, values: Any) -> PartialCamera:
    intrinsic = values.get("intrinsic") if isinstance(values, dict) else None
    if not isinstance(intrinsic, dict):
        raise source.error(where or "the document", kind(values), "an object with intrinsic")
    prefix = f"{where}." if where else ""
    K = source.matrix(f"{prefix}intrinsic_matrix", intrinsic.get("intrinsic_matrix"), (9,))
    size = source.pixels(prefix, intrinsic.get("width"), intrinsic.get("height"))
    R = t = None
    if "extrinsic" in values:
        columns = source.matrix(f"{prefix}extrinsic", values["extrinsic"], (16,))
        R, t = from_world_to_camera(source.pose(f"{prefix}extrinsic", columns.reshape(4, 4).T))
    return PartialCamera(where, of_pixels(K.reshape(3, 3).T, size), R, t, size)


def _log(source: CameraSource) -> list[PartialCamera]:
    rows = source.words
    if len(rows) % _ROWS:
        raise InputError(
            f"{source.path}: has {len(rows)} lines, expected {_ROWS} for each frame of a "
            "trajectory log"
        )
    views = []
    for frame, start in enumerate(range(0, len(rows), _ROWS)):
        where = f"frame {frame}"
        try:
            numbers = [[float(word) for word in words] for words in rows[start + 1 : start + _ROWS]]
        except ValueError:
            raise source.error(where, "not a matrix of numbers", "4x4 numbers") from None
        R, t = from_camera_to_world(source.pose(where, numbers))
        views.append(PartialCamera(where, None, R, t))
    return views
