"""Open3D: ``PinholeCameraParameters``, ``PinholeCameraTrajectory`` and the trajectory log.

The JSON files store world-to-camera matrices by columns. The log stores camera-to-world matrices by
rows, and no intrinsics.
"""

from __future__ import annotations

from typing import Any

from .record import PartialCamera, from_camera_to_world, from_world_to_camera, of_pixels
from .source import CameraSource

NEEDS = "intrinsic_matrix, width, height and extrinsic, or a log of 4x4 poses"

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
    document = source.json
    if document["class_name"] == "PinholeCameraTrajectory":
        return [
            _view(source, camera)
            for camera in source.each(document["parameters"], "parameters[{}].")
        ]
    if document["class_name"] == "PinholeCameraIntrinsic":
        document = {"intrinsic": document}
    return [_view(source, document)]


def _view(source: CameraSource, values: dict[str, Any]) -> PartialCamera:
    intrinsic = values["intrinsic"]
    K = source.matrix("intrinsic_matrix", intrinsic["intrinsic_matrix"], (9,)).reshape(3, 3).T
    size = source.pixels("", intrinsic["width"], intrinsic["height"])
    R = t = None
    if "extrinsic" in values:
        columns = source.matrix("extrinsic", values["extrinsic"], (16,))
        R, t = from_world_to_camera(source.pose("extrinsic", columns.reshape(4, 4).T))
    return PartialCamera(source.title, of_pixels(K, size), R, t, size)


def _log(source: CameraSource) -> list[PartialCamera]:
    frames = [source.words[i + 1 : i + _ROWS] for i in range(0, len(source.words), _ROWS)]
    views = []
    for frame in source.each(frames, "frame {}: "):
        matrix = [[float(word) for word in words] for words in frame]
        R, t = from_camera_to_world(source.pose("the pose", matrix))
        views.append(PartialCamera(source.title, None, R, t))
    return views
