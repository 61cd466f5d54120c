"""tso's own camera file (JSON), and matrices in JSON under the names that programs give them.

One camera is ``{"width": W, "height": H, "K": 3x3, "R": 3x3, "t": [3]}``. Several views are
``{"views": [...]}`` or a plain list of such objects. Optional keys are ``"model"`` ("perspective"
or "orthographic"), ``"mask"`` and ``"image"``, whose paths are relative to the file. For the
conventions see `tso_cli.geometry.camera`.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, prefixed
from ...geometry.arrays import Array
from ...geometry.camera import intrinsics
from ..checked import kind
from ..images import PIXEL_LIMIT
from ..reading import shown
from .matrices import decomposed
from .record import (
    Intrinsics,
    PartialCamera,
    from_camera_to_world,
    from_world_to_camera,
    matrix_of,
    of_pixels,
)
from .source import CameraSource

NEEDS = "width, height, K, R and t"

# Key -> other names of the same thing in files of other programs. Each has one meaning.
NAMES = {
    "K": ("intrinsic", "intrinsics", "intrinsic_matrix", "camera_matrix", "cam_K"),
    "focal": ("focals",),
    "pp": ("principal_points",),
    "R": ("rotation_matrix", "cam_R_w2c"),
    "t": ("tvec", "cam_t_w2c"),
    "E": ("extrinsic", "extrinsics", "extrinsic_matrix", "w2c", "world_to_camera", "world2cam"),
    "c2w": ("c2ws", "cam2world", "cams2world", "camera_to_world", "camera_poses"),
    "P": ("projection_matrix",),
    "width": ("w", "image_width"),
    "height": ("h", "image_height"),
}
OTHER_NAMES = {other: key for key, others in NAMES.items() for other in others}
_FOCAL = ("fx", "fy", "cx", "cy")
_FILES = ("mask", "image")
_KNOWN = (*NAMES, *_FOCAL, *_FILES, "model")
# Keys of formats that have readers of their own.
_FOREIGN = ("frames", "rotation", "t_00", "cameraPoseARFrame", "poses", "imageResolution")
# What keys are called that may hold a pose.
_LIKE_A_POSE = re.compile("pose|extrin|transf|view_?mat|c2w|w2c|cam.*world|world.*cam", re.I)
# Keys of lens distortion, which belongs to formats that say its model.
_LENS = ("dist", "distortion", "dist_coeffs", "distCoeffs", "distortion_coefficients", "D", "k1")
# Keys that do not say which way they go: what to write instead.
_UNCLEAR = {
    "rotation": "R if it leads from world to camera, or the matrix c2w",
    "translation": "t if X_camera = R X_world + t, or the matrix c2w",
    "position": "t = -R position",
    "quaternion": "the rotation matrix R",
    "qvec": "the rotation matrix R",
    "rvec": "the rotation matrix R",
    "masks": "mask", "mask_path": "mask",
    "images": "image", "image_path": "image", "file_path": "image",
    "view": "views", "cameras": "views", "frames": "views",
    "camera_model": "model", "projection": "model",
}  # fmt: skip


def recognises(source: CameraSource) -> bool:
    document = source.json
    if isinstance(document, list):
        document = document[0] if document else None
    if not isinstance(document, dict):
        return False
    matrices = {*NAMES, *OTHER_NAMES, "fx"} - {"width", "height"}
    matrix_keys = [key for key in document if key in matrices]
    # Programs with formats of their own nest objects under some of these names.
    nested = any(isinstance(document[key], dict) for key in matrix_keys)
    foreign = not document.keys().isdisjoint(_FOREIGN)
    return "views" in document or (bool(matrix_keys) and not nested and not foreign)


def read(source: CameraSource) -> list[PartialCamera]:
    path, document = source.path, source.json
    views, ignored = {"": document}, set()
    if isinstance(document, dict) and "views" in document:
        cameras = document["views"]
        if not isinstance(cameras, list) or not cameras:
            raise source.error("views", kind(cameras), "a list of at least one camera")
        ignored |= _unknown_keys(path, "", document, ("views",))
        views = {f"views[{i}].": view for i, view in enumerate(cameras)}
    elif isinstance(document, list) and document:
        views = {f"[{i}].": view for i, view in enumerate(document)}
    records = []
    for where, view in views.items():
        if not isinstance(view, dict):
            place = f"{where[:-1]} is" if where else "holds"
            raise InputError(
                f"{path}: {place} {kind(view)}, expected an object with {NEEDS}"
                + ("" if where else " or views")
            )
        ignored |= _unknown_keys(path, where, view, _KNOWN)
        records.append(_record(source, where, view))
    if ignored:
        warnings.warn(
            f"{path}: unknown keys are ignored: {shown(', '.join(sorted(ignored)))}", stacklevel=2
        )
    return records


def _unknown_keys(path: Path, where: str, view: dict[str, Any], names: Sequence[str]) -> set[str]:
    """The keys to ignore; InputError for a key whose meaning is not clear."""
    unknown = [key for key in view if key not in names and OTHER_NAMES.get(key) not in names]
    canonical = {key.casefold(): key for key in ("views", *_KNOWN)}
    for key in unknown:
        if key in canonical.values() or key in OTHER_NAMES:
            raise InputError(
                f"{path}: the key {where}{key} is out of place, expected either views or one camera"
            )
        meant = _UNCLEAR.get(key.casefold()) or canonical.get(key.casefold())
        if meant is not None:
            raise InputError(
                f"{path}: the key {where}{shown(key)} is not one of camera files, expected {meant}"
            )
    return set(unknown)


def _record(source: CameraSource, where: str, view: dict[str, Any]) -> PartialCamera:
    values: dict[str, Any] = {}
    for key, value in view.items():
        name = OTHER_NAMES.get(key, key)
        if name in values:
            raise InputError(
                f"{source.path}: the key {where}{shown(key)} says {name} again, expected it once"
            )
        values[name] = value
    K, R, t, size = matrices_of(source, where, values)
    mask, image = (_file(source, where, values, key) for key in _FILES)
    return PartialCamera(
        where.rstrip("."),
        K,
        R,
        t,
        size,
        values.get("model", "perspective"),
        mask=mask,
        image=image,
        unread=like_poses(values),
    )


def like_poses(keys: Iterable[str]) -> tuple[str, ...]:
    """The keys that tso does not know, and that are called like a pose."""
    unknown = [key for key in keys if OTHER_NAMES.get(key, key) not in NAMES]
    return tuple(key for key in unknown if _LIKE_A_POSE.search(key))


def _size(source: CameraSource, where: str, values: dict[str, Any]) -> tuple[int, int] | None:
    sides = [key for key in ("width", "height") if key in values]
    if not sides:
        return None
    if len(sides) == 1:
        missing = "height" if sides == ["width"] else "width"
        raise InputError(f"{source.path}: {where}{missing} is missing, expected {NEEDS}")
    width, height = source.pixels(where, values["width"], values["height"])
    if width * height > PIXEL_LIMIT:
        raise source.error(
            f"{where}width x height", f"{width}x{height}", f"at most {PIXEL_LIMIT:,} pixels"
        )
    return width, height


def matrices_of(
    source: CameraSource, where: str, values: dict[str, Any]
) -> tuple[Intrinsics | None, Array | None, Array | None, tuple[int, int] | None]:
    """K, R, t and the size of the picture, as far as a view has them.

    ``values`` has the keys of `NAMES`. Raises InputError if it has neither K nor a pose.
    """
    size = _size(source, where, values)
    K = R = t = None
    in_pixels: Intrinsics | None = None
    require_no_lens(source, where, values)
    if sum(key in values for key in ("E", "c2w", "R")) + ("P" in values) > 1:
        raise InputError(f"{source.path}: {where or 'it '}has several poses, expected one")
    if "P" in values:
        P = source.matrix(f"{where}P", values["P"], (3, 4), (12,)).reshape(3, 4)
        with prefixed(f"{source.path}: {where}"):
            K, R, t = decomposed(P)
    if "K" in values:
        K = matrix_K(source, f"{where}K", values["K"])
    elif "fx" in values:
        missing = [key for key in _FOCAL if key not in values]
        if missing:
            raise InputError(
                f"{source.path}: {where}{missing[0]} is missing, expected fx, fy, cx and cy"
            )
        K = matrix_of(*[source.number(where + key, values[key]) for key in _FOCAL])
    elif "focal" in values:
        focal = source.number(f"{where}focal", values["focal"])
        in_pixels = partial(intrinsics, focal)
        if "pp" in values:
            K = matrix_of(focal, focal, *source.matrix(f"{where}pp", values["pp"], (2,)).tolist())
        elif size:
            K = intrinsics(focal, *size)
    for key, pose in (("E", from_world_to_camera), ("c2w", from_camera_to_world)):
        if key in values:
            R, t = pose(source.pose(where + key, values[key], (4, 4), (3, 4), (16,), (12,)))
    if ("R" in values) != ("t" in values):
        other = "t" if "R" in values else "R"
        raise InputError(f"{source.path}: {where}{other} is missing, expected {NEEDS}")
    if "R" in values:
        R = source.matrix(f"{where}R", values["R"], (3, 3), (9,)).reshape(3, 3)
        t = source.matrix(f"{where}t", values["t"], (3,), (3, 1)).reshape(3)
    if K is not None:
        in_pixels = of_pixels(K, size)
    if in_pixels is None and R is None:
        raise InputError(f"{source.path}: {where}K is missing, expected {NEEDS}")
    return in_pixels, R, t, size


def matrix_K(source: CameraSource, where: str, values: Any) -> Array:
    """``values`` by rows as K [3, 3]; ScanNet's is [4, 4].

    Raises InputError as `CameraSource.matrix`, or if they are the transpose of K.
    """
    matrix = source.matrix(where, values, (3, 3), (9,), (4, 4))
    if matrix.shape == (4, 4):
        matrix = source.pose(where, matrix)[:3, :3]
    K = matrix.reshape(3, 3)
    if K[2, :2].any() and not K[:2, 2].any():
        row = " ".join(f"{value:g}" for value in K[2])
        raise source.error(
            f"the last row of {where}", row, "0 0 1; transpose the matrix: it is stored by columns"
        )
    return K


def require_no_lens(source: CameraSource, where: str, values: dict[str, Any]) -> None:
    """Raise InputError if ``values`` have lens distortion, whose model they do not say."""
    for key in _LENS:
        try:
            numbers = np.asarray(values.get(key, 0.0), dtype=np.float64)
        except (ValueError, TypeError):
            continue
        if numbers.any():
            raise InputError(
                f"{source.path}: {where}{key} is lens distortion, which this format has no model "
                "for; undistort the picture (cv2.undistort), or use a file of OpenCV or COLMAP"
            )


def _file(source: CameraSource, where: str, view: dict[str, Any], key: str) -> Path | None:
    value = view.get(key)
    if value is None:
        return None
    if not isinstance(value, str) or not value or min(value) < " ":
        raise source.error(where + key, kind(value), "the path of a file")
    return relative_to(source.path, value)


def relative_to(path: Path, name: str) -> Path:
    """The file ``name`` that the camera file ``path`` names, on Windows with backslashes."""
    folder = path if path.is_dir() else path.parent
    return folder / name.replace("\\", "/")


def named_file(source: CameraSource, value: Any) -> Path | None:
    """The file that ``value`` names; None if it is no name."""
    is_name = isinstance(value, str) and bool(value) and min(value) >= " "
    return relative_to(source.path, value) if is_name else None
