"""The folder that `tso render` writes: one subfolder an object, with pictures, masks, cameras and points.

    NAME/000.png  NAME/000.mask.png  ...   pictures and masks, all of one object
    NAME/cameras.json                      camera, image and mask of every view
    NAME/target_16384.ply                  points of the surface, as many as the name says
    NAME/target.ply                        the farthest-point subset of them that is trained and judged on
    NAME/render.json                       the settings it was made with

NAME may contain "/" (category/name). Points are centred on the bounding box, longest side 1.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from ..errors import InputError, TsoError
from ..files.cameras import CameraRecord, read_cameras, write_cameras
from ..files.clouds import read_cloud, write_cloud
from ..files.images import read_image, read_mask, write_image
from ..files.output import atomic_output, reason

CAMERAS, TARGET, RECORD = "cameras.json", "target.ply", "render.json"
Pixels = NDArray[np.uint8]


class RenderedDataset:
    """Objects of a rendered folder; pictures are read when first asked for and kept while there is room.

    Parameters
    ----------
    folder : as `tso render` wrote it, or one object of it.
    cache_bytes : memory for decoded pictures and masks; the least recently used leave first.

    Raises
    ------
    InputError
        It is not a folder, holds no object, or an object lacks its target.
    """

    def __init__(self, folder: Path | str, cache_bytes: int = 1 << 29) -> None:
        self.folder = Path(folder)
        self._cache = _Cache(cache_bytes)
        self.objects = [RenderedObject(name, path, self._cache) for name, path in _find(self.folder)]

    def __len__(self) -> int:
        return len(self.objects)

    def targets(self) -> NDArray[np.float32]:
        """Targets of all objects, [O, P, 3]; InputError if they differ in their number of points."""
        clouds = [item.target() for item in self.objects]
        for item, cloud in zip(self.objects, clouds, strict=True):
            if len(cloud) != len(clouds[0]):
                raise InputError(
                    f"{item.folder / TARGET}: {len(cloud)} points, expected {len(clouds[0])} as in {self.objects[0].name}"
                )
        return np.stack(clouds)


class RenderedObject:
    """One object: ``name``, ``folder``, its ``views`` and its target."""

    def __init__(self, name: str, folder: Path, cache: _Cache) -> None:
        self.name, self.folder, self._cache = name, folder, cache

    @cached_property
    def views(self) -> list[RenderedView]:
        """All views, in file order. Raises InputError where cameras.json is damaged or lacks an image or mask."""
        path = self.folder / CAMERAS
        views = []
        for number, record in enumerate(read_cameras(path)):
            if record.image is None or record.mask is None:
                missing = "image" if record.image is None else "mask"
                raise InputError(f"{path}: views[{number}] names no {missing}, expected one for training")
            views.append(RenderedView(record.image, record.mask, record.camera, self._cache))
        return views

    def target(self) -> NDArray[np.float32]:
        """Points to learn and to be judged on, [P, 3]."""
        return read_cloud(self.folder / TARGET).points.astype(np.float32)


class RenderedView:
    """One picture: ``image_path``, ``mask_path`` and their ``camera``."""

    def __init__(self, image_path: Path, mask_path: Path, camera: Camera, cache: _Cache) -> None:
        self.image_path, self.mask_path, self.camera, self._cache = image_path, mask_path, camera, cache

    def image(self) -> Pixels:
        """[H, W, 3] uint8, read-only. Raises InputError if unreadable or not of the camera's size."""
        return self._cache.get(self.image_path, lambda: self._checked(self.image_path, read_image(self.image_path)))

    def mask(self) -> NDArray[np.float32]:
        """[H, W] in [0, 1]. Raises InputError if unreadable or not of the camera's size."""
        stored = self._cache.get(
            self.mask_path,
            lambda: self._checked(self.mask_path, np.rint(read_mask(self.mask_path) * 255.0).astype(np.uint8)),
        )
        return stored.astype(np.float32) / np.float32(255.0)

    def _checked(self, path: Path, pixels: Pixels) -> Pixels:
        height, width = pixels.shape[:2]
        if (width, height) != (self.camera.width, self.camera.height):
            raise InputError(
                f"{path}: is {width}x{height}, its camera in {CAMERAS} is for "
                f"{self.camera.width}x{self.camera.height}, expected the same"
            )
        return pixels[..., :3] if pixels.ndim == 3 else pixels


