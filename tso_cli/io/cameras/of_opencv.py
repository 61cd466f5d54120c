"""OpenCV's FileStorage (YAML, XML), ROS ``camera_info`` and Kalibr's camchain (YAML).

All have the axes of OpenCV and pixel centres at whole numbers. Some hold only K.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from ...errors import InputError
from ...geometry.arrays import Array
from ...geometry.distortion import Distortion
from ...geometry.rotations import from_vectors
from ..checked import kind
from ..output import reason
from ..reading import shown
from .record import PartialCamera, from_world_to_camera, matrix_of, of_pixels
from .source import CameraSource

LARGEST_TEXT = 1 << 20  # bytes; a parser of YAML is slow
_K = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "intrinsic_matrix")
_DISTORTION = (
    "distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D",
)  # fmt: skip
_ROTATION = ("R", "rvec", "rotation", "rotation_matrix")
_TRANSLATION = ("T", "t", "tvec", "translation")
_WIDTH, _HEIGHT = ("image_width", "width"), ("image_height", "height")
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
    if source.looks_like_json:
        # A plain K in JSON is tso's.
        return isinstance(_first(document, _K), dict)
    return any(key in document for key in _K) or bool(_cams(document))


def read(source: CameraSource) -> list[PartialCamera]:
    document = _document(source)
    if not isinstance(document, dict):
        raise source.error("the document", kind(document), "keys such as camera_matrix")
    cams = _cams(document)
    return _kalibr(source, cams) if cams else _calibration(source, document)


def _first(values: dict[str, Any], names: tuple[str, ...]) -> Any:
    return next((values[name] for name in names if values.get(name) is not None), None)


def _calibration(source: CameraSource, values: dict[str, Any]) -> list[PartialCamera]:
    found = _first(values, _K)
    if found is None:
        raise InputError(f"{source.path}: has none of {', '.join(_K)}, expected K")
    K = source.matrix("K", _entries(found), (3, 3), (9,)).reshape(3, 3)
    width, height = _first(values, _WIDTH), _first(values, _HEIGHT)
    size = None if width is None or height is None else source.pixels("", width, height)
    model = "fisheye" if values.get("fisheye_model") else values.get("distortion_model", "")
    lens = _lens(source, "", model, _first(values, _DISTORTION))
    rotation, translation = _first(values, _ROTATION), _first(values, _TRANSLATION)
    poses = values.get("extrinsic_parameters")
    if poses is not None:
        rows = source.matrix("extrinsic_parameters", _entries(poses), (-1, 6))
        return [
            PartialCamera(f"pose {i}", of_pixels(K, size), from_vectors(row[:3]), row[3:], size,
                          distortion=lens)
            for i, row in enumerate(rows)
        ]  # fmt: skip
    R = t = None
    if rotation is not None and translation is not None:
        shapes = ((3, 3), (9,), (3,), (3, 1), (1, 3))
        turn = source.matrix("R", _entries(rotation), *shapes)
        R = turn.reshape(3, 3) if turn.size == 9 else from_vectors(turn.ravel())
        t = source.matrix("t", _entries(translation), (3,), (3, 1), (1, 3)).ravel()
    return [PartialCamera("", of_pixels(K, size), R, t, size, distortion=lens)]


def _cams(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The cameras of a camchain of Kalibr."""
    return {
        name: values
        for name, values in document.items()
        if re.fullmatch(r"cam\d+", str(name))
        and isinstance(values, dict)
        and "intrinsics" in values
    }


def _kalibr(source: CameraSource, cams: dict[str, dict[str, Any]]) -> list[PartialCamera]:
    """Poses lead from the IMU, or else from the first camera."""
    views = []
    chain: Array | None = None
    for name in sorted(cams, key=lambda cam: int(cam[3:])):
        values = cams[name]
        model = values.get("camera_model", "pinhole")
        if model != "pinhole":
            raise InputError(
                f"{source.path}: {name}: camera_model is {shown(model)}, expected pinhole; "
                "undistort the pictures"
            )
        numbers = source.matrix(f"{name}.intrinsics", values["intrinsics"], (4,))
        size = None
        if "resolution" in values:
            width, height = source.matrix(f"{name}.resolution", values["resolution"], (2,))
            size = source.pixels(f"{name}.resolution: ", width, height)
        lens = _lens(
            source, f"{name}.", values.get("distortion_model", ""), values.get("distortion_coeffs")
        )
        if "T_cam_imu" in values:
            chain = source.matrix(f"{name}.T_cam_imu", values["T_cam_imu"], (4, 4))
        elif "T_cn_cnm1" in values:
            step = source.matrix(f"{name}.T_cn_cnm1", values["T_cn_cnm1"], (4, 4))
            chain = step @ (np.eye(4) if chain is None else chain)
        R, t = (None, None) if chain is None else from_world_to_camera(chain)
        K = matrix_of(*numbers.tolist())
        views.append(
            PartialCamera(name, of_pixels(K, size), R, t, size, distortion=lens, names=(name,))
        )
    return views


