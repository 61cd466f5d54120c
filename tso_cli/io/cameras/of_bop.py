"""BOP: ``scene_camera.json`` with K of each picture, ``scene_gt.json`` with poses of its objects.

Without ``scene_gt.json`` next to it, the pose of ``scene_camera.json`` itself is used, which leads
from the world to the camera (as BlenderProc writes it). Lengths are millimetres. The mask of the
object at place G of picture N is called NNNNNN_GGGGGG.png.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from ...errors import InputError
from ...geometry.arrays import Array
from ..guard import reading
from ..reading import plain
from .record import PartialCamera, of_pixels
from .source import CameraSource, has_keys

NEEDS = "cam_K of each picture"

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
    if not poses_file.is_file():
        if object_id is not None:
            raise InputError(f"{poses_file}: does not exist, expected it for `object` {object_id}")
        return [view for view, *_ in _pictures(source)]
    poses = CameraSource(poses_file)
    with reading(poses, "a list of objects with cam_R_m2c, cam_t_m2c and obj_id for each picture"):
        objects: dict[str, Any] = {}
        for number, entries in poses.json.items():
            poses.place = f"{plain(number)}."
            objects |= {str(entry["obj_id"]): entry["obj_id"] for entry in entries}
        poses.place = ""
        if object_id is None:
            object_id = _only_object(poses, list(objects.values()))
        views = []
        for view, number, padded in _pictures(source):
            for place, entry in enumerate(poses.json.get(number, [])):
                if entry["obj_id"] == object_id:
                    poses.place = f"{plain(number)}."
                    R, t = _pose(poses, entry, "cam_R_m2c", "cam_t_m2c")
                    # The mask names picture and place; a picture with one such object names it too.
                    names = (f"{padded}_{place:06d}", padded)
                    views.append(replace(view, R=R, t=t, names=names))
    if not views:
        raise InputError(
            f"{poses_file}: no picture shows object {object_id}, expected one of "
            f"{_listed(list(objects.values()))}: `object` ID"
        )
    return views


def _pictures(source: CameraSource) -> Iterator[tuple[PartialCamera, str, str]]:
    """The camera of each picture, and its number as it is written and with six digits."""
    with reading(source, NEEDS):
        for number, values in source.json.items():
            source.place = f"{plain(number)}."
            K = source.matrix("cam_K", values["cam_K"], (9,), (3, 3)).reshape(3, 3)
            R = t = None
            if "cam_R_w2c" in values:
                R, t = _pose(source, values, "cam_R_w2c", "cam_t_w2c")
            padded = f"{int(number):06d}" if number.isdecimal() and len(number) < 10 else number
            view = PartialCamera(f"picture {number}", of_pixels(K, None), R, t, names=(padded,))
            yield view, number, padded


def _only_object(poses: CameraSource, objects: list[Any]) -> Any:
    """The object of a scene that has only one."""
    if len(objects) != 1:
        raise InputError(
            f"{poses.path}: holds the objects {_listed(objects)}, expected one; choose it: "
            "`object` ID"
        )
    return objects[0]


def _listed(objects: list[Any]) -> str:
    """The objects of a scene, in the order of their numbers."""
    ordered = sorted(objects, key=lambda number: number if isinstance(number, int) else math.inf)
    names = [plain(str(number)) for number in ordered[:MOST_LISTED]]
    return ", ".join(names) + (", ..." if len(ordered) > MOST_LISTED else "") or "none"


def _pose(
    source: CameraSource, values: dict[str, Any], rotation: str, translation: str
) -> tuple[Array, Array]:
    R = source.matrix(rotation, values[rotation], (9,), (3, 3)).reshape(3, 3)
    return R, source.matrix(translation, values[translation], (3,))