def list_objects(folder: Path | str) -> list[RenderedObject]:
    """Objects of a rendered folder, sorted by name; see RenderedDataset."""
    return RenderedDataset(folder).objects


def stored_record(folder: Path) -> dict[str, Any] | None:
    """The settings that the object in ``folder`` was made with, None where there is no such folder.

    Raises InputError if the folder holds something else.
    """
    if not folder.exists():
        return None
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        record = None
    if not isinstance(record, dict):
        raise InputError(f"{folder}: exists and is not an object that tso render wrote, expected another output folder")
    return record


def write_object(
    folder: Path,
    views: Sequence[tuple[Pixels, Pixels, Camera]],
    samples: NDArray[np.float32],
    target: NDArray[np.float32],
    record: dict[str, Any],
    overwrite: bool = False,
) -> None:
    """Write one object; ``folder`` appears whole or not at all.

    Parameters
    ----------
    views : image [H, W, 3], mask [H, W] and camera of each.
    samples, target : [S, 3] and [P, 3].
    record : the settings, to be found again by `stored_record`.

    Raises
    ------
    InputError
        The folder exists (without ``overwrite``), or is not an object (with it).
    TsoError
        Writing failed.
    """
    token = secrets.token_hex(4)
    partial, old = (folder.with_name(f".{folder.name[:40]}.{token}.{kind}") for kind in ("partial", "old"))
    if stored_record(folder) is not None and not overwrite:
        raise InputError(f"{folder}: exists already, expected a new name or --overwrite")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        partial.mkdir()
        records = []
        for number, (image, mask, camera) in enumerate(views):
            paths = partial / f"{number:03d}.png", partial / f"{number:03d}.mask.png"
            write_image(paths[0], image)
            write_image(paths[1], mask)
            records.append(CameraRecord(camera, mask=paths[1], image=paths[0]))
        write_cameras(partial / CAMERAS, records)
        write_cloud(partial / f"target_{len(samples)}.ply", samples.astype(np.float64), dtype="float32")
        write_cloud(partial / TARGET, target.astype(np.float64), dtype="float32")
        with atomic_output(partial / RECORD) as temporary:
            temporary.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        if folder.exists():
            folder.rename(old)
        partial.rename(folder)
    except OSError as error:
        raise TsoError(f"{folder}: cannot be written ({reason(error)})") from None
    finally:
        if old.exists() and not folder.exists():
            old.rename(folder)
        for path in (partial, old):
            shutil.rmtree(path, ignore_errors=True)


class _Cache:
    """Decoded pictures by path, the most recently used up to ``limit`` bytes."""

    def __init__(self, limit: int) -> None:
        self.limit, self.used = limit, 0
        self._items: OrderedDict[Path, Pixels] = OrderedDict()

    def get(self, path: Path, load: Callable[[], Pixels]) -> Pixels:
        if path in self._items:
            self._items.move_to_end(path)
            return self._items[path]
        pixels: Pixels = np.ascontiguousarray(load())
        pixels.flags.writeable = False
        self._items[path] = pixels
        self.used += pixels.nbytes
        while self.used > self.limit and len(self._items) > 1:
            self.used -= self._items.popitem(last=False)[1].nbytes
        return pixels


def _find(folder: Path) -> list[tuple[str, Path]]:
    """Name and folder of every object, sorted; what is hidden is unfinished and left out."""
    if not folder.is_dir():
        found = "is a file" if folder.exists() else "does not exist"
        raise InputError(f"{folder}: {found}, expected a folder that tso render wrote")
    objects = []
    for path, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        if CAMERAS in files:
            if TARGET not in files:
                raise InputError(f"{Path(path) / TARGET}: does not exist, expected the points of this object")
            inside = Path(path).relative_to(folder).as_posix()
            objects.append((folder.resolve().name if inside == "." else inside, Path(path)))
    if not objects:
        raise InputError(f"{folder}: holds no object, expected NAME/{CAMERAS} and so on as tso render writes them")
    return sorted(objects)
