"""What every reader of a data set returns: objects, their views, and what could not be used."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from ..errors import InputError
from ..geometry.arrays import Floats, Pixels
from ..geometry.camera import Camera


@dataclass(frozen=True, eq=False)
class ViewItem:
    """One picture of an object.

    camera : from the object's own frame to the pixels of image and mask.
    load : returns the image [H, W, 3] and the mask [H, W] in [0, 1], both of the camera's size;
        raises InputError if they cannot be read.
    """

    name: str
    camera: Camera
    load: Callable[[], tuple[Pixels, Floats]]


@dataclass(frozen=True, eq=False)
class ObjectItem:
    """One shape.

    name : unique in its data set, usually CATEGORY/NAME.
    category : "" if the data set has no categories.
    views : at least one.
    target : returns points of the surface [P, 3] in the object's own frame; None if there is no 3D
        file.
    lacking : if other objects of the data set have a 3D file and this one does not, a line that
        names the missing file.
    """

    name: str
    category: str
    views: Sequence[ViewItem]
    target: Callable[[], Floats] | None
    lacking: str = ""


@dataclass(frozen=True, eq=False)
class Dataset:
    """Objects that can be used, sorted by name, and why the others cannot be used."""

    objects: Sequence[ObjectItem]
    description: str  # stored in checkpoints
    skipped: dict[str, str] = field(default_factory=dict)  # item -> why it was left out
    scale: str = "longest side 1"  # the scale of all clouds and cameras, in words

    def select(self, names: Sequence[str], source: str) -> Dataset:
        """The objects with these ``names`` and their warped copies (NAME~0001 and so on).

        Raises InputError, which begins with ``source``, the file with the names, if a name is
        neither an object nor skipped.
        """
        listed = set(names)
        items = [item for item in self.objects if original(item.name) in listed]
        missing = sorted(listed - {original(item.name) for item in items} - set(self.skipped))
        if missing:
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            raise InputError(
                f"{source}: names {missing[0]}{more}, expected objects of {self.description}"
            )
        if not items:
            raise InputError(
                f"{source}: names no object that can be used, expected some of {self.description}"
            )
        return replace(self, objects=items)

    def with_points(self, strict: bool = False) -> Dataset:
        """The objects that have a 3D file; all objects if none of them has.

        The other objects are skipped; with ``strict`` they are an InputError.
        """
        items = [item for item in self.objects if item.target is not None]
        if not items:
            return self
        lacking = {item.name: item.lacking for item in self.objects if item.target is None}
        if lacking and strict:
            raise InputError(next(iter(lacking.values())))
        return replace(self, objects=items, skipped={**self.skipped, **lacking})


def copied(name: str, copy: int) -> str:
    """The name of warped copy number ``copy`` of an object; number 0 is the object itself."""
    return f"{name}~{copy:04d}" if copy else name


def original(name: str) -> str:
    """The name without the number of a warped copy."""
    return re.sub(r"~\d{4}$", "", name)
