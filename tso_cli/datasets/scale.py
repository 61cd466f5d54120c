"""One size for all objects of a data set, and cameras that see them as before.

ShapeNet scales a model to unit diagonal, so that the longest side of chairs is 0.6 to 0.85. The network's input is cut out
around the object and hides that: no network can learn it, and a Chamfer distance to such a target is mostly an error of scale.
"""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..geometry.points import Array, bounding_box_normalisation
from .common import LazyViews
from .items import Dataset, Floats, ObjectItem, ViewItem

OWN = "units of the data set"
DIAGONAL = "unit diagonal"
# Objects whose median stands for one that has no 3D file of its own.
TYPICAL = 32


def normalised(dataset: Dataset) -> Dataset:
    """The objects with targets of longest side 1, centred on their box, and with cameras moved so that no picture changes.

    The middle and the size of an object are those of its target, read when one of its views or its target is first asked for.
    An object without a readable target takes the median of its category, or of all where the category has none. Without any
    3D file everything stays as it is.
    """
    if all(item.target is None for item in dataset.objects):
        return replace(dataset, scale=OWN)
    boxes = _Boxes(dataset.objects)
    return replace(dataset, objects=[_moved(item, boxes) for item in dataset.objects])


def of_unit_diagonal(dataset: Dataset) -> Dataset:
    """The objects scaled as ShapeNet's models are; those of longest side 1 as they come."""
    boxes = _Boxes(dataset.objects, diagonal=True)
    return replace(dataset, objects=[_moved(item, boxes) for item in dataset.objects], scale=DIAGONAL)


class _Boxes:
    """Middle and size of every object that was needed so far; asked by several threads."""

    def __init__(self, objects: Sequence[ObjectItem], diagonal: bool = False) -> None:
        self._diagonal, self._lock = diagonal, threading.Lock()
        self._known: dict[str, tuple[Array, float]] = {}
        self._usual: dict[str, tuple[Array, float]] = {}
        self._members: dict[str, list[ObjectItem]] = defaultdict(list)
        for item in objects:
            if item.target is not None:
                self._members[item.category].append(item)

    def of(self, item: ObjectItem) -> tuple[Array, float]:
        if item.name not in self._known:
            try:
                if item.target is None:
                    raise InputError(item.lacking)
                self.measured(item, item.target())
            except InputError:  # said where the target itself is asked for
                self._known[item.name] = self._typical(item.category)
        return self._known[item.name]

    def measured(self, item: ObjectItem, points: Floats) -> tuple[Array, float]:
        """That of ``points``, the target of ``item``, which is kept."""
        centre, size = bounding_box_normalisation(points, item.name)
        if self._diagonal:
            size = float(np.linalg.norm(np.ptp(points, axis=0)))
        self._known[item.name] = centre, size
        return centre, size

    def _typical(self, category: str) -> tuple[Array, float]:
        with self._lock:
            if category not in self._usual:
                members = self._members[category] or [item for own in self._members.values() for item in own]
                found = []
                for item in members[:: max(1, -(-len(members) // TYPICAL))]:
                    try:
                        assert item.target is not None
                        found.append(self.measured(item, item.target()))
                    except InputError:
                        continue
                middle = np.median([centre for centre, _ in found], axis=0) if found else np.zeros(3)
                self._usual[category] = middle, float(np.median([size for _, size in found])) if found else 1.0
            return self._usual[category]


def _moved(item: ObjectItem, boxes: _Boxes) -> ObjectItem:
    read = item.target

    def view(index: int) -> ViewItem:
        seen = item.views[index]
        return replace(seen, camera=seen.camera.for_normalised(*boxes.of(item)))

    def target() -> Floats:
        assert read is not None
        points = read()
        centre, size = boxes.measured(item, points)
        return ((points - centre) / size).astype(np.float32)

    return replace(item, views=LazyViews(len(item.views), view), target=None if read is None else target)
