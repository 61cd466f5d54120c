"""OpenCV's FileStorage (YAML, XML) and .npz, ROS ``camera_info`` and Kalibr's camchain (YAML).

All have the axes of OpenCV and pixel centres at whole numbers. Some hold only K. Two cameras of
``cv2.stereoCalibrate`` have the frame of the first as their world.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from ...errors import InputError
from ...geometry.arrays import Array
from ...geometry.distortion import Distortion
from ...geometry.rotations import from_vectors
from ..reading import shown
from .record import PartialCamera, from_world_to_camera, matrix_of, of_pixels
from .source import CameraSource

NEEDS = "keys such as camera_matrix"

_K = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "intrinsic_matrix", "mtx")
_DISTORTION = (
    "distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D", "dist",
)  # fmt: skip
# The two cameras of a stereo rig: names of K, and of the distortion.
_STEREO = (
    (("M1", "cameraMatrix1", "K1", "mtx1"), ("D1", "distCoeffs1", "dist1")),
    (("M2", "cameraMatrix2", "K2", "mtx2"), ("D2", "distCoeffs2", "dist2")),
)
_ROTATION = ("R", "rvec", "rotation", "rotation_matrix")
_TRANSLATION = ("T", "t", "tvec", "translation")
_WIDTH, _HEIGHT = ("image_width", "width"), ("image_height", "height")
# Keys of a .npz that only code with OpenCV writes; K, R and t are those of `matrices`.
_OF_NPZ = ("mtx", "rvec", "rvecs")
_VECTORS = ((-1, 3), (-1, 3, 1), (-1, 1, 3))
# Names of lens models -> that of `Distortion`.
_LENSES = {
    "plumb_bob": "radial-tangential", "rational_polynomial": "radial-tangential",
    "radtan": "radial-tangential", "none": "radial-tangential", "": "radial-tangential",
    "equidistant": "equidistant", "equi": "equidistant", "fisheye": "equidistant",
}  # fmt: skip


def recognises(source: CameraSource) -> bool:
    document = _document(source)
    if not isinstance(document, dict):
        return False
    if source.container == "zip":
        return any(key in document for key in _OF_NPZ) or _is_stereo(document)
    if source.looks_like_json:
        # A plain K in JSON is tso's.
        return isinstance(_first(document, _K), dict)
    return any(key in document for key in _K) or _is_stereo(document) or bool(_cams(document))


def read(source: CameraSource) -> list[PartialCamera]:
    document = _document(source)
    if cams := _cams(document):
        return _kalibr(source, cams)
    return _stereo(source, document) if _is_stereo(document) else _calibration(source, document)


def _document(source: CameraSource) -> Any:
    if source.container == "zip":
        return source.arrays
    if source.looks_like_json:
        return source.json
    documents = [_ros(document) for document in source.markup]
    calibrations = [
        document for document in documents if isinstance(document, dict) and _first(document, _K)
    ]
    if len(documents) < 2 or len(calibrations) < len(documents):
        return documents[0] if len(documents) == 1 else None
    # Messages of a topic of ROS; their headers differ.
    first = documents[0]
    if any(_first(document, _K) != _first(first, _K) for document in documents):
        raise InputError(
            f"{source.path}: holds {len(documents)} messages with different K, expected one camera"
        )
    return first


def _ros(document: Any) -> Any:
    """A ``camera_info`` with the names of ROS 1; ROS 2 writes K, D, R and P in small letters."""
    if not isinstance(document, dict) or "distortion_model" not in document:
        return document
    return {key.upper() if key in ("k", "d", "r", "p") else key: document[key] for key in document}


def _first(values: dict[str, Any], names: tuple[str, ...]) -> Any:
    return next((values[name] for name in names if values.get(name) is not None), None)


def _is_stereo(values: dict[str, Any]) -> bool:
    return all(_first(values, names) is not None for names, _ in _STEREO)


def _size(source: CameraSource, values: dict[str, Any]) -> tuple[int, int] | None:
    width, height = _first(values, _WIDTH), _first(values, _HEIGHT)
    return None if width is None or height is None else source.pixels("", width, height)


def _model(values: dict[str, Any]) -> Any:
    flag = values.get("fisheye_model")
    is_fisheye = isinstance(flag, (int, float)) and flag != 0
    return "fisheye" if is_fisheye else values.get("distortion_model", "")


def _calibration(source: CameraSource, values: dict[str, Any]) -> list[PartialCamera]:
    size = _size(source, values)
    K = of_pixels(_matrix(source, "K", _first(values, _K), (3, 3), (9,)).reshape(3, 3), size)
    lens = _lens(source, "", _model(values), _first(values, _DISTORTION))
    poses = _poses(source, values)
    if poses is not None:
        return [
            PartialCamera(f"pose {i}", K, from_vectors(row[:3]), row[3:], size, distortion=lens)
            for i, row in enumerate(poses)
        ]
    R, t = _pose(source, values)
    return [PartialCamera("", K, R, t, size, distortion=lens)]


def _stereo(source: CameraSource, values: dict[str, Any]) -> list[PartialCamera]:
    """The cameras of ``cv2.stereoCalibrate``; R and T lead from the first to the second."""
    size = _size(source, values)
    R, t = _pose(source, values)
    poses = [(None, None), (None, None)] if R is None else [(np.eye(3), np.zeros(3)), (R, t)]
    views = []
    for number, ((matrix, lens), (R, t)) in enumerate(zip(_STEREO, poses, strict=True), 1):
        K = _matrix(source, f"K of camera {number}", _first(values, matrix), (3, 3))
        distortion = _lens(source, f"camera {number}: ", _model(values), _first(values, lens))
        views.append(
            PartialCamera(f"camera {number}", of_pixels(K, size), R, t, size,
                          distortion=distortion, names=(f"camera{number}",))
        )  # fmt: skip
    return views


def _poses(source: CameraSource, values: dict[str, Any]) -> Array | None:
    """The pose of each picture of a calibration: rotation vector and t [N, 6]; None without."""
    poses, turns, shifts = (values.get(key) for key in ("extrinsic_parameters", "rvecs", "tvecs"))
    if poses is not None:
        return _matrix(source, "extrinsic_parameters", poses, (-1, 6))
    if turns is None or shifts is None:
        return None
    turn, shift = (
        _matrix(source, where, vectors, *_VECTORS).reshape(-1, 3)
        for where, vectors in (("rvecs", turns), ("tvecs", shifts))
    )
    if len(turn) != len(shift):
        raise source.error("tvecs", f"{len(shift)} vectors", f"{len(turn)}, as rvecs")
    return np.hstack([turn, shift])


def _pose(source: CameraSource, values: dict[str, Any]) -> tuple[Array | None, Array | None]:
    """R and t. R alone is no pose: that of ``camera_info`` rectifies the picture."""
    rotation, translation = _first(values, _ROTATION), _first(values, _TRANSLATION)
    if rotation is None or translation is None:
        return None, None
    turn = _matrix(source, "R", rotation, (3, 3), (9,), (3,), (3, 1), (1, 3))
    R = turn.reshape(3, 3) if turn.size == 9 else from_vectors(turn.ravel())
    return R, _matrix(source, "t", translation, (3,), (3, 1), (1, 3)).ravel()


def _cams(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The cameras of a camchain of Kalibr; {} if it is none."""
    cams = {
        name: values
        for name, values in document.items()
        if re.fullmatch(r"cam\d+", str(name)) and isinstance(values, dict)
    }
    return cams if any("intrinsics" in values for values in cams.values()) else {}


