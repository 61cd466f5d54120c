"""What the readers of data sets share: lazy views, folders, tables of cameras, targets, and a list of what was left out."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.camera import Camera
from ..geometry.points import Array, farthest_point_sample, sample_surface
from ..io.images import read_image
from ..io.output import reason
from ..io.reading import read_bytes, shown
from .items import Dataset, Floats, ObjectItem, ViewItem

Known = TypeVar("Known")
"""What a reader knows of the views of one model."""
Progress = Callable[[int, int, str], None]
"""Called with how much is done, of how much, and a note."""

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
    """Views made when they are asked for: a data set of a million pictures keeps only what ``build`` needs.

    Parameters
    ----------
    count : how many.
    build : gives view number i, 0 <= i < count.
    """

    __slots__ = ("_build", "_count")

    def __init__(self, count: int, build: Callable[[int], ViewItem]) -> None:
        self._count, self._build = count, build

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> ViewItem: ...
    @overload
    def __getitem__(self, index: slice) -> list[ViewItem]: ...
    def __getitem__(self, index: int | slice) -> ViewItem | list[ViewItem]:
        if isinstance(index, slice):
            return [self._build(i) for i in range(*index.indices(self._count))]
        if not -self._count <= index < self._count:
            raise IndexError(f"view {index} of {self._count}")
        return self._build(index % self._count)


class Skipped:
    """Collects what is left out; with ``strict`` the first such thing is an InputError."""

    def __init__(self, strict: bool) -> None:
        self.strict = strict
        self.reasons: dict[str, str] = {}

    def add(self, item: str, why: str) -> None:
        """Note that ``item`` cannot be used; ``why`` is one line that names the file."""
        if self.strict:
            raise InputError(why)
        self.reasons[item] = why


def finished(objects: list[ObjectItem], description: str, skipped: Skipped, expected: str) -> Dataset:
    """The data set; InputError saying what was ``expected`` if it has no object."""
    if not objects:
        first = next(iter(skipped.reasons.values()), None)
        found = f"no object can be used, the first: {first}" if first else f"holds no object, expected {expected}"
        raise InputError(f"{description}: {found}")
    return Dataset(sorted(objects, key=lambda item: item.name), description, skipped.reasons)


def listed(folder: Path) -> tuple[list[str], set[str]]:
    """Names of the folders, sorted, and of the files in ``folder``; hidden ones are left out. InputError if unreadable."""
    try:
        with os.scandir(folder) as entries:
            seen = [(entry.name, entry.is_dir()) for entry in entries if not entry.name.startswith(".")]
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: cannot be listed ({reason(error)}), expected a folder") from None
    return sorted(name for name, is_folder in seen if is_folder), {name for name, is_folder in seen if not is_folder}


def require_folder(folder: Path, what: str) -> None:
    """InputError unless ``folder`` is one; ``what`` is expected there."""
    if not folder.is_dir():
        raise InputError(f"{folder}: {'is a file' if folder.exists() else 'does not exist'}, expected {what}")


def models_in(folder: Path, apart_from: str = "") -> list[tuple[str, list[str]]]:
    """Category folders of ``folder``, each with the names of its model folders, all sorted."""
    return [(category, listed(folder / category)[0]) for category in listed(folder)[0] if category != apart_from]


def objects_of(
    folder: Path,
    skipped: Skipped,
    progress: Progress | None,
    look: Callable[[str], Known],
    pictures: Callable[[str, Known], Iterable[Path]],
    build: Callable[[str, Known, tuple[int, int]], LazyViews],
    shape: Callable[[str], tuple[Path, Callable[[str], Floats]]] | None,
    apart_from: str = "",
) -> list[ObjectItem]:
    """The models of ``folder``/SYNSET/MODEL, named so; those that cannot be used are noted in ``skipped``.

    Parameters
    ----------
    look : what is known of a model's views; InputError where it cannot be used.
    pictures : those of a model whose size is that of all pictures of its category.
    build : views of a model whose pictures are of a size (width, height).
    shape : the 3D file of a model and what reads it; None where the data set has no such files. A model without its file keeps
        its views: masks can teach it.
    apart_from : a folder that is no category.
    """
    objects, done = [], 0
    categories = models_in(folder, apart_from)
    total = sum(len(models) for _, models in categories)
    for category, models in categories:
        found: list[tuple[str, Known]] = []
        for model in models:
            name, done = f"{category}/{model}", done + 1
            try:
                found.append((name, look(name)))
            except InputError as error:
                skipped.add(name, str(error))
            if progress is not None:
                progress(done, total, name)
        size = first_size(path for name, known in found for path in pictures(name, known))
        for name, known in found:
            if size is None:
                skipped.add(name, f"{folder / name}: no picture of the category can be read")
                continue
            objects.append(ObjectItem(name, SYNSETS.get(category, category), build(name, known, size), *_target(name, shape)))
    return objects


def _target(
    name: str, shape: Callable[[str], tuple[Path, Callable[[str], Floats]]] | None
) -> tuple[Callable[[], Floats] | None, str]:
    """What reads the points of a model, or None and, if it should have them, which file is missing."""
    if shape is None:
        return None, ""
    path, read = shape(name)
    if not path.is_file():
        return None, f"{path}: does not exist, expected the shape of this object"
    return partial(read, str(path)), ""


def cloud_folder(beside: Path) -> Path | None:
    """The folder of point clouds that stands beside the pictures, if there is one."""
    return next((beside / name for name in CLOUD_FOLDERS if (beside / name).is_dir()), None)


def read_table(path: Path, least: int, most: int, what: str) -> Array:
    """A text file of numbers, one row a line: [rows, most], with NaN where a line has only ``least`` or a few more.

    Raises InputError naming the line if one has fewer, or a word there is not a finite number.
    """
    text = read_bytes(path, what, limit=_TABLE_LIMIT).decode("utf-8", "replace")
    rows = []
    for number, line in enumerate(text.rstrip().splitlines(), 1):
        words = line.split()[:most]
        if len(words) < least:
            raise InputError(f"{path}: line {number} has {len(words)} numbers, expected {least} or more: {what}")
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


def first_size(paths: Iterable[Path]) -> tuple[int, int] | None:
    """Width and height of the first picture that can be read, None if none can."""
    for path in paths:
        try:
            height, width = read_image(path).shape[:2]
        except InputError:
            continue
        return width, height
    return None


def sized(path: Path, pixels: NDArray[np.generic], camera: Camera, expected: str) -> None:
    """Raise InputError unless ``pixels`` [H, W, ...], read from ``path``, are of the camera's size; ``expected`` says why."""
    height, width = pixels.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise InputError(f"{path}: is {width}x{height}, expected {camera.width}x{camera.height} {expected}")


def surface_target(vertices: Array, faces: NDArray[np.int64]) -> Floats:
    """POINTS points spread over a surface, the same ones each time: [POINTS, 3]."""
    samples = sample_surface(vertices, faces, SAMPLES, np.random.default_rng(0))
    return samples[farthest_point_sample(samples, POINTS)].astype(np.float32)


def cloud_target(path: str) -> Floats:
    """The points of a cloud file [P, 3], in its own frame and scale."""
    from ..io.clouds import read_cloud

    return read_cloud(path).points.astype(np.float32)
