"""Which view of a camera file belongs to which mask."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from pathlib import Path

from ...errors import InputError
from ..reading import plain
from .record import PartialCamera

# Endings that files of pictures and masks have; a mask may have several, as in 0001.jpg.png.
_ENDINGS = (
    ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".gif", ".npy", ".npz", ".pt",
    ".exr", ".mask", "_mask", "-mask",
)  # fmt: skip
# How many names of views a message lists.
_LISTED = 5


def paired(
    path: Path, views: Sequence[PartialCamera], masks: Sequence[Path]
) -> tuple[list[PartialCamera], bool]:
    """The view of each mask, and whether names decided it (else the order did).

    The first of these rules that gives every mask a view of its own is used:

    1. a view names the path of the mask;
    2. a view names a file in a folder of the same name with the same stem;
    3. a view names a file with the same stem: the name without folders and endings of pictures.

    Otherwise the first view belongs to the first mask, and so on. Raises InputError if views and
    masks then differ in number, or if a view names a mask at another place.
    """
    for names in (names_mask, _same_folder_and_stem, _same_stem):
        fitting = [[i for i, view in enumerate(views) if names(view, mask)] for mask in masks]
        if all(len(numbers) == 1 for numbers in fitting):
            numbers_of_views = [numbers[0] for numbers in fitting]
            if len(set(numbers_of_views)) == len(masks):
                return [views[i] for i in numbers_of_views], True
    if len(views) != len(masks):
        raise _no_order(path, views, masks)
    for number, (view, mask) in enumerate(zip(views, masks, strict=True)):
        naming = [i for i, other in enumerate(views) if names_mask(other, mask)]
        alike = naming or [i for i, other in enumerate(views) if _same_stem(other, mask)]
        if alike and number not in alike:
            raise InputError(
                f"{path}: the mask {mask} is named like view {alike[0] + 1} of {len(views)} and is "
                f"mask {number + 1}, expected the order of the views; give the masks in this "
                "order, or name all of them like their views"
            )
        if not naming and view.mask is not None:
            warnings.warn(
                f"{path}: {view.title or 'its one view'} names the mask {view.mask}, used for "
                f"{mask}",
                stacklevel=2,
            )
    return list(views), False


def _no_order(path: Path, views: Sequence[PartialCamera], masks: Sequence[Path]) -> InputError:
    earlier_masks: dict[str, Path] = {}
    for mask in masks:
        if os.path.realpath(mask) in earlier_masks:
            return InputError(f"{mask}: is given twice, expected one mask for each view")
        earlier_masks[os.path.realpath(mask)] = mask
        alike = [view for view in views if _same_stem(view, mask)]
        if len(alike) > 1:
            return _ambiguous(path, mask, alike)
    listed = ", ".join(map(_name_of, views[:_LISTED])) + (", ..." if len(views) > _LISTED else "")
    several = f"{len(views)} view{'s' if len(views) > 1 else ''} ({listed})"
    if not any(_names_of(view) for view in views):
        return InputError(
            f"{path}: holds {len(views)} view{'s' if len(views) > 1 else ''} without names of "
            f"pictures, found {len(masks)} mask{'s' if len(masks) > 1 else ''}; expected as many; "
            "give a mask for each view, in their order"
        )
    for mask in masks:
        if not any(_same_stem(view, mask) for view in views):
            picture = stem(mask.name).rpartition("_")[0]
            if of_picture := [view for view in views if picture in view.names]:
                return InputError(
                    f"{path}: the mask {mask} is of another object of its picture, expected "
                    f"{of_picture[0].names[0]}; choose the object of the mask: `object` ID"
                )
            return InputError(
                f"{path}: none of its {several} names the mask {mask}, expected one; name the mask "
                f"like {_like(views[0])}"
            )
    for view in views:
        of_view = [str(mask) for mask in masks if _same_stem(view, mask)]
        if len(of_view) > 1:
            return InputError(
                f"{path}: the masks {' and '.join(of_view[:2])} are both named like the view "
                f"{_name_of(view)}, expected one mask for each view"
            )
    return InputError(
        f"{path}: holds {several}, found {len(masks)} masks; expected as many, or masks named like "
        "the pictures of the views"
    )


def _like(view: PartialCamera) -> str:
    """What a mask may be named like."""
    if view.mask or view.image:
        return "the picture of its view"
    return f"its view, such as {plain(view.names[0] if view.names else view.title)}.png"


def _ambiguous(path: Path, mask: Path, alike: Sequence[PartialCamera]) -> InputError:
    """The error of a mask whose name fits several views."""
    names = [_end_of(_names_of(view)[0]) for view in alike[:2]]
    advice = "put it into a folder named like that of its picture"
    if all("/" not in name for name in names):
        advice = f"name it like its view: {names[0]}{mask.suffix}"
    return InputError(
        f"{path}: the name of the mask {mask} is ambiguous: it fits {len(alike)} views, "
        f"{' and '.join(names)}, expected one; {advice}"
    )


def _name_of(view: PartialCamera) -> str:
    """The file that a view names, or another name by which a mask may choose it, or its title."""
    return view.label if view.mask or view.image or not view.names else plain(view.names[0])


def _end_of(name: str) -> str:
    """A name with its folder, by which views of the same name differ."""
    return plain("/".join(name.replace("\\", "/").split("/")[-2:]))


def names_mask(view: PartialCamera, mask: Path) -> bool:
    """Whether a view names the file ``mask``, perhaps by another path."""
    return view.mask is not None and os.path.realpath(view.mask) == os.path.realpath(mask)


def _names_of(view: PartialCamera) -> list[str]:
    files = [file.as_posix() for file in (view.mask, view.image) if file is not None]
    return [*files, *view.names]


def _same_stem(view: PartialCamera, mask: Path) -> bool:
    return stem(mask.name) in [stem(name) for name in _names_of(view)]


def _same_folder_and_stem(view: PartialCamera, mask: Path) -> bool:
    folder = mask.absolute().parent.name
    for name in _names_of(view):
        parts = name.replace("\\", "/").split("/")
        if len(parts) > 1 and parts[-2] == folder and stem(parts[-1]) == stem(mask.name):
            return True
    return False


def stem(name: str) -> str:
    """The name of a picture without folders and endings, in small letters."""
    text = name.replace("\\", "/").rsplit("/", 1)[-1].casefold()
    while True:
        ending = next((e for e in _ENDINGS if text.endswith(e) and len(text) > len(e)), "")
        if not ending:
            return text
        text = text[: -len(ending)]
