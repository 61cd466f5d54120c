"""BOP: ``scene_camera.json`` with K of each picture, ``scene_gt.json`` with poses of its objects.

Without ``scene_gt.json`` next to it, the pose of ``scene_camera.json`` itself is used, which leads
from the world to the camera (as BlenderProc writes it). Lengths are millimetres. The mask of the
object at place G of picture N is called NNNNNN_GGGGGG.png.
"""

from __future__ import annotations

import math
from typing import Any

from ...errors import InputError
from ...geometry.arrays import Array
from ..checked import kind
from ..reading import plain
from .record import PartialCamera, of_pixels
from .source import CameraSource, has_keys

MOST_LISTED = 9  # objects that a message names
CAMERAS, POSES = "scene_camera.json", "scene_gt.json"


def recognises(source: CameraSource) -> bool:
    if source.is_folder:
        return (source.path / CAMERAS).is_file()
    document = source.json
    first = next(iter(document.values()), None) if isinstance(document, dict) else None
    return (isinstance(first, dict) and "cam_K" in first) or _is_poses(first)


def _is_poses(first: Any) -> bool:
    """Whether ``first`` is the first value of a ``scene_gt.json``."""
    return isinstance(first, list) and bool(first) and has_keys(first[0], {"cam_R_m2c", "obj_id"})


def read(source: CameraSource, object_id: int | None = None) -> list[PartialCamera]:
    if source.is_folder:
        source = CameraSource(source.path / CAMERAS)
    if isinstance(source.json, dict) and _is_poses(next(iter(source.json.values()), None)):
        raise InputError(
            f"{source.path}: holds the poses of objects without K, expected {CAMERAS} or its folder"
        )
    poses_file = source.path.with_name(POSES)
    poses = CameraSource(poses_file) if poses_file.is_file() else None
    if poses is None and object_id is not None:
        raise InputError(f"{poses_file}: does not exist, expected it for `object` {object_id}")
    if not isinstance(source.json, dict):
        raise source.error(
            "the document", kind(source.json), "an object with cam_K of each picture"
        )
    chosen = object_id if poses is None or object_id is not None else _only_object(poses)
    views = []
    for number, values in source.json.items():
        where = plain(number)
        if not isinstance(values, dict) or "cam_K" not in values:
            raise source.error(where, kind(values), "an object with cam_K")
        K = source.matrix(f"{where}.cam_K", values["cam_K"], (9,), (3, 3)).reshape(3, 3)
        padded = f"{int(number):06d}" if number.isdecimal() and len(number) < 10 else number
        if poses is None:
            R = t = None
            if "cam_R_w2c" in values:
                R, t = _pose(source, where, values, "cam_R_w2c", "cam_t_w2c")
            views.append(
                PartialCamera(f"picture {number}", of_pixels(K, None), R, t, names=(padded,))
            )
            continue
        for place, entry in enumerate(_entries(poses, number)):
            if entry.get("obj_id") != chosen:
                continue
            R, t = _pose(poses, where, entry, "cam_R_m2c", "cam_t_m2c")
            # The mask names picture and place; a picture with one such object names it too.
            names = (f"{padded}_{place:06d}", padded)
            views.append(PartialCamera(f"picture {number}", of_pixels(K, None), R, t, names=names))
    if not views and poses is not None:
        listed = _listed(_objects(poses))
        raise InputError(
            f"{poses_file}: no picture shows object {object_id}, expected one of {listed}: "
            "`object` ID"
        )
    return views


def _entries(poses: CameraSource, number: str) -> list[dict[str, Any]]:
    entries = poses.json.get(number, []) if isinstance(poses.json, dict) else None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise poses.error(plain(number), kind(entries), "a list of poses")
    return entries


def _objects(poses: CameraSource) -> list[Any]:
    """The objects of a scene, in the order of their numbers."""
    if not isinstance(poses.json, dict):
        raise poses.error("the document", kind(poses.json), "the poses of each picture")
    found = {
        str(entry.get("obj_id")): entry.get("obj_id")
        for number in poses.json
        for entry in _entries(poses, number)
    }
    return sorted(found.values(), key=lambda one: one if isinstance(one, int) else math.inf)


def _listed(objects: list[Any]) -> str:
    names = [plain(str(one)) for one in objects[:MOST_LISTED]]
    return ", ".join(names) + (", ..." if len(objects) > MOST_LISTED else "") or "none"


def _only_object(poses: CameraSource) -> Any:
    """The object of a scene that has only one."""
    found = _objects(poses)
    if len(found) != 1:
        raise InputError(
            f"{poses.path}: holds the objects {_listed(found)}, expected one; choose it: "
            "`object` ID"
        )
    return found[0]


def _pose(
    source: CameraSource, where: str, values: dict[str, Any], rotation: str, translation: str
) -> tuple[Array, Array]:
    for key in (rotation, translation):
        if key not in values:
            raise InputError(f"{source.path}: {where}.{key} is missing, expected it")
    R = source.matrix(f"{where}.{rotation}", values[rotation], (9,), (3, 3)).reshape(3, 3)
    return R, source.matrix(f"{where}.{translation}", values[translation], (3,))
