"""One size for all objects of a data set, and cameras that see them as before.

ShapeNet scales a model to unit diagonal: the longest side of its chairs is 0.6 to 0.85. The
network's input is cut out around the object and hides that size. No network can learn it, and a
Chamfer distance to a target of that size is mostly an error of scale.
"""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array, Floats
from ..geometry.points import bounding_box_normalisation
from .common import LazyViews
from .items import Dataset, ObjectItem, ViewItem

AS_READ = "units of the data set"
DIAGONAL = "unit diagonal"


def normalised(dataset: Dataset) -> Dataset:
    """The data set with centred targets of longest side 1, and cameras that see the same pictures.

    A target is read when it, or a view of its object, is first needed. An object without a readable
    target gets the median centre and size of its category; if the category has no target, of all
    objects. A data set without any 3D file stays as it is.
    """
    if all(item.target is None for item in dataset.objects):
        return replace(dataset, scale=AS_READ)
    boxes = _Boxes(dataset.objects)
    return replace(dataset, objects=[boxes.normalised(item) for item in dataset.objects])


def of_unit_diagonal(dataset: Dataset) -> Dataset:
    """The data set with objects of diagonal 1, as the models of ShapeNet have."""
    boxes = _Boxes(dataset.objects, diagonal=True)
    return replace(
        dataset, objects=[boxes.normalised(item) for item in dataset.objects], scale=DIAGONAL
    )


class _Boxes:
    """Centre and size of every object that was needed so far; several threads may use it.

    The size is the longest side, or with ``diagonal`` the diagonal of the bounding box.
    """

    def __init__(self, objects: Sequence[ObjectItem], diagonal: bool = False) -> None:
        self._diagonal, self._lock = diagonal, threading.Lock()
        self._known: dict[str, tuple[Array, float]] = {}
        self._medians: dict[str, tuple[Array, float]] = {}
        self._members: dict[str, list[ObjectItem]] = defaultdict(list)
        for item in objects:
            if item.target is not None:
                self._members[item.category].append(item)

    def normalised(self, item: ObjectItem) -> ObjectItem:
        read = item.target

        def view(index: int) -> ViewItem:
            original = item.views[index]
            return replace(original, camera=original.camera.for_normalised(*self._of(item)))

        def target() -> Floats:
            assert read is not None
            points = read()
            centre, size = self._measured(item, points)
            return ((points - centre) / size).astype(np.float32)

        views = LazyViews(len(item.views), view)
        return replace(item, views=views, target=None if read is None else target)

    def _of(self, item: ObjectItem) -> tuple[Array, float]:
        if item.name not in self._known:
            try:
                if item.target is None:
                    raise InputError(item.lacking)
                self._measured(item, item.target())
            except InputError:  # whoever needs the target itself gets the error
                self._known[item.name] = self._median(item.category)
        return self._known[item.name]

    def _measured(self, item: ObjectItem, points: Floats) -> tuple[Array, float]:
        centre, size = bounding_box_normalisation(points, item.name)
        if self._diagonal:
            size = float(np.linalg.norm(np.ptp(points, axis=0)))
        self._known[item.name] = centre, size
        return centre, size

    def _median(self, category: str) -> tuple[Array, float]:
        with self._lock:
            if category not in self._medians:
                members = self._members[category] or [
                    item for items in self._members.values() for item in items
                ]
                boxes = []
                # The median of at most 32 objects: each of them has to be read.
                for item in members[:: max(1, -(-len(members) // 32))]:
                    assert item.target is not None
                    with suppress(InputError):
                        boxes.append(self._measured(item, item.target()))
                centre, size = np.zeros(3), 1.0
                if boxes:
                    centre = np.median([centre for centre, _ in boxes], axis=0)
                    size = float(np.median([size for _, size in boxes]))
                self._medians[category] = centre, size
            return self._medians[category]
