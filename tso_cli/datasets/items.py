"""What every reader of a data set gives: objects, their views, and what could not be used."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.camera import Camera

Pixels = NDArray[np.uint8]
Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class ViewItem:
    """One picture of an object.

    camera : from the object's own frame to the pixels of image and mask.
    load : gives image [H, W, 3] and mask [H, W] in [0, 1], both of the camera's size; InputError if they cannot be read.
    """

    name: str
    camera: Camera
    load: Callable[[], tuple[Pixels, Floats]]


@dataclass(frozen=True, eq=False)
class ObjectItem:
    """One shape.

    name : unique in its data set, CATEGORY/NAME as a rule. category : "" where the data set knows none.
    views : at least one.
    target : gives points of the surface [P, 3] in the object's own frame; None where there is no such file.
    lacking : one line naming the 3D file that is missing, where other objects of the data set have theirs.
    """

    name: str
    category: str
    views: Sequence[ViewItem]
    target: Callable[[], Floats] | None
    lacking: str = ""


@dataclass(frozen=True, eq=False)
class Dataset:
    """Objects that can be used, sorted by name, and why the others cannot."""

    objects: Sequence[ObjectItem]
    description: str  # stored in checkpoints
    skipped: dict[str, str] = field(default_factory=dict)  # item -> why it was left out
    scale: str = "longest side 1"  # that of all clouds and cameras, in words

    def select(self, names: Sequence[str], source: str) -> Dataset:
        """The objects that the split in the file ``source`` names, with their warped copies (NAME~0001 and so on).

        Raises InputError if it names an object that is neither here nor skipped.
        """
        listed = set(names)
        chosen = [item for item in self.objects if original(item.name) in listed]
        missing = sorted(listed - {original(item.name) for item in chosen} - set(self.skipped))
        if missing:
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            raise InputError(
                f"{source}: names {missing[0]}{more}, expected objects of {self.description}"
            )
        if not chosen:
            raise InputError(
                f"{source}: names no object that can be used, expected some of {self.description}"
            )
        return replace(self, objects=chosen)

    def with_points(self, strict: bool = False) -> Dataset:
        """The objects that have a 3D file, or all if none has; the others are skipped, with ``strict`` an InputError."""
        chosen = [item for item in self.objects if item.target is not None]
        if not chosen:
            return self
        lacking = {item.name: item.lacking for item in self.objects if item.target is None}
        if lacking and strict:
            raise InputError(next(iter(lacking.values())))
        return replace(self, objects=chosen, skipped={**self.skipped, **lacking})


def copied(name: str, copy: int) -> str:
    """Name of the warped copy number ``copy`` of an object, from 1; 0 is the object itself."""
    return f"{name}~{copy:04d}" if copy else name


def original(name: str) -> str:
    """The object that ``name`` is, or is a warped copy of."""
    return re.sub(r"~\d{4}$", "", name)
