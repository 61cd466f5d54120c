"""A COLMAP model: a folder with ``cameras`` and ``images``, each as .txt or .bin; or one of them.

A file stands for its folder. ``cameras.txt`` or ``cameras.bin`` alone gives K.

COLMAP has the axes and the pose of OpenCV. Its pixel centres lie at halves.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...geometry.arrays import Array
from ...geometry.distortion import Distortion
from ...geometry.rotations import from_quaternion
from ..clouds import MODEL_PLACES
from ..reading import is_there, plain, shown
from .record import PartialCamera, matrix_of, of_pixels
from .source import COLMAP_FILES, CameraSource

# Number, name and how many parameters, of the models in COLMAP's models.h.
_MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5),
    4: ("OPENCV", 8), 5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4), 9: ("RADIAL_FISHEYE", 5), 10: ("THIN_PRISM_FISHEYE", 12),
}  # fmt: skip
_COUNTS = dict(_MODELS.values())
_ONE_FOCAL = (
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
)


class _Lens(NamedTuple):
    """A row of ``cameras``."""

    size: tuple[int, int]
    K: Array
    distortion: Distortion


class _Model(NamedTuple):
    """The files of a model."""

    cameras: Path
    images: Path


def recognises(source: CameraSource) -> bool:
    if source.is_folder:
        return _model_in(source.path) is not None
    if source.path.name in COLMAP_FILES:
        return True
    if source.container != "text":
        return False
    first = source.words[0] if source.words else []
    return len(first) >= 7 and first[0].isdecimal() and first[1] in _COUNTS


def read(source: CameraSource) -> list[PartialCamera]:
    path, model = source.path, None
    if source.is_folder:
        model = _model_in(path)
    elif path.name in COLMAP_FILES:
        model = _model_in(path.parent, ("",))
    if model is not None:
        binary = model.images.suffix == ".bin"
        return _images_of_binary(model) if binary else _images_of_text(model)
    if source.is_folder:
        raise InputError(
            f"{path}: holds no COLMAP model, expected cameras and images (.bin or .txt) in it or "
            "in sparse/0"
        )
    if path.name in COLMAP_FILES and path.stem != "cameras":
        raise InputError(
            f"{path}: is a part of a COLMAP model, expected its folder with cameras and images"
        )
    # No images: K alone.
    return [_view(source, f"camera {number}", lens, None, None, None)
            for number, lens in _lenses(path).items()]  # fmt: skip


def _model_in(folder: Path, places: tuple[str, ...] = MODEL_PLACES) -> _Model | None:
    """The files of the model in one of the ``places``; COLMAP too reads binary ones first."""
    pairs = [(".bin", ".bin"), (".txt", ".txt"), (".bin", ".txt"), (".txt", ".bin")]
    for below in places:
        for cameras, images in pairs:
            model = _Model(folder / below / f"cameras{cameras}", folder / below / f"images{images}")
            if all(file.is_file() for file in model):
                return model
    return None


def _view(
    source: CameraSource,
    where: str,
    lens: _Lens,
    quaternion: list[float] | None,
    t: list[float] | None,
    name: str | None,
) -> PartialCamera:
    R = None if quaternion is None else _rotation(source, where, quaternion)
    shift = None if t is None else source.matrix(f"{where}: t", t, (3,))
    K, image = of_pixels(lens.K, lens.size), None
    names: tuple[str, ...] = ()
    if name and min(name) >= " ":
        image, names = _picture(source.path.parent, name), (name,)
    return PartialCamera(
        where, K, R, shift, lens.size, distortion=lens.distortion, image=image, names=names
    )


def _picture(folder: Path, name: str) -> Path:
    """The file of a picture, whose name is relative to a folder that the model does not say."""
    plain_name = name.replace("\\", "/")
    places = (folder / above / "images" / plain_name for above in ("", "..", "../.."))
    return next((file for file in places if is_there(file)), folder / plain_name)


def _rotation(source: CameraSource, where: str, quaternion: list[float]) -> Array:
    """[3, 3] of a quaternion w, x, y, z."""
    q = source.matrix(f"{where}: quaternion", quaternion, (4,))
    if np.linalg.norm(q) < 1e-6:
        raise source.error(f"{where}: quaternion", str(q.tolist()), "one of length 1")
    return from_quaternion(*q.tolist())


def _lens(
    source: CameraSource, where: str, model: str, size: tuple[int, int], values: list[float]
) -> _Lens:
    parameters = source.matrix(f"{where}: parameters", values, (_COUNTS[model],)).tolist()
    if model in ("FOV", "THIN_PRISM_FISHEYE"):
        raise InputError(
            f"{source.path}: {where} has the lens model {model}, which tso does not undo; "
            "undistort the pictures: colmap image_undistorter"
        )
    both = parameters[:1] if model in _ONE_FOCAL else []
    fx, fy, cx, cy, *rest = both + parameters
    K = matrix_of(fx, fy, cx, cy, corner=True)
    fisheye = "FISHEYE" in model
    return _Lens(
        size, K, Distortion("equidistant" if fisheye else "radial-tangential", tuple(rest))
    )


def _require_known(source: CameraSource, where: str, model: str) -> None:
    if model not in _COUNTS:
        raise InputError(
            f"{source.path}: {where} has the lens model {shown(model)}, expected one of "
            f"{', '.join(_COUNTS)}; undistort the pictures: colmap image_undistorter"
        )


def _lenses(path: Path) -> dict[int, _Lens]:
    """Number of a camera -> its row."""
    return _lenses_of_binary(path) if path.suffix == ".bin" else _lenses_of_text(path)


def _lenses_of_text(path: Path) -> dict[int, _Lens]:
    source, lenses = CameraSource(path), {}
    for words in source.words:
        try:
            number, model, *values = int(words[0]), *words[1:]
            width, height, *parameters = map(float, values)
        except ValueError:
            raise source.error(
                "a row",
                shown(" ".join(words[:4])),
                "a number, a model, width, height and parameters",
            ) from None
        where = f"camera {number}"
        _require_known(source, where, model)
        size = source.pixels(f"{where}: ", width, height)
        lenses[number] = _lens(source, where, model, size, parameters)
    return lenses


def _images_of_text(model: _Model) -> list[PartialCamera]:
    lenses, source = _lenses(model.cameras), CameraSource(model.images)
    # Two lines of each image: its pose, and its points, which may be an empty line.
    lines = [line for line in source.text.splitlines() if not line.lstrip().startswith("#")]
    views = []
    while lines and not lines[0].strip():
        lines.pop(0)
    for line, points in zip(lines[::2], [*lines[1::2], ""], strict=False):
        words = line.split(maxsplit=9)
        if not words:
            continue
        if len(points.split()) % 3:
            raise source.error(
                f"the line after image {plain(words[0])}", shown(points[:60]),
                "its points X Y POINT3D_ID, or an empty line",
            )  # fmt: skip
        where = f"image {plain(words[0])}"
        try:
            numbers = [float(word) for word in words[1:8]]
            camera, name = int(words[8]), words[9].strip()
        except (ValueError, IndexError):
            raise source.error(
                where,
                shown(" ".join(words[:4])),
                "a quaternion, t, the number of a camera and a name",
            ) from None
        if camera not in lenses:
            raise source.error(f"{where}: camera", str(camera), f"one of {model.cameras.name}")
        views.append(_view(source, where, lenses[camera], numbers[:4], numbers[4:], name))
    return views


class _Binary:
    """Reads numbers of a binary file in their order."""

    def __init__(self, path: Path) -> None:
        self.source, self._at = CameraSource(path), 0

    def take(self, form: str) -> tuple[float, ...]:
        try:
            values = struct.unpack_from("<" + form, self.source.data, self._at)
        except struct.error:
            raise InputError(f"{self.source.path}: ends early, expected a whole file") from None
        self._at += struct.calcsize("<" + form)
        return values

    def name(self) -> str:
        end = self.source.data.find(b"\0", self._at)
        if end < 0:
            raise InputError(f"{self.source.path}: ends early, expected a whole file")
        text = self.source.data[self._at : end].decode("utf-8", "replace")
        self._at = end + 1
        return text

    def skip(self, size: int) -> None:
        self._at += size
        if self._at > len(self.source.data):
            raise InputError(f"{self.source.path}: ends early, expected a whole file")


def _lenses_of_binary(path: Path) -> dict[int, _Lens]:
    cameras, lenses = _Binary(path), {}
    for _ in range(int(cameras.take("Q")[0])):
        number, model, width, height = cameras.take("iiQQ")
        name, count = _MODELS.get(int(model), (f"number {model}", 0))
        where = f"camera {number}"
        _require_known(cameras.source, where, name)
        size = cameras.source.pixels(f"{where}: ", width, height)
        parameters = list(cameras.take(f"{count}d"))
        lenses[int(number)] = _lens(cameras.source, where, name, size, parameters)
    return lenses


def _images_of_binary(model: _Model) -> list[PartialCamera]:
    lenses, images, views = _lenses(model.cameras), _Binary(model.images), []
    for _ in range(int(images.take("Q")[0])):
        number, *pose, camera = images.take("i7di")
        name = images.name()
        images.skip(24 * int(images.take("Q")[0]))
        where = f"image {number}"
        if camera not in lenses:
            raise images.source.error(
                f"{where}: camera", str(camera), f"one of {model.cameras.name}"
            )
        views.append(_view(images.source, where, lenses[int(camera)], pose[:4], pose[4:], name))
    return views
