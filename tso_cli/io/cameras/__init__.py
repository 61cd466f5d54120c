"""Camera files: those of tso and of other programs, and which view belongs to which mask."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from ...errors import InputError
from ...geometry.camera import Camera
from ..images import has_alpha
from ..reading import is_there
from . import of_bop
from .formats import FORMATS, form_of, read_partial_cameras
from .matching import paired
from .record import (
    CameraRecord,
    Intrinsics,
    PartialCamera,
    of_horizontal_angle,
    of_pixels,
    same_shape,
)
from .source import CameraSource
from .write import camera_text, write_cameras

# Files that are looked for next to a mask, after MASKSTEM.camera.json.
USUAL_NAMES = ("camera.json", "cameras.json", "transforms.json")
# Files that are looked for one folder above the mask, where data sets have them.
NAMES_ABOVE = (
    "transforms.json", "transforms_train.json", "transforms_val.json", "transforms_test.json",
    "scene_camera.json", "cameras.json",
)  # fmt: skip


def names_next_to(mask: Path) -> tuple[str, ...]:
    """What a camera file in the folder of a mask may be called, the preferred name first."""
    return (f"{mask.stem}.camera.json", *USUAL_NAMES)


def find_camera(mask_path: Path) -> Path | None:
    """The camera file in the folder of a mask, or None.

    That is the first of ``MASKSTEM.camera.json``, ``camera.json``, ``cameras.json`` (as
    `tso render` names it) and ``transforms.json`` that exists; or else the first of `NAMES_ABOVE`,
    one folder above, with a view that names the mask.
    """
    for name in names_next_to(mask_path):
        path = mask_path.with_name(name)
        if path.is_file():
            return path
    folder = mask_path.parent
    plain = folder.name not in ("", "..") and not folder.is_symlink()
    above = folder.parent if plain else folder / ".."
    for name in NAMES_ABOVE:
        path = above / name
        if is_there(path) and _names(path, mask_path):
            return path
    return None


def _names(path: Path, mask: Path) -> bool:
    """Whether a view of the camera file ``path`` names the file ``mask``."""
    try:
        files = _files_named(path, path.stat().st_mtime_ns)
    except (InputError, OSError):  # a file that nobody named may be anything
        return False
    picture, _, entry = mask.stem.partition("_")
    return os.path.realpath(mask) in files or (entry.isdecimal() and f"{path}/{picture}" in files)


@lru_cache(maxsize=8)
def _files_named(path: Path, changed: int) -> frozenset[str]:
    """The masks and pictures that the views of a file name, as it was when it was ``changed``."""
    if path.name == of_bop.CAMERAS:
        # Masks of BOP are called PICTURE_ENTRY; which object is meant is not known yet.
        pictures = CameraSource(path).json
        numbers = pictures if isinstance(pictures, dict) else ()
        return frozenset(f"{path}/{number:0>6}" for number in numbers if number.isdecimal())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        views, _ = read_partial_cameras(path)
    files: set[str] = set()
    for view in views:
        for file in filter(None, (view.mask, view.image)):
            files.update(map(os.path.realpath, _files_of(file)))
    return frozenset(files)


def read_cameras(path: str | Path, size: tuple[int, int] | None = None) -> list[CameraRecord]:
    """Read all views of a camera file, at least one, for pictures of ``size`` or their own size.

    Raises InputError, which names the file and the key, if the file is wrong.
    """
    path = Path(path)
    records = []
    for view in read_partial_cameras(path)[0]:
        if (of_view := size or view.size) is None:
            where = f"{view.title}." if view.title else ""
            raise InputError(
                f"{path}: {where}width is missing, expected width and height, or `size`"
            )
        records.append(CameraRecord(view.camera(path, *of_view), view.mask, view.image))
    return records


def read_camera(
    path: str | Path, width: int, height: int, mask: str | Path | None = None
) -> Camera:
    """Read the camera of the file ``mask``, which has ``width`` x ``height`` pixels.

    If the camera file has several views, exactly one of them must name the file ``mask``. If the
    view is of a larger or smaller picture, its K is scaled. Raises InputError if no view or several
    views name the mask, if the proportions differ, or as `read_partial_cameras`.
    """
    path = Path(path)
    views, _ = read_partial_cameras(path)
    if mask is not None:
        return paired(path, views, [Path(mask)])[0][0].camera(path, width, height)
    if len(views) > 1:
        raise InputError(f"{path}: 0 of its {len(views)} views name a mask, expected one")
    return views[0].camera(path, width, height)


def named_masks(
    path: Path, camera_format: str | None = None, object_id: int | None = None
) -> list[Path]:
    """The masks that the views of a camera file name, in the order of the views.

    A picture with an alpha channel is a mask too. Raises InputError as `read_partial_cameras`, or
    if a view names no mask.
    """
    views, _ = read_partial_cameras(path, camera_format, object_id)
    masks = []
    for number, view in enumerate(views):
        mask = view.mask or _with_alpha(view.image)
        image = view.image
        if mask is None and image is not None and not any(map(is_there, _files_of(image))):
            raise InputError(
                f"{path}: views[{number}] of {len(views)} names {image}, which does not exist, "
                "expected a picture with an alpha channel; or give MASK arguments"
            )
        if mask is None:
            raise InputError(
                f"{path}: views[{number}] of {len(views)} names no mask, expected a mask or a "
                "picture with an alpha channel in each view, or MASK arguments"
            )
        masks.append(mask)
    return masks


def named_images(views: Sequence[PartialCamera | None]) -> list[Path]:
    """The pictures that the views name; none unless each view names one that exists."""
    existing = [
        next(filter(is_there, _files_of(view.image)), None) if view and view.image else None
        for view in views
    ]
    images = [image for image in existing if image is not None]
    return images if len(images) == len(existing) else []


def _with_alpha(image: Path | None) -> Path | None:
    """The file of a picture with an alpha channel; NeRF's files name pictures without ".png"."""
    files = [] if image is None else _files_of(image)
    return next((file for file in files if has_alpha(file)), None)


def _files_of(image: Path) -> list[Path]:
    """What the file of a picture may be called."""
    return [image, image.with_name(f"{image.name}.png")]
