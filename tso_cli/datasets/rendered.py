"""The folder that `tso render` writes: one subfolder an object, with pictures, masks, cameras and points.

    NAME/000.png  NAME/000.mask.png  ...   pictures and masks, all of one object
    NAME/cameras.json                      camera, image and mask of every view
    NAME/target_16384.ply                  points of the surface, as many as the name says
    NAME/target.ply                        the farthest-point subset of them that is trained and judged on
    NAME/render.json                       the settings it was made with

NAME may contain "/" (category/name). Points are centred on the bounding box, longest side 1.

While an object is written it is .NAME.xxxxxxxx.partial, and one that it replaces .NAME.xxxxxxxx.old, beside NAME. The process
that writes locks both: what is there without a lock is of a run that was killed, and the next run sweeps it away.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
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
from ..io.output import atomic_output, lock, reason
from . import common
from .items import Dataset, ObjectItem, Pixels, ViewItem

CAMERAS, TARGET, RECORD = "cameras.json", "target.ply", "render.json"
_LEFT = re.compile(r"\.(.{1,40})\.[0-9a-f]{8}\.(partial|old)", re.DOTALL)


def open_rendered(folder: Path | str, strict: bool = False) -> Dataset:
    """The objects of a rendered folder, or of one object in it; the category of CATEGORY/NAME is CATEGORY, of NAME ""."""
    root = Path(folder)
    common.require_folder(root, "one that tso render wrote")
    skipped, objects = common.Skipped(strict), []
    for name, path, complete in sorted(_walk(root)):
        try:
            if not complete:
                raise InputError(f"{path / TARGET}: does not exist, expected the points of this object")
            category = name.split("/")[0] if "/" in name else ""
            views = common.LazyViews(len(_records(path)), partial(_view, str(path)))
            objects.append(ObjectItem(name, category, views, partial(common.cloud_target, str(path / TARGET))))
        except InputError as error:
            skipped.add(name, str(error))
    return common.finished(objects, root.resolve().name, skipped, f"NAME/{CAMERAS} and so on as tso render writes them")


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
    """Write one object of images [H, W, 3], masks [H, W] and cameras; ``folder`` appears whole or not at all.

    Raises InputError if it exists (without ``overwrite``) or is not an object (with it), TsoError if writing failed.
    """
    token = os.urandom(4).hex()
    staging, old = (folder.with_name(f".{folder.name[:40]}.{token}.{kind}") for kind in ("partial", "old"))
    if stored_record(folder) is not None and not overwrite:
        raise InputError(f"{folder}: exists already, expected a new name or --overwrite")
    made, locks = [parent for parent in folder.parents if not parent.exists()], []
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        staging.mkdir()
        locks.append(lock(staging))
        records = []
        for number, (image, mask, camera) in enumerate(views):
            paths = staging / f"{number:03d}.png", staging / f"{number:03d}.mask.png"
            write_image(paths[0], image)
            write_image(paths[1], mask)
            records.append(CameraRecord(camera, mask=paths[1], image=paths[0]))
        write_cameras(staging / CAMERAS, records)
        write_cloud(staging / f"target_{len(samples)}.ply", samples.astype(np.float64), dtype="float32")
        write_cloud(staging / TARGET, target.astype(np.float64), dtype="float32")
        with atomic_output(staging / RECORD) as temporary:
            temporary.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        if folder.exists():
            locks.append(lock(folder))
            folder.rename(old)
        staging.rename(folder)
    except OSError as error:
        raise TsoError(f"{folder}: cannot be written ({reason(error)})") from None
    finally:
        if old.exists() and not folder.exists():
            old.rename(folder)
        for path in (staging, old):
            shutil.rmtree(path, ignore_errors=True)
        # Those that hold an object stay.
        with suppress(OSError):
            for path in made:
                path.rmdir()
        for held in locks:
            if held is not None:
                os.close(held)


def sweep(folders: Iterable[Path]) -> None:
    """Remove what killed runs left of the objects ``folders``, and put back one whose replacement was not finished.

    What a living process writes stays; where the system has no locks, everything does.
    """
    names: dict[Path, dict[str, list[Path]]] = {}
    for folder in folders:
        names.setdefault(folder.parent, {}).setdefault(folder.name[:40], []).append(folder)
    for parent, objects in names.items():
        for path in sorted(parent.glob(".*")):
            match = _LEFT.fullmatch(path.name)
            if match is None or match[1] not in objects or path.is_symlink() or (held := lock(path)) is None:
                continue
            # Names longer than 40 characters may begin alike.
            replaced = objects[match[1]][0] if len(objects[match[1]]) == 1 else None
            # Another run may sweep too.
            with suppress(OSError):
                # Its writer has made it but may not have locked it yet.
                fresh = not any(path.iterdir()) and time.time() - path.stat().st_mtime < 60.0
                if match[2] == "old" and replaced is not None and not replaced.exists():
                    path.rename(replaced)
                elif not fresh and (match[2] == "partial" or replaced is not None):
                    shutil.rmtree(path, ignore_errors=True)
            os.close(held)


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
            raise InputError(f"{path}: views[{number}] names no {missing}, expected one for training")
    return records


def _view(folder: str, index: int) -> ViewItem:
    record = _records(Path(folder))[index]
    assert record.image is not None
    assert record.mask is not None
    load = partial(common.load_pair, record.image, record.mask, record.camera, f"as its camera in {CAMERAS}")
    return ViewItem(str(record.mask), record.camera, load)


def _walk(folder: Path) -> Iterator[tuple[str, Path, bool]]:
    """Name and folder of every object (it has any file of one), and whether it has its target; hidden ones are unfinished."""
    for path, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        if not {CAMERAS, TARGET, RECORD}.isdisjoint(files):
            inside = Path(path).relative_to(folder).as_posix()
            yield folder.resolve().name if inside == "." else inside, Path(path), TARGET in files
