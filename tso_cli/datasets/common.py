"""What the readers of data sets share: lazy views, tables of cameras, targets, and a list of what was left out."""

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
from ..geometry.camera import Camera
from ..geometry.points import Array, farthest_point_sample, sample_surface
from ..io.clouds import read_cloud
from ..io.images import read_image, read_mask
from ..io.output import reason
from ..io.reading import read_bytes, shown
from .items import Dataset, Floats, ObjectItem, Pixels, ViewItem

Targets = tuple[Path, str, Callable[[str], Floats]]
"""The folder that has SYNSET/MODEL/FILE, FILE, and what reads it."""
View = Callable[[Path, str, list[float], tuple[int, int]], ViewItem]

SAMPLES, POINTS = 16384, 1024
"""Points drawn from a surface, and how many of them farthest-point sampling keeps, as in the paper."""
CLOUD_FOLDERS = ("ShapeNet_pcl", "ShapeNet_v1_pcl")
CLOUD = "pcl_1024_fps_trimesh.npy"
# ShapeNet numbers its categories by WordNet; these are the 13 that the rendered sets have.
SYNSETS = {
    "02691156": "airplane", "02828884": "bench", "02933112": "cabinet", "02958343": "car", "03001627": "chair",
    "03211117": "display", "03636649": "lamp", "03691459": "speaker", "04090263": "rifle", "04256520": "sofa",
    "04379243": "table", "04401088": "telephone", "04530566": "watercraft",
}  # fmt: skip
_TABLE_LIMIT = 1 << 24


class LazyViews(Sequence[ViewItem]):
    """``count`` views that ``build`` makes when they are asked for: a data set may have a million pictures."""

    __slots__ = ("_build", "_count")

    def __init__(self, count: int, build: Callable[[int], ViewItem]) -> None:
        self._count, self._build = count, build

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> ViewItem:  # type: ignore[override]
        return self._build(range(self._count)[index])


class Skipped:
    """Collects what is left out; with ``strict`` the first such thing is an InputError."""

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
    """The data set; InputError saying what was ``expected`` if it has no object."""
    if not objects:
        first = next(iter(skipped.reasons.values()), None)
        what = (
            f"no object can be used, the first: {first}"
            if first
            else f"holds no object, expected {expected}"
        )
        raise InputError(f"{description}: {what}")
    return Dataset(sorted(objects, key=lambda item: item.name), description, skipped.reasons)


def listed(folder: Path) -> tuple[list[str], set[str]]:
    """Names of the folders, sorted, and of the files in ``folder``; hidden ones are left out. InputError if unreadable."""
    try:
        with os.scandir(folder) as entries:
            kinds = {
                entry.name: entry.is_dir() for entry in entries if not entry.name.startswith(".")
            }
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder}: cannot be listed ({reason(error)}), expected a folder"
        ) from None
    return sorted(name for name in kinds if kinds[name]), {
        name for name in kinds if not kinds[name]
    }


class Picture(NamedTuple):
    """A picture of a model."""

    file: str
    row: Array  # of the table of cameras, [1, columns]
    problem: str  # why it cannot be used, "" if it can
    measured: str  # the file whose size is that of the view


@dataclass(frozen=True)
class ModelLayout:
    """A layout with the pictures of each model in SYNSET/MODEL.

    pictures : those in the folder of a model; InputError where the model cannot be used.
    view : from that folder, the file of a picture, its row and the size (width, height).
    """

    title: str
    expected: str
    pictures: Callable[[Path], list[Picture]]
    view: View
    inside: str = ""  # folder inside that of the model
    not_a_category: str = ""  # a folder beside the categories


def open_models(
    name: str, folder: Path, layout: ModelLayout, targets: Targets | None, strict: bool
) -> Dataset:
    """The data set ``name`` of the models in ``folder``; what cannot be used is skipped, or an error with ``strict``.

    All pictures of a category have the size of its first that can be read: no other is opened here. A model without its 3D
    file keeps its views: masks can teach it.
    """
    skipped, objects = Skipped(strict), []
    for category in listed(folder)[0]:
        usable: dict[str, list[Picture]] = {}
        models = listed(folder / category)[0] if category != layout.not_a_category else []
        for model in (f"{category}/{model}" for model in models):
            try:
                usable[model] = _usable(model, folder / model / layout.inside, layout, skipped)
            except InputError as error:
                skipped.add(model, str(error))
        size = _first_size(
            folder / model / layout.inside / picture.measured
            for model in usable
            for picture in usable[model]
        )
        for model, pictures in usable.items():
            if size is None:
                skipped.add(model, f"{folder / model}: no picture of the category can be read")
                continue
            # The same few names in every folder: one string each.
            files, rows = (
                [sys.intern(picture.file) for picture in pictures],
                np.concatenate([p.row for p in pictures]),
            )
            build = partial(
                _view, layout.view, str(folder / model / layout.inside), files, rows, size
            )
            views = LazyViews(len(files), build)
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
    view: View, folder: str, files: list[str], rows: Array, size: tuple[int, int], index: int
) -> ViewItem:
    return view(Path(folder), files[index], rows[index].tolist(), size)


def _target(model: str, targets: Targets | None) -> tuple[Callable[[], Floats] | None, str]:
    """What reads the points of a model, or None and, if it should have them, which file is missing."""
    if targets is None:
        return None, ""
    folder, file, read = targets
    path = folder / model / file
    if not path.is_file():
        return None, f"{path}: does not exist, expected the shape of this object"
    return partial(read, str(path)), ""


def clouds_beside(pictures: Path) -> Targets | None:
    """The point clouds that stand beside the folder of the pictures, if there are any."""
    folders = (pictures.parent / name for name in CLOUD_FOLDERS)
    return next(((folder, CLOUD, cloud_target) for folder in folders if folder.is_dir()), None)


def read_table(path: Path, least: int, most: int, what: str) -> Array:
    """A text file of numbers, ``least`` to ``most`` a line: [rows, most], with NaN for those that a line lacks."""
    text = read_bytes(path, what, limit=_TABLE_LIMIT).decode("utf-8", "replace")
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
    """Width and height of the first picture that can be read, None if none can."""
    for path in paths:
        with suppress(InputError):
            height, width = read_image(path).shape[:2]
            return width, height
    return None


def require_size(path: Path, pixels: NDArray[np.generic], camera: Camera, expected: str) -> None:
    """Raise InputError unless ``pixels`` [H, W, ...], read from ``path``, are of the camera's size; ``expected`` says why."""
    height, width = pixels.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"{path}: is {width}x{height}, expected {camera.width}x{camera.height} {expected}"
        )


def load_pair(
    image_path: Path, mask_path: Path, camera: Camera, expected: str
) -> tuple[Pixels, Floats]:
    """Image [H, W, 3] and mask [H, W] of two files; InputError unless both are of the camera's size."""
    image, mask = read_image(image_path)[..., :3], read_mask(mask_path)
    require_size(image_path, image, camera, expected)
    require_size(mask_path, mask, camera, expected)
    return image, mask


def surface_target(vertices: Array, faces: NDArray[np.int64]) -> Floats:
    """POINTS points spread over a surface, the same ones each time: [POINTS, 3]."""
    samples = sample_surface(vertices, faces, SAMPLES, np.random.default_rng(0))
    return samples[farthest_point_sample(samples, POINTS)].astype(np.float32)


def cloud_target(path: str) -> Floats:
    """The points of a cloud file [P, 3], in its own frame and scale."""
    return read_cloud(path).points.astype(np.float32)
