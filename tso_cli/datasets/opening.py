"""A folder, whatever its layout -> a data set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ..errors import InputError
from . import common
from .items import Dataset
from .pix3d import TABLE, open_pix3d
from .r2n2 import PICTURES, open_r2n2
from .r2n2 import RENDERED as R2N2
from .rendered import holds_object, open_rendered
from .scale import AS_READ, normalised, of_unit_diagonal
from .shapenet import RENDERED as SHAPENET
from .shapenet import open_shapenet

Opener = Callable[[Path, bool], Dataset]
LAYOUTS = (
    f"ShapeNet of the CAPNet authors ({SHAPENET}/SYNSET/MODEL/render_0.png), renders of 3D-R2N2 "
    f"({R2N2}/SYNSET/MODEL/{PICTURES}/00.png), Pix3D ({TABLE}), or what tso render writes "
    "(NAME/cameras.json)"
)


def open_dataset(folder: Path, strict: bool = False, own_scale: bool = False) -> Dataset:
    """Open the data set in ``folder``; the names of folders and files in it show its layout.

    What cannot be used is left out and named in ``skipped``; with ``strict`` it is an InputError.
    A picture is read, and perhaps found to be damaged, only when it is loaded.

    Every object is centred and scaled to longest side 1. With ``own_scale`` objects keep their
    size instead. The objects of Pix3D and of `tso render` have lost theirs: they are scaled to
    diagonal 1, as the objects of ShapeNet are.

    Raises InputError if ``folder`` has no known layout or two of them, or if no object can be used.
    """
    if not folder.is_dir():
        problem = "is a file" if folder.exists() else "does not exist"
        raise InputError(f"{folder}: {problem}, expected a data set: {LAYOUTS}")
    folders, files = common.listed(folder)
    layouts: dict[str, Opener] = {}
    if TABLE in files:
        layouts[TABLE] = open_pix3d
    if SHAPENET in folders or (folder.resolve().name == SHAPENET and R2N2 not in folders):
        layouts[SHAPENET] = open_shapenet
    if R2N2 in folders or (not layouts and _is_r2n2(folder, folders)):
        layouts[R2N2] = open_r2n2
    if len(layouts) > 1:
        raise InputError(
            f"{folder}: holds {' and '.join(list(layouts)[:2])}, expected one data set"
        )
    layout, opener = next(iter(layouts.items()), ("", open_rendered))
    if not layout and not holds_object(folder):
        raise InputError(f"{folder}: has no known layout, expected {LAYOUTS}")
    dataset = opener(folder, strict)
    if layout in (SHAPENET, R2N2):
        return replace(dataset, scale=AS_READ) if own_scale else normalised(dataset)
    return of_unit_diagonal(dataset) if own_scale else dataset


def _is_r2n2(folder: Path, categories: list[str]) -> bool:
    """Whether a model of the first category that is not empty has a folder of pictures."""
    for category in categories:
        models = common.listed(folder / category)[0]
        if models:
            return any((folder / category / model / PICTURES).is_dir() for model in models)
    return False
