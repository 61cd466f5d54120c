"""The folder that `tso render` writes: a subfolder per object, with pictures, cameras and points.

    NAME/000.png  NAME/000.mask.png  ...   pictures and masks of the object
    NAME/cameras.json                      camera, image and mask of every view
    NAME/target_16384.ply                  points of the surface; the file name has their number
    NAME/target.ply                        the target: a farthest-point sample of these points
    NAME/render.json                       the settings that the object was made with

NAME may contain "/" (category/name). Points are centred on the bounding box, longest side 1.

The folder .unfinished, next to the objects, holds an object while it is written, and the object
that it replaces. Only one process at a time writes a folder: what is in .unfinished when it begins
was left by a run that was killed.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, TsoError
from ..geometry.arrays import Floats, Pixels
from ..geometry.camera import Camera
from ..io.cameras import CameraRecord, read_cameras, write_cameras
from ..io.clouds import write_cloud
from ..io.images import write_image
from ..io.output import reason, sole_writer, write_file
from . import common
from .items import Dataset, ObjectItem, ViewItem

CAMERAS, TARGET, RECORD = "cameras.json", "target.ply", "render.json"
UNFINISHED = ".unfinished"


def open_rendered(root: Path, strict: bool = False) -> Dataset:
    """The objects of a rendered folder; ``root`` may also be the folder of one object.

    The category of the object CATEGORY/NAME is CATEGORY; an object called NAME has category "".
    """
    skipped, objects = common.Skipped(strict), []
    for name, path, complete in sorted(_walk(root)):
        try:
            if not complete:
                raise InputError(
                    f"{path / TARGET}: does not exist, expected the points of this object"
                )
            category = name.split("/")[0] if "/" in name else ""
            views = common.LazyViews(len(_records(path)), partial(_view, str(path)))
            target = partial(common.cloud_target, str(path / TARGET))
            objects.append(ObjectItem(name, category, views, target))
        except InputError as error:
            skipped.add(name, str(error))
    expected = f"NAME/{CAMERAS} and so on as tso render writes them"
    return common.finished(objects, root.resolve().name, skipped, expected)


def holds_object(folder: Path) -> bool:
    """Whether `tso render` wrote an object into ``folder`` or below."""
    return next(_walk(folder), None) is not None


def stored_record(folder: Path) -> dict[str, Any] | None:
    """The settings of the object in ``folder``; None if there is no such folder.

    Raises InputError if the folder holds anything else.
    """
    if not folder.exists():
        return None
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        record = None
    if not isinstance(record, dict):
        raise InputError(
            f"{folder}: exists and is not an object that tso render wrote, "
            "expected another output folder"
        )
    return record


@contextmanager
def writing(root: Path) -> Iterator[ObjectWriter]:
    """Be the only process that writes objects into the folder ``root``.

    What a killed run left is removed. If it was replacing an object, the old object is put back.
    Raises InputError if another process is writing into the folder.
    """
    with sole_writer(root):
        writer = ObjectWriter(root)
        writer.clear()
        try:
            yield writer
        finally:
            writer.clear()


@dataclass(frozen=True)
class ObjectWriter:
    """Writes the objects of the folder ``root``, whole or not at all."""

    root: Path

    def write(
        self,
        name: str,
        views: Sequence[tuple[Pixels, Pixels, Camera]],
        samples: Floats,
        target: Floats,
        record: dict[str, Any],
    ) -> None:
        """Write one object; it replaces an object of the same name.

        ``views`` are images [H, W, 3], masks [H, W] and cameras. Raises TsoError if writing fails.
        """
        folder, unfinished = self.root / name, self.root / UNFINISHED
        # Each process has its own name: the system may have no locks.
        new, old = unfinished / f"new.{os.getpid()}", unfinished / "old" / name
        new_folders = [parent for parent in folder.parents if not parent.exists()]
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            new.mkdir(parents=True)
            records = []
            for number, (image, mask, camera) in enumerate(views):
                paths = new / f"{number:03d}.png", new / f"{number:03d}.mask.png"
                write_image(paths[0], image)
                write_image(paths[1], mask)
                records.append(CameraRecord(camera, mask=paths[1], image=paths[0]))
            write_cameras(new / CAMERAS, records)
            write_cloud(
                new / f"target_{len(samples)}.ply", samples.astype(np.float64), dtype="float32"
            )
            write_cloud(new / TARGET, target.astype(np.float64), dtype="float32")
            write_file(new / RECORD, (json.dumps(record, indent=2) + "\n").encode())
            if folder.exists():
                old.parent.mkdir(parents=True)
                folder.rename(old)
            new.rename(folder)
        except OSError as error:
            raise TsoError(f"{folder}: cannot be written ({reason(error)})") from None
        finally:
            self.clear()
            # Folders that hold an object stay: rmdir fails.
            with suppress(OSError):
                for path in new_folders:
                    path.rmdir()

    def clear(self) -> None:
        """Remove unfinished objects, and put back old objects that have not been replaced."""
        replaced = self.root / UNFINISHED / "old"
        for name, path, _ in list(_walk(replaced)):
            if not (self.root / name).exists():
                path.rename(self.root / name)
        shutil.rmtree(self.root / UNFINISHED, ignore_errors=True)


def _records(folder: Path) -> list[CameraRecord]:
    path = folder / CAMERAS
    return _read_records(path, path.stat().st_mtime_ns if path.exists() else 0)


@lru_cache(maxsize=256)
def _read_records(path: Path, changed: int) -> list[CameraRecord]:
    """The views in a camera file; InputError if a view names no image or no mask.

    ``changed`` is the time of the file's last change: a file that has changed is read again.
    """
    records = read_cameras(path)
    for number, record in enumerate(records):
        if record.image is None or record.mask is None:
            missing = "image" if record.image is None else "mask"
            raise InputError(
                f"{path}: views[{number}] names no {missing}, expected one for training"
            )
    return records


def _view(folder: str, index: int) -> ViewItem:
    record = _records(Path(folder))[index]
    assert record.image is not None
    assert record.mask is not None
    size_from = f"as its camera in {CAMERAS}"
    load = partial(common.load_pair, record.image, record.mask, record.camera, size_from)
    return ViewItem(str(record.mask), record.camera, load)


def _walk(folder: Path) -> Iterator[tuple[str, Path, bool]]:
    """Name and folder of every object, and whether it has its target.

    A folder is an object if it holds any of an object's files. Hidden folders hold unfinished
    objects and are left out.
    """
    for path, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        if not {CAMERAS, TARGET, RECORD}.isdisjoint(files):
            inside = Path(path).relative_to(folder).as_posix()
            yield folder.resolve().name if inside == "." else inside, Path(path), TARGET in files
