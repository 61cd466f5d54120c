"""A COLMAP model: a folder with ``cameras`` and ``images``, each as .txt or .bin; or one of them.

A file stands for its folder. ``cameras.txt`` or ``cameras.bin`` alone gives K.

COLMAP has the axes and the pose of OpenCV. Its pixel centres lie at halves.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from ...errors import InputError
from ...geometry.distortion import Distortion
from ..clouds import MODEL_PLACES
from ..guard import reading
from ..reading import is_there, plain, shown
from .record import PartialCamera, matrix_of, of_pixels
from .source import COLMAP_FILES, CameraSource

NEEDS = "cameras and images"

# Number, name and how many parameters, of the models in COLMAP's models.h.
_MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5),
    4: ("OPENCV", 8), 5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4), 9: ("RADIAL_FISHEYE", 5), 10: ("THIN_PRISM_FISHEYE", 12),
}  # fmt: skip
_COUNTS = dict(_MODELS.values())
UNDONE = tuple(name for name in _COUNTS if name not in ("FOV", "THIN_PRISM_FISHEYE"))
_ONE_FOCAL = (
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
)


Lens = tuple[int, str, float, float, list[float]]
"""A row of ``cameras``: number, model, width, height and parameters."""
Image = tuple[object, list[float], int, str]
"""A row of ``images``: number, quaternion and t, number of the camera, name."""


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
    if model is None:
        if source.is_folder or (path.name in COLMAP_FILES and path.stem != "cameras"):
            raise InputError(
                f"{path}: is a part of a COLMAP model, expected its folder with cameras and images "
                "(.bin or .txt)"
            )
        return list(_lenses(path).values())
    lenses, images = _lenses(model.cameras), CameraSource(model.images)
    views = []
    with reading(images, f"a whole file, and cameras of {model.cameras.name}"):
        rows = _images_of_binary if model.images.suffix == ".bin" else _images_of_text
        for number, pose, camera, name in rows(images):
            images.place = f"image {number}: "
            R = images.quaternion("quaternion", pose[:4])
            t, lens = images.matrix("t", pose[4:], (3,)), lenses[f"camera {camera}"]
            image = _picture(model.images.parent, name) if name.isprintable() and name else None
            names = () if image is None else (name,)
            views.append(replace(lens, title=images.title, R=R, t=t, image=image, names=names))
            images.place = ""
    return views


def _lenses(path: Path) -> dict[str, PartialCamera]:
    """The title of a camera, such as "camera 1" -> its K, size and lens."""
    source, lenses = CameraSource(path), {}
    with reading(source, "a number, a lens model, width, height and parameters of each camera"):
        rows = _lenses_of_binary if path.suffix == ".bin" else _lenses_of_text
        for number, model, width, height, values in rows(source):
            source.place = f"camera {number}: "
            if model not in UNDONE:
                raise source.error(
                    "the lens model",
                    plain(model),
                    f"one of {', '.join(UNDONE)}; undistort the pictures: colmap image_undistorter",
                )
            size = source.pixels("", width, height)
            parameters = source.matrix("parameters", values, (_COUNTS[model],)).tolist()
            both = parameters[:1] if model in _ONE_FOCAL else []
            fx, fy, cx, cy, *rest = both + parameters
            K = of_pixels(matrix_of(fx, fy, cx, cy, corner=True), size)
            fisheye = "FISHEYE" in model
            lens = Distortion("equidistant" if fisheye else "radial-tangential", tuple(rest))
            lenses[source.title] = PartialCamera(source.title, K, size=size, distortion=lens)
            source.place = ""
    return lenses


def _model_in(folder: Path, places: tuple[str, ...] = MODEL_PLACES) -> _Model | None:
    """The files of the model in one of the ``places``; COLMAP too reads binary ones first."""
    pairs = [(".bin", ".bin"), (".txt", ".txt"), (".bin", ".txt"), (".txt", ".bin")]
    for below in places:
        for cameras, images in pairs:
            model = _Model(folder / below / f"cameras{cameras}", folder / below / f"images{images}")
            if all(file.is_file() for file in model):
                return model
    return None


def _picture(folder: Path, name: str) -> Path:
    """The file of a picture, whose name is relative to a folder that the model does not say."""
    plain_name = name.replace("\\", "/")
    places = (folder / above / "images" / plain_name for above in ("", "..", "../.."))
    return next((file for file in places if is_there(file)), folder / plain_name)


def _lenses_of_text(source: CameraSource) -> Iterator[Lens]:
    for words in source.words:
        source.place = f"camera {plain(words[0])}: "
        number, model, width, height, *values = words
        yield int(number), model, float(width), float(height), [float(value) for value in values]


def _lenses_of_binary(source: CameraSource) -> Iterator[Lens]:
    (count,), start = struct.unpack_from("<Q", source.data), 8
    for _ in range(count):
        number, model, width, height = struct.unpack_from("<iiQQ", source.data, start)
        name = _MODELS[model][0] if model in _MODELS else f"number {model}"
        values = struct.unpack_from(f"<{_COUNTS.get(name, 0)}d", source.data, start + 24)
        start += 24 + 8 * len(values)
        yield number, name, width, height, list(values)


def _images_of_text(source: CameraSource) -> Iterator[Image]:
    # Two lines of each image: its pose, and its points, which may be an empty line.
    lines = (line for line in source.text.splitlines() if not line.lstrip().startswith("#"))
    for line in lines:
        if not line.strip():
            continue
        title, points = plain(line.split()[0]), next(lines, "")
        words = points.split()
        # The next image, where the lines of points are left out, ends in a name.
        if words and (len(words) % 3 or not _is_number(words[-1])):
            raise source.error(
                f"the line after image {title}",
                shown(points[:60]),
                "its points X Y POINT3D_ID, or an empty line",
            )
        source.place = f"image {title}: "
        _, *pose, camera, name = line.split(maxsplit=9)
        yield title, [float(word) for word in pose], int(camera), name.strip()


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _images_of_binary(source: CameraSource) -> Iterator[Image]:
    data = source.data
    (count,), start = struct.unpack_from("<Q", data), 8
    for _ in range(count):
        number, *pose, camera = struct.unpack_from("<i7di", data, start)
        end = data.find(b"\0", start + 64)
        if end < 0:
            raise IndexError
        (points,) = struct.unpack_from("<Q", data, end + 1)
        yield number, pose, camera, data[start + 64 : end].decode("utf-8", "replace")
        start = end + 9 + 24 * points
        if start > len(data):
            raise IndexError
