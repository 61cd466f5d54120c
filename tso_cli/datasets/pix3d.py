"""Pix3D (Sun et al., 2018): photos with masks, aligned models and cameras.

    ROOT/pix3d.json    a list of entries with img, mask, model (paths below ROOT), category,
                       img_size [width, height], rot_mat, trans_mat, focal_length, truncated,
                       occluded, slightly_occluded, and more that is not used

Facts about the data, from its README, its rendering script and the answers of its authors:

- X = rot_mat x + trans_mat takes a point x of the model to axes with x to the left, y up and z into
  the picture. The camera stands at the origin and looks along +z. In OpenCV axes that is
  X_camera = diag(-1, -1, 1) X.
- focal_length is in mm, for a sensor that is 32 mm wide: f = focal_length / 32 times the width of
  the picture. The principal point is the middle of the picture.

The frame of an object here is the frame of its model, centred on the bounding box of its faces and
scaled to longest side 1. The cameras are changed to match: a model is read when one of its views or
its target is needed. An entry whose object is partly outside the picture or hidden is left out,
since its mask is not the silhouette of the object.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ..errors import InputError, prefixed
from ..geometry.arrays import Array, Floats, Indices, Pixels
from ..geometry.camera import Camera
from ..geometry.points import bounding_box_normalisation
from ..io.cameras.of_pix3d import SENSOR_WIDTH
from ..io.cameras.record import PYTORCH3D, of_widths
from ..io.meshes import read_mesh
from ..io.reading import read_json, shown
from . import common
from .items import Dataset, ObjectItem, ViewItem

TABLE = "pix3d.json"
PARTLY_SEEN = ("truncated", "occluded", "slightly_occluded")


@dataclass(frozen=True)
class _Entry:
    """One photo, and its camera for points in the model's own coordinates."""

    image: str
    mask: str
    model: str
    category: str
    camera: Camera


def open_pix3d(root: Path, strict: bool = False) -> Dataset:
    """The objects of Pix3D, named after their models, CATEGORY/FOLDER/FILE; every photo is a view.

    No picture and no model is read yet. Entries whose object is partly outside the picture or
    hidden are left out even with ``strict``.
    """
    table = root / TABLE
    document = read_json(table, "the entries of Pix3D", "the entries of Pix3D")
    if not isinstance(document, list):
        raise InputError(f"{table}: holds a {type(document).__name__}, expected a list of entries")
    skipped, exists = common.Skipped(strict), lru_cache(maxsize=None)(Path.is_file)
    entries: dict[str, list[_Entry]] = {}
    for number, values in enumerate(document):
        title = _title(values, number)
        where = f"{table}: entry {number} ({title})"
        try:
            entry = _entry(values, where)
            for path in (entry.image, entry.mask, entry.model):
                if not exists(root / path):
                    raise InputError(
                        f"{root / path}: does not exist, expected it as {where} names it"
                    )
            flags = [flag for flag in PARTLY_SEEN if values.get(flag) in (True, "true", "True")]
            if flags:
                skipped.reasons[title] = f"{where}: the object is {flags[0].replace('_', ' ')}"
            else:
                entries.setdefault(_name(entry.model, entry.category), []).append(entry)
        except InputError as error:
            skipped.add(title, str(error))
    objects = []
    for name, photos in entries.items():
        views = common.LazyViews(len(photos), partial(_view, str(root), photos))
        target = partial(_target, str(root / photos[0].model))
        objects.append(ObjectItem(name, photos[0].category, views, target))
    description = f"{root.resolve().name} (Pix3D)"
    return common.finished(objects, description, skipped, "entries with img, mask and model")


def _entry(values: Any, where: str) -> _Entry:
    if not isinstance(values, dict):
        raise InputError(
            f"{where}: is a {type(values).__name__}, "
            "expected an object with img, mask, model and so on"
        )
    image, mask, model, category = (
        _text(values, key, where) for key in ("img", "mask", "model", "category")
    )
    width, height = (int(side) for side in _numbers(values, "img_size", (2,), where, whole=True))
    focal = float(_numbers(values, "focal_length", (), where)) / SENSOR_WIDTH
    K = of_widths(focal)(width, height)
    R = PYTORCH3D @ _numbers(values, "rot_mat", (3, 3), where)
    t = PYTORCH3D @ _numbers(values, "trans_mat", (3,), where)
    with prefixed(f"{where}: "):
        camera = Camera(K, R, t, width, height)
    return _Entry(image, mask, model, category, camera)


def _text(values: dict[str, Any], key: str, where: str) -> str:
    text = values.get(key)
    if not isinstance(text, str) or not text or not text.isprintable():
        raise InputError(f"{where}: {key} is {shown(text)}, expected a text")
    return text


def _numbers(
    values: dict[str, Any], key: str, shape: tuple[int, ...], where: str, whole: bool = False
) -> Array:
    try:
        array = np.array(values[key], dtype=np.float64)
    except (KeyError, TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    fits = array.shape == shape and bool(np.isfinite(array).all())
    if not fits or (whole and ((array < 1) | (array % 1 != 0) | (array > 1e6)).any()):
        kind = "whole numbers, 1 or more" if whole else "finite numbers"
        size = f"{' x '.join(map(str, shape))} {kind}" if shape else "a finite number"
        raise InputError(f"{where}: {key} is {shown(values.get(key, 'missing'))}, expected {size}")
    return array


def _title(values: Any, number: int) -> str:
    name = values.get("img") if isinstance(values, dict) else None
    return name if isinstance(name, str) and name.isprintable() and name else f"entry {number}"


def _name(path: str, category: str) -> str:
    """CATEGORY/... from the path of a model or picture, without the folder before the category."""
    parts = PurePosixPath(path).with_suffix("").parts
    parts = parts[parts.index(category) :] if category in parts else (category, *parts)
    return "/".join(parts)


def _read(path: str) -> tuple[Array, Indices]:
    mesh = read_mesh(Path(path), textures=False)
    return mesh.vertices, mesh.faces


@lru_cache(maxsize=4096)
def _normalisation(path: str) -> tuple[Array, float]:
    """Centre and scale of a model."""
    vertices, faces = _read(path)
    return bounding_box_normalisation(vertices[np.unique(faces)], path)


def _target(path: str) -> Floats:
    vertices, faces = _read(path)
    centre, scale = _normalisation(path)
    return common.surface_target((vertices - centre) / scale, faces)


def _view(root: str, photos: list[_Entry], index: int) -> ViewItem:
    entry = photos[index]
    image, mask, model = (Path(root) / path for path in (entry.image, entry.mask, entry.model))
    try:
        camera = entry.camera.for_normalised(*_normalisation(str(model)))
    except InputError as error:
        return ViewItem(str(image), entry.camera, partial(_fail, str(error)))
    load = partial(common.load_pair, image, mask, camera, f"as {TABLE} says")
    return ViewItem(str(image), camera, load)


def _fail(message: str) -> tuple[Pixels, Floats]:
    raise InputError(message)
