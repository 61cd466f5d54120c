"""Which view of a camera file belongs to which mask."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError
from ..geometry.camera import Camera
from .cameras import read_cameras, same_file


def named_masks(path: str | Path) -> list[Path]:
    """The masks that the views of a camera file name, in their order.

    Raises
    ------
    InputError
        As `read_cameras`; or a view names none.
    """
    records = read_cameras(path)
    for i, record in enumerate(records):
        if record.mask is None:
            raise InputError(
                f"{path}: views[{i}] of {len(records)} names no mask, expected a mask in each view, or MASK arguments"
            )
    return [record.mask for record in records if record.mask is not None]


def pair_with_masks(path: str | Path, masks: Sequence[str | Path]) -> list[Camera]:
    """The camera of each of several masks: of the view that names it, where views name them all, else by order.

    Parameters
    ----------
    masks : files, two or more. A view names one by its path, or failing that by the last part of the path.

    Raises
    ------
    InputError
        As `read_cameras`; or the views do not name all masks, and are not as many or name one of them at another place.
    """
    records = read_cameras(path)
    named: list[list[int]] = []
    for alike in (same_file, _same_name):
        named = [[i for i, r in enumerate(records) if r.mask is not None and alike(r.mask, mask)] for mask in masks]
        if all(len(own) == 1 for own in named) and len({own[0] for own in named}) == len(masks):
            return [records[own[0]].camera for own in named]
    if len(records) != len(masks):
        raise InputError(
            f"{path}: holds {len(records)} view{'s' * (len(records) > 1)}, found {len(masks)} masks; expected as many, "
            "or views that name every mask"
        )
    for i, (record, mask, own) in enumerate(zip(records, masks, named, strict=True)):
        if i in own:
            continue
        if own:
            raise InputError(
                f"{path}: the mask {mask} is named by views[{own[0]}] and given at place {i}, expected the same order"
            )
        if record.mask is not None:
            warnings.warn(f"{path}: views[{i}] names the mask {record.mask}, used for {mask}", stacklevel=2)
    return [record.camera for record in records]


def _same_name(a: str | Path, b: str | Path) -> bool:
    return Path(a).name == Path(b).name
