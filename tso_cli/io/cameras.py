"""Camera files (JSON).

One camera is ``{"width": W, "height": H, "K": 3x3, "R": 3x3, "t": [3]}``. Several views are
``{"views": [...]}``, a list of objects with these keys. Optional keys are ``"model"``
("perspective" or "orthographic"), ``"mask"`` and ``"image"``, whose paths are relative to the file.
For the conventions see `tso_cli.geometry.camera`.
"""

from __future__ import annotations

import json
import math
import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, prefixed
from ..geometry.camera import Camera
from .images import PIXEL_LIMIT
from .output import write_file
from .reading import read_json, shown

_REQUIRED = ("width", "height", "K", "R", "t")
_OPTIONAL = ("model", "mask", "image")
_LARGEST = 1e15  # products of larger entries have no correct digits left
# Keys, in small letters, that other programs use for a camera. To ignore one of them would silently
# use another camera.
_MEANT = {key.casefold(): key for key in (*_REQUIRED, *_OPTIONAL, "views")} | {
    "w": "width", "h": "height", "camera_model": "model", "projection": "model",
    "intrinsics": "K", "intrinsic": "K", "intrinsic_matrix": "K", "camera_matrix": "K",
    "rotation": "R", "rotation_matrix": "R", "translation": "t", "tvec": "t",
    "masks": "mask", "mask_path": "mask",
    "images": "image", "image_path": "image", "file_path": "image",
    "view": "views", "cameras": "views", "frames": "views",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class CameraRecord:
    """A camera and the files that it belongs to, if the camera file names them."""

    camera: Camera
    mask: Path | None = None
    image: Path | None = None


def find_camera(mask_path: Path) -> Path | None:
    """The camera file in the folder of a mask, or None.

    That is the first of ``MASKSTEM.camera.json``, ``camera.json`` and ``cameras.json`` (as
    `tso render` names it) that exists.
    """
    for name in (f"{mask_path.stem}.camera.json", "camera.json", "cameras.json"):
        path = mask_path.with_name(name)
        if path.is_file():
            return path
    return None


def read_cameras(path: str | Path) -> list[CameraRecord]:
    """Read all views of a camera file, at least one.

    Raises InputError, which names the file and the key, if the file is wrong.
    """
    path = Path(path)
    document = read_json(
        path,
        "a camera file (JSON)",
        "a camera file",
        limit=64 << 20,
        build=lambda pairs: _unique(pairs, path),
    )
    if not isinstance(document, dict):
        raise InputError(
            f"{path}: holds {_kind(document)}, "
            "expected an object with width, height, K, R, t or views"
        )
    views, ignored = {"": document}, set()
    if "views" in document:
        cameras = document["views"]
        if not isinstance(cameras, list) or not cameras:
            raise InputError(
                f"{path}: views is {_kind(cameras)}, expected a list of at least one camera"
            )
        ignored |= _unknown_keys(path, "", document, ("views",))
        views = {f"views[{i}].": view for i, view in enumerate(cameras)}
    records = []
    for where, view in views.items():
        if not isinstance(view, dict):
            raise InputError(
                f"{path}: {where[:-1]} is {_kind(view)}, "
                "expected an object with width, height, K, R, t"
            )
        ignored |= _unknown_keys(path, where, view, _REQUIRED + _OPTIONAL)
        records.append(_record(path, where, view))
    if ignored:
        warnings.warn(
            f"{path}: unknown keys are ignored: {shown(', '.join(sorted(ignored)))}", stacklevel=2
        )
    return records


def read_camera(
    path: str | Path, width: int, height: int, mask: str | Path | None = None
) -> Camera:
    """Read the camera of the file ``mask``, which has ``width`` x ``height`` pixels.

    If the camera file has several views, exactly one of them must name the file ``mask``. Raises
    InputError if that is not so, if the size differs, or as `read_cameras`.
    """
    path = Path(path)
    records = read_cameras(path)
    if len(records) > 1:
        naming = [record for record in records if mask is not None and _names(record, mask)]
        if len(naming) != 1:
            named = f"the mask {mask}" if mask is not None else "a mask"
            raise InputError(
                f"{path}: {len(naming)} of its {len(records)} views name {named}, expected one"
            )
        records = naming
    elif mask is not None and records[0].mask is not None and not _names(records[0], mask):
        warnings.warn(
            f"{path}: its one view names the mask {records[0].mask}, used for {mask}", stacklevel=2
        )
    check_size(path, records[0].camera, width, height, mask)
    return records[0].camera


def _names(record: CameraRecord, mask: str | Path) -> bool:
    """Whether a view names the file ``mask``, perhaps by another path."""
    return record.mask is not None and os.path.realpath(record.mask) == os.path.realpath(mask)


def check_size(
    path: str | Path, camera: Camera, width: int, height: int, mask: str | Path | None = None
) -> None:
    """Raise InputError unless ``camera``, read from ``path``, is for ``width`` x ``height``."""
    if (camera.width, camera.height) != (width, height):
        named = f"the mask {mask}" if mask is not None else "the mask"
        raise InputError(
            f"{path}: width x height is {camera.width}x{camera.height}, "
            f"{named} is {width}x{height}, expected the same"
        )


def named_masks(path: Path) -> list[Path]:
    """The masks that the views of a camera file name, in the order of the views.

    Raises InputError as `read_cameras`, or if a view names no mask.
    """
    masks = [record.mask for record in read_cameras(path)]
    if None in masks:
        where = f"views[{masks.index(None)}] of {len(masks)}"
        raise InputError(
            f"{path}: {where} names no mask, expected a mask in each view, or MASK arguments"
        )
    return [mask for mask in masks if mask is not None]


def pair_with_masks(path: Path, masks: Sequence[Path]) -> list[Camera]:
    """The camera of each of several masks.

    1. If every mask has its own view that names the path of the mask, these views are taken.
    2. If every mask has its own view that names a file of the same name, these views are taken.
    3. Otherwise the first view belongs to the first mask, and so on.

    Raises InputError as `read_cameras`. Also raises InputError in the third case if views and masks
    differ in number, or if a view names a mask at another place.
    """
    records = read_cameras(path)
    naming: list[list[int]] = []  # for each mask the views that name it
    for named in (_names, _has_name):
        naming = [[i for i, record in enumerate(records) if named(record, mask)] for mask in masks]
        if all(len(views) == 1 for views in naming):
            chosen = [views[0] for views in naming]
            if len(set(chosen)) == len(masks):
                return [records[i].camera for i in chosen]
    if len(records) != len(masks):
        raise InputError(
            f"{path}: holds {len(records)} view{'s' if len(records) > 1 else ''}, "
            f"found {len(masks)} masks; expected as many, or views that name every mask"
        )
    for i, (record, mask, views) in enumerate(zip(records, masks, naming, strict=True)):
        if views and i not in views:
            raise InputError(
                f"{path}: the mask {mask} is named by views[{views[0]}] and given at place {i}, "
                "expected the same order"
            )
        if not views and record.mask is not None:
            warnings.warn(
                f"{path}: views[{i}] names the mask {record.mask}, used for {mask}", stacklevel=2
            )
    return [record.camera for record in records]


def _has_name(record: CameraRecord, mask: Path) -> bool:
    """Whether a view names a file with the name of ``mask``, in whatever folder."""
    return record.mask is not None and record.mask.name == mask.name


def write_cameras(path: Path, records: Sequence[CameraRecord], overwrite: bool = False) -> None:
    """Write a camera file that reads back exactly.

    A single record without files is written as one camera, anything else as views.
    """
    write_file(path, camera_text(path, records).encode(), overwrite)


def camera_text(path: Path, records: Sequence[CameraRecord]) -> str:
    """The text that `write_cameras` writes; paths in it are relative to the file ``path``."""
    views = [_as_json(record, path) for record in records]
    if len(records) == 1 and records[0].mask is None and records[0].image is None:
        return _lines(views[0], "") + "\n"
    listed = ",\n    ".join(_lines(view, "    ") for view in views)
    return f'{{\n  "views": [\n    {listed}\n  ]\n}}\n'


def _lines(view: dict[str, Any], indent: str) -> str:
    """One key per line; a matrix stays on the line of its key."""
    entries = [f"{indent}  {json.dumps(key)}: {json.dumps(value)}" for key, value in view.items()]
    return "{\n" + ",\n".join(entries) + f"\n{indent}}}"


def _as_json(record: CameraRecord, path: Path) -> dict[str, Any]:
    folder, camera = os.path.realpath(path.parent), record.camera
    files = {"mask": record.mask, "image": record.image}
    return {
        **{
            key: Path(os.path.relpath(os.path.realpath(file), folder)).as_posix()
            for key, file in files.items()
            if file
        },
        **{"width": camera.width, "height": camera.height, "model": camera.model},
        **{"K": camera.K.tolist(), "R": camera.R.tolist(), "t": camera.t.tolist()},
    }


def _unique(pairs: list[tuple[str, Any]], path: Path) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for i, key in enumerate(keys) if key in keys[:i])
        raise InputError(
            f"{path}: the key {shown(twice)} appears twice in one object, expected once"
        )
    return values


