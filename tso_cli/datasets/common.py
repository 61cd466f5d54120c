"""What the readers of data sets share: lazy views, tables of cameras, targets, skipped objects."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array, Floats, Indices, Pixels
from ..geometry.camera import Camera
from ..geometry.points import farthest_point_sample, sample_surface
from ..io.clouds import read_cloud
from ..io.images import read_image
from ..io.masks import read_mask
from ..io.output import reason
from ..io.reading import read_bytes, shown
from .items import Dataset, ObjectItem, ViewItem

# As in the paper: points to draw from a surface, and the points that farthest-point sampling keeps.
SAMPLES, POINTS = 16384, 1024
CLOUD_FOLDERS = ("ShapeNet_pcl", "ShapeNet_v1_pcl")
CLOUD = "pcl_1024_fps_trimesh.npy"
# ShapeNet numbers its categories as WordNet does. The rendered data sets have these 13.
SYNSETS = {
    "02691156": "airplane", "02828884": "bench", "02933112": "cabinet", "02958343": "car",
    "03001627": "chair", "03211117": "display", "03636649": "lamp", "03691459": "speaker",
    "04090263": "rifle", "04256520": "sofa", "04379243": "table", "04401088": "telephone",
    "04530566": "watercraft",
}  # fmt: skip
TABLE_LIMIT = 1 << 24  # bytes of a text file with the cameras or names of one object


class LazyViews(Sequence[ViewItem]):
    """``count`` views; ``build`` makes a view when it is needed.

    A data set may have a million pictures.
    """

    __slots__ = ("_build", "_count")

    def __init__(self, count: int, build: Callable[[int], ViewItem]) -> None:
        self._count, self._build = count, build

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> ViewItem:  # type: ignore[override]
        return self._build(range(self._count)[index])


class Skipped:
    """Collects what is left out, and why; with ``strict`` it raises InputError instead."""

    def __init__(self, strict: bool) -> None:
        self.strict = strict
        self.reasons: dict[str, str] = {}

    def add(self, item: str, why: str) -> None:
        if self.strict:
            raise InputError(why)
        self.reasons[item] = why


def finished(
    objects: list[ObjectItem], description: str, skipped: Skipped, expected: str
) -> Dataset:
    """The data set; InputError, which says what was ``expected``, if it has no object."""
    if not objects:
        reasons = list(skipped.reasons.values())
        if reasons:
            raise InputError(f"{description}: no object can be used, the first: {reasons[0]}")
        raise InputError(f"{description}: holds no object, expected {expected}")
    return Dataset(sorted(objects, key=lambda item: item.name), description, skipped.reasons)


def listed(folder: Path) -> tuple[list[str], set[str]]:
    """The names of the folders (sorted) and of the files in ``folder``, without hidden ones.

    Raises InputError if the folder cannot be read.
    """
    try:
        with os.scandir(folder) as entries:
            kinds = {
                entry.name: entry.is_dir() for entry in entries if not entry.name.startswith(".")
            }
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder}: cannot be listed ({reason(error)}), expected a folder"
        ) from None
    folders = sorted(name for name, is_folder in kinds.items() if is_folder)
    return folders, kinds.keys() - set(folders)


class Picture(NamedTuple):
    """A picture of a model."""

    file: str
    row: Array  # [1, columns], the picture's row in the table of cameras
    problem: str  # why the picture cannot be used, "" if it can
    sized_by: str  # the file whose size is the size of the view


class Targets(NamedTuple):
    """Where the points of models are: the files ``folder``/SYNSET/MODEL/``file``."""

    folder: Path
    file: str
    read: Callable[[str], Floats]  # path -> points


@dataclass(frozen=True)
class ModelLayout:
    """A layout of folders that has the pictures of each model in SYNSET/MODEL.

    pictures : folder of a model -> its pictures; InputError if the model cannot be used.
    view : folder of a model, file of a picture, its row, size (width, height) -> the view.
    """

    title: str
    expected: str
    pictures: Callable[[Path], list[Picture]]
    view: Callable[[Path, str, list[float], tuple[int, int]], ViewItem]
    subfolder: str = ""  # folder inside the model's folder that has the pictures
    not_a_category: str = ""  # a folder that is where the categories are


def open_models(
    name: str, folder: Path, layout: ModelLayout, targets: Targets | None, strict: bool
) -> Dataset:
    """The data set ``name`` of the models in ``folder``.

    What cannot be used is skipped; with ``strict`` it is an InputError. All pictures of a category
    must have the size of the category's first readable picture: no other picture is opened here. A
    model without its 3D file keeps its views, since masks are enough to train on.
    """
    skipped, objects = Skipped(strict), []
    for category in listed(folder)[0]:
        usable: dict[str, list[Picture]] = {}
        models = listed(folder / category)[0] if category != layout.not_a_category else []
        for model in (f"{category}/{model}" for model in models):
            try:
                place = folder / model / layout.subfolder
                usable[model] = _usable(model, place, layout, skipped)
            except InputError as error:
                skipped.add(model, str(error))
        size = _first_size(
            folder / model / layout.subfolder / picture.sized_by
            for model in usable
            for picture in usable[model]
        )
        for model, pictures in usable.items():
            if size is None:
                skipped.add(model, f"{folder / model}: no picture of the category can be read")
                continue
            # Every folder has the same few names: interned, each of them is stored once.
            files = [sys.intern(picture.file) for picture in pictures]
            rows = np.concatenate([picture.row for picture in pictures])
            place = folder / model / layout.subfolder
            views = LazyViews(len(files), partial(_view, layout, str(place), files, rows, size))
            objects.append(
                ObjectItem(model, SYNSETS.get(category, category), views, *_target(model, targets))
            )
    return finished(objects, f"{name} ({layout.title})", skipped, layout.expected)


def _usable(model: str, folder: Path, layout: ModelLayout, skipped: Skipped) -> list[Picture]:
    pictures, usable = layout.pictures(folder), []
    for picture in pictures:
        if picture.problem:
            skipped.add(f"{model}/{picture.file}", picture.problem)
        else:
            usable.append(picture)
    if not usable:
        raise InputError(f"{folder}: none of its {len(pictures)} pictures can be used")
    return usable


def _view(
    layout: ModelLayout,
    folder: str,
    files: list[str],
    rows: Array,
    size: tuple[int, int],
    index: int,
) -> ViewItem:
    return layout.view(Path(folder), files[index], rows[index].tolist(), size)


def _target(model: str, targets: Targets | None) -> tuple[Callable[[], Floats] | None, str]:
    """``target`` and ``lacking`` of the `ObjectItem` of a model."""
    if targets is None:
        return None, ""
    path = targets.folder / model / targets.file
    if not path.is_file():
        return None, f"{path}: does not exist, expected the shape of this object"
    return partial(targets.read, str(path)), ""


def find_clouds(pictures: Path) -> Targets | None:
    """The point clouds in a folder next to the folder ``pictures``, if there are any."""
    for name in CLOUD_FOLDERS:
        if (folder := pictures.parent / name).is_dir():
            return Targets(folder, CLOUD, cloud_target)
    return None


def read_table(path: Path, least: int, most: int, what: str) -> Array:
    """A text file with ``least`` to ``most`` numbers per line: [rows, most], NaN if one is missing.

    Raises InputError, which says ``what`` the numbers are, if the file is anything else.
    """
    text = read_bytes(path, what, limit=TABLE_LIMIT).decode("utf-8", "replace")
    rows = []
    for number, line in enumerate(text.rstrip().splitlines(), 1):
        words = line.split()[:most]
        if len(words) < least:
            raise InputError(
                f"{path}: line {number} has {len(words)} numbers, expected {least} or more: {what}"
            )
        row = [math.nan] * most
        for column, word in enumerate(words):
            try:
                row[column] = float(word)
            except ValueError:
                row[column] = math.nan
            if not math.isfinite(row[column]):
                raise InputError(f"{path}: line {number} has {shown(word)}, expected {what}")
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(-1, most)


def _first_size(paths: Iterable[Path]) -> tuple[int, int] | None:
    """Width and height of the first picture that can be read; None if none can be read."""
    for path in paths:
        with suppress(InputError):
            height, width = read_image(path).shape[:2]
            return width, height
    return None


def require_size(path: Path, pixels: NDArray[np.generic], camera: Camera, expected: str) -> None:
    """Raise InputError unless ``pixels`` [H, W, ...], read from ``path``, have the camera's size.

    ``expected`` says where that size comes from, such as "as the first picture".
    """
    height, width = pixels.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"{path}: is {width}x{height}, expected {camera.width}x{camera.height} {expected}"
        )


def load_pair(
    image_path: Path, mask_path: Path, camera: Camera, expected: str
) -> tuple[Pixels, Floats]:
    """Image [H, W, 3] and mask [H, W] in two files; InputError as `require_size`."""
    image, mask = read_image(image_path)[..., :3], read_mask(mask_path)
    require_size(image_path, image, camera, expected)
    require_size(mask_path, mask, camera, expected)
    return image, mask


def surface_target(vertices: Array, faces: Indices) -> Floats:
    """Points [POINTS, 3] spread over a surface; each call returns the same points."""
    samples = sample_surface(vertices, faces, SAMPLES, np.random.default_rng(0))
    return samples[farthest_point_sample(samples, POINTS)].astype(np.float32)


def cloud_target(path: str) -> Floats:
    """The points of a cloud file [P, 3], in its own frame and scale."""
    return read_cloud(path).points.astype(np.float32)