def _kalibr(source: CameraSource, cams: dict[str, dict[str, Any]]) -> list[PartialCamera]:
    """Poses lead from the IMU, or else from the first camera, if others follow from it."""
    views = []
    poses = {key for values in cams.values() for key in values} & {"T_cam_imu", "T_cn_cnm1"}
    chain = np.eye(4) if poses == {"T_cn_cnm1"} else None
    last = None
    for name in sorted(cams, key=lambda cam: int(cam[3:])):
        values = cams[name]
        # A pose leads from the camera before it, which must be there and have one itself.
        if last is not None and ("T_cn_cnm1" not in values or int(name[3:]) != last + 1):
            chain = None
        last = int(name[3:])
        source.place = f"{name}."
        model = values.get("camera_model", "pinhole")
        if model != "pinhole":
            raise InputError(
                f"{source.path}: {name}: camera_model is {shown(model)}, expected pinhole; "
                "undistort the pictures"
            )
        numbers = source.matrix("intrinsics", values["intrinsics"], (4,))
        size = None
        if "resolution" in values:
            width, height = source.matrix("resolution", values["resolution"], (2,))
            size = source.pixels("resolution: ", width, height)
        source.place = ""
        lens = _lens(
            source, f"{name}.", values.get("distortion_model", ""), values.get("distortion_coeffs")
        )
        if "T_cam_imu" in values:
            chain = source.pose(f"{name}.T_cam_imu", values["T_cam_imu"])
        elif "T_cn_cnm1" in values:
            step = source.pose(f"{name}.T_cn_cnm1", values["T_cn_cnm1"])
            if chain is None:
                raise InputError(
                    f"{source.path}: {name}: T_cn_cnm1 follows a camera without a pose, expected "
                    "T_cam_imu of all cameras"
                )
            chain = step @ chain
        R, t = (None, None) if chain is None else from_world_to_camera(chain)
        K = matrix_of(*numbers.tolist())
        views.append(
            PartialCamera(name, of_pixels(K, size), R, t, size, distortion=lens, names=(name,))
        )
    return views


def _lens(source: CameraSource, where: str, model: Any, coefficients: Any) -> Distortion | None:
    name = _LENSES.get(str(model).casefold())
    if name is None:
        raise InputError(
            f"{source.path}: {where}distortion_model is {shown(model)}, expected one of "
            f"{', '.join(filter(None, _LENSES))}; undistort the pictures"
        )
    if coefficients is None:
        return None
    values = _matrix(source, f"{where}distortion", coefficients, (-1,), (-1, 1), (1, -1)).ravel()
    if len(values) > 8 and np.any(values[8:]):
        raise InputError(
            f"{source.path}: {where}distortion has {len(values)} coefficients, expected at most 8; "
            "undistort the pictures: cv2.undistort"
        )
    numbers = tuple(values[:8].tolist())
    return Distortion("equidistant" if name == "equidistant" else "radial-tangential", numbers)


def _matrix(source: CameraSource, where: str, value: Any, *shapes: tuple[int, ...]) -> Array:
    """As `CameraSource.matrix`; ``value`` may be an object with rows, cols and data."""
    if not isinstance(value, dict):
        return source.matrix(where, value, *shapes)
    data = value.get("data")
    rows, columns = value.get("rows"), value.get("cols", value.get("columns"))
    if isinstance(data, list) and isinstance(rows, int) and isinstance(columns, int):
        if rows * columns != len(data):
            count = f"{len(data)} numbers"
            raise source.error(f"{where}: data", count, f"rows x cols = {rows} x {columns}")
        if len(data) > 0:
            data = [data[i * columns : (i + 1) * columns] for i in range(rows)]
    return source.matrix(where, data, *shapes)
