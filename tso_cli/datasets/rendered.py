"""The folder that `tso render` writes: one subfolder an object, with pictures, masks, cameras and points.

    NAME/000.png  NAME/000.mask.png  ...   pictures and masks, all of one object
    NAME/cameras.json                      camera, image and mask of every view
    NAME/target_16384.ply                  points of the surface, as many as the name says
    NAME/target.ply                        the farthest-point subset of them that is trained and judged on
    NAME/render.json                       the settings it was made with

NAME may contain "/" (category/name). Points are centred on the bounding box, longest side 1.

What is not finished is below .unfinished, beside the objects: an object while it is written, and one that it replaces. One
process at a time writes a folder, so what is there when it begins is of a run that was killed.
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
from numpy.typing import NDArray

from ..errors import InputError, TsoError
from ..geometry.camera import Camera
from ..io.cameras import CameraRecord, read_cameras, write_cameras
from ..io.clouds import write_cloud
from ..io.images import write_image
from ..io.output import reason, sole_writer, write_file
from . import common
from .items import Dataset, ObjectItem, Pixels, ViewItem

CAMERAS, TARGET, RECORD = "cameras.json", "target.ply", "render.json"
UNFINISHED = ".unfinished"


def open_rendered(root: Path, strict: bool = False) -> Dataset:
    """The objects of a rendered folder, or of one object in it; the category of CATEGORY/NAME is CATEGORY, of NAME ""."""
    skipped, objects = common.Skipped(strict), []
    for name, path, complete in sorted(_walk(root)):
        try:
            if not complete:
                raise InputError(
                    f"{path / TARGET}: does not exist, expected the points of this object"
                )
            category = name.split("/")[0] if "/" in name else ""
            views = common.LazyViews(len(_records(path)), partial(_view, str(path)))
            objects.append(
                ObjectItem(name, category, views, partial(common.cloud_target, str(path / TARGET)))
            )
        except InputError as error:
            skipped.add(name, str(error))
    return common.finished(
        objects, root.resolve().name, skipped, f"NAME/{CAMERAS} and so on as tso render writes them"
    )


def holds_object(folder: Path) -> bool:
    """Whether `tso render` wrote an object into ``folder`` or below."""
    return next(_walk(folder), None) is not None


def stored_record(folder: Path) -> dict[str, Any] | None:
    """The settings of the object in ``folder``, None where there is no such folder; InputError if it holds something else."""
    if not folder.exists():
        return None
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        record = None
    if not isinstance(record, dict):
        raise InputError(
            f"{folder}: exists and is not an object that tso render wrote, expected another output folder"
        )
    return record


@contextmanager
def writing(root: Path) -> Iterator[ObjectWriter]:
    """Write objects into the folder ``root``, for as long as this lasts; InputError where another process does.

    What a killed run left is removed, and an object whose replacement it had not finished is put back.
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
        samples: NDArray[np.float32],
        target: NDArray[np.float32],
        record: dict[str, Any],
    ) -> None:
        """Write one object of images [H, W, 3], masks [H, W] and cameras, in place of one that exists; TsoError if it fails."""
        folder, unfinished = self.root / name, self.root / UNFINISHED
        # A name of its own for each process, should the system have no locks.
        new, old = unfinished / f"new.{os.getpid()}", unfinished / "old" / name
        made = [parent for parent in folder.parents if not parent.exists()]
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
            # Those that hold an object stay.
            with suppress(OSError):
                for path in made:
                    path.rmdir()

    def clear(self) -> None:
        """Remove what is not finished, and put back what has not been replaced."""
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
    """The views in a camera file last ``changed`` then; InputError if one lacks its image or mask."""
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
    load = partial(
        common.load_pair, record.image, record.mask, record.camera, f"as its camera in {CAMERAS}"
    )
    return ViewItem(str(record.mask), record.camera, load)


def _walk(folder: Path) -> Iterator[tuple[str, Path, bool]]:
    """Name and folder of every object (it has any file of one), and whether it has its target; hidden ones are unfinished."""
    for path, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        if not {CAMERAS, TARGET, RECORD}.isdisjoint(files):
            inside = Path(path).relative_to(folder).as_posix()
            yield folder.resolve().name if inside == "." else inside, Path(path), TARGET in files