def _kind(value: Any) -> str:
    if isinstance(value, (list, dict)):
        return ("list" if isinstance(value, list) else "object") + f" of {len(value)}"
    return shown(value)


def _unknown_keys(path: Path, where: str, view: dict[str, Any], known: Sequence[str]) -> set[str]:
    """The keys to ignore; InputError for a key that other programs use for a camera."""
    unknown = [key for key in view if key not in known]
    for key in unknown:
        meant = _MEANT.get(key.casefold())
        if meant == key:
            raise InputError(
                f"{path}: the key {where}{key} is out of place, expected either views or one camera"
            )
        if meant is not None:
            raise InputError(
                f"{path}: the key {where}{shown(key)} is not one of camera files, expected {meant}"
            )
    return set(unknown)


def _record(path: Path, where: str, view: dict[str, Any]) -> CameraRecord:
    for key in _REQUIRED:
        if key not in view:
            raise InputError(f"{path}: {where}{key} is missing, expected width, height, K, R and t")
    width, height = view["width"], view["height"]
    pixels = _number(path, where + "width", width) * _number(path, where + "height", height)
    if pixels > PIXEL_LIMIT:
        raise InputError(
            f"{path}: {where}width x height is {width}x{height}, "
            f"expected at most {PIXEL_LIMIT:,} pixels"
        )
    K, R = (_numbers(path, where + key, view[key], "3x3") for key in ("K", "R"))
    t = _numbers(path, where + "t", view["t"], "[3]")
    with prefixed(f"{path}: {where}"), np.errstate(all="ignore"):
        camera = Camera(
            np.array(K), np.array(R), np.array(t), width, height, view.get("model", "perspective")
        )
    return CameraRecord(camera, _file(path, where, view, "mask"), _file(path, where, view, "image"))


def _number(path: Path, where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{path}: {where} is {_kind(value)}, expected a number")
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{path}: {where} is {value}, expected a finite number")
    if abs(value) > _LARGEST:
        raise InputError(f"{path}: {where} is {shown(value)}, expected at most {_LARGEST:g}")
    return float(value)


def _numbers(path: Path, where: str, value: Any, shape: str) -> list[Any]:
    """The numbers of a vector (``shape`` "[3]") or of a matrix (``shape`` "3x3")."""
    if not isinstance(value, list) or len(value) != 3:
        raise InputError(f"{path}: {where} is {_kind(value)}, expected {shape} numbers")
    if shape == "3x3":
        return [_numbers(path, f"{where}[{i}]", row, "[3]") for i, row in enumerate(value)]
    return [_number(path, f"{where}[{i}]", entry) for i, entry in enumerate(value)]


def _file(path: Path, where: str, view: dict[str, Any], key: str) -> Path | None:
    value = view.get(key)
    if value is not None and (not isinstance(value, str) or not value or min(value) < " "):
        raise InputError(f"{path}: {where}{key} is {_kind(value)}, expected the path of a file")
    return None if value is None else path.parent / value
