"""Which view of a camera file belongs to which mask."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError
from ..geometry.camera import Camera
from .cameras import read_cameras, same_file


def named_masks(path: str | Path) -> list[Path]:
    """The masks that the views of a camera file name, in their order; InputError as `read_cameras`, or if one names none."""
    masks = [record.mask for record in read_cameras(path)]
    if None in masks:
        where = f"views[{masks.index(None)}] of {len(masks)}"
        raise InputError(f"{path}: {where} names no mask, expected a mask in each view, or MASK arguments")
    return [mask for mask in masks if mask is not None]


def pair_with_masks(path: str | Path, masks: Sequence[str | Path]) -> list[Camera]:
    """The camera of each of several masks: of the view that names it, where views name them all, else by order.

    A view names a mask by its path, or failing that by the last part of the path. Raises InputError as `read_cameras`, or if
    the views do not name all masks, and are not as many or contradict the order.
    """
    records = read_cameras(path)
    naming: list[list[int]] = []  # views, of each mask
    for alike in (same_file, lambda a, b: Path(a).name == Path(b).name):
        naming = [[i for i, r in enumerate(records) if r.mask is not None and alike(r.mask, mask)] for mask in masks]
        if all(len(views) == 1 for views in naming) and len({views[0] for views in naming}) == len(masks):
            return [records[views[0]].camera for views in naming]
    if len(records) != len(masks):
        raise InputError(
            f"{path}: holds {len(records)} view{'s' * (len(records) > 1)}, found {len(masks)} masks; expected as many, "
            "or views that name every mask"
        )
    for i, (record, mask, views) in enumerate(zip(records, masks, naming, strict=True)):
        if views and i not in views:
            raise InputError(
                f"{path}: the mask {mask} is named by views[{views[0]}] and given at place {i}, expected the same order"
            )
        if not views and record.mask is not None:
            warnings.warn(f"{path}: views[{i}] names the mask {record.mask}, used for {mask}", stacklevel=2)
    return [record.camera for record in records]