def _lens(source: CameraSource, where: str, model: Any, found: Any) -> Distortion | None:
    name = _LENSES.get(str(model).casefold())
    if name is None:
        raise InputError(
            f"{source.path}: {where}distortion_model is {shown(model)}, expected one of "
            f"{', '.join(filter(None, _LENSES))}; undistort the pictures"
        )
    if found is None:
        return None
    values = source.matrix(f"{where}distortion", _entries(found), (-1,), (-1, 1), (1, -1)).ravel()
    if len(values) > 8 and np.any(values[8:]):
        raise InputError(
            f"{source.path}: {where}distortion has {len(values)} coefficients, expected at most 8; "
            "undistort the pictures: cv2.undistort"
        )
    numbers = tuple(values[:8].tolist())
    return Distortion("equidistant" if name == "equidistant" else "radial-tangential", numbers)


def _entries(value: Any) -> Any:
    """The numbers of a matrix, which may be an object with rows, cols and data."""
    if not isinstance(value, dict):
        return value
    data = value.get("data")
    rows, columns = value.get("rows"), value.get("cols", value.get("columns"))
    if not isinstance(data, list) or not isinstance(rows, int) or not isinstance(columns, int):
        return data
    if rows * columns != len(data) or min(rows, columns) < 1:
        return data
    return [data[i * columns : (i + 1) * columns] for i in range(rows)]


def _document(source: CameraSource) -> Any:
    if len(source.data) > LARGEST_TEXT:
        raise InputError(
            f"{source.path}: holds {len(source.data):,} bytes, expected at most {LARGEST_TEXT:,}"
        )
    if source.looks_like_json:
        return source.json
    return _xml(source) if source.text.lstrip().startswith("<") else _yaml(source)


def _yaml(source: CameraSource) -> Any:
    """A YAML document without aliases; tags of OpenCV are left out."""
    import yaml

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("it holds an alias")
            return super().compose_node(parent, index)

    def without_tag(loader: yaml.SafeLoader, suffix: str, node: yaml.Node) -> Any:
        if not isinstance(node, yaml.MappingNode):
            raise yaml.YAMLError(f"the tag {suffix}")
        return loader.construct_mapping(node, deep=True)

    Loader.add_multi_constructor("tag:yaml.org,2002:opencv-", without_tag)
    # OpenCV writes the version as %YAML:1.0, which is no directive of YAML.
    text = re.sub(r"\A%YAML:?\s*[\d.]+\s*\n", "", source.text)
    try:
        return yaml.load(text, Loader)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise InputError(f"{source.path}: is not YAML ({reason(error)})") from None


def _xml(source: CameraSource) -> Any:
    """The values of an ``opencv_storage``; nothing outside the file is read."""
    from xml.etree import ElementTree

    if re.search(r"<!(DOCTYPE|ENTITY)", source.text):
        raise InputError(f"{source.path}: declares a document type, expected plain XML")
    try:
        root = ElementTree.fromstring(source.text.encode())
    except ElementTree.ParseError as error:
        raise InputError(f"{source.path}: is not XML ({reason(error)})") from None
    if root.tag != "opencv_storage":
        return None
    return {element.tag: _xml_value(element) for element in root}


def _xml_value(element: Any) -> Any:
    data = element.find("data")
    if data is not None:
        values: dict[str, Any] = {"data": _numbers(data.text)}
        for key in ("rows", "cols"):
            found = element.find(key)
            numbers = [] if found is None else _numbers(found.text)
            if len(numbers) == 1 and isinstance(numbers[0], float) and numbers[0] % 1 == 0:
                values[key] = int(numbers[0])
        return values
    numbers = _numbers(element.text)
    return numbers[0] if len(numbers) == 1 else numbers


def _numbers(text: str | None) -> list[Any]:
    words = (text or "").split()
    try:
        return [float(word) for word in words]
    except ValueError:
        return words
