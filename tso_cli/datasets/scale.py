"""One size for all objects of a data set, and cameras that see them as before.

ShapeNet scales a model to unit diagonal, so that the longest side of chairs is 0.6 to 0.85. The network's input is cut out
around the object and hides that: no network can learn it, and a Chamfer distance to such a target is mostly an error of scale.
"""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..geometry.points import Array, bounding_box_normalisation
from .common import LazyViews
from .items import Dataset, Floats, ObjectItem, ViewItem

AS_READ = "units of the data set"
DIAGONAL = "unit diagonal"
# Objects whose median size and centre stand for one without a 3D file.
TYPICAL = 32


def normalised(dataset: Dataset) -> Dataset:
    """The objects with targets of longest side 1, centred on their box, and with cameras moved so that no picture changes.

    A target is read when it or a view of its object is first asked for. An object without a readable one takes the median of
    its category, or of all where the category has none. Without any 3D file everything stays as it is.
    """
    if all(item.target is None for item in dataset.objects):
        return replace(dataset, scale=AS_READ)
    boxes = _Boxes(dataset.objects)
    return replace(dataset, objects=[boxes.normalised(item) for item in dataset.objects])


def of_unit_diagonal(dataset: Dataset) -> Dataset:
    """The objects scaled as ShapeNet's models are; those of longest side 1 as they come."""
    boxes = _Boxes(dataset.objects, diagonal=True)
    return replace(
        dataset, objects=[boxes.normalised(item) for item in dataset.objects], scale=DIAGONAL
    )


class _Boxes:
    """Centre and size of every object that was needed so far; used by several threads."""

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

        return replace(
            item, views=LazyViews(len(item.views), view), target=None if read is None else target
        )

    def _of(self, item: ObjectItem) -> tuple[Array, float]:
        if item.name not in self._known:
            try:
                if item.target is None:
                    raise InputError(item.lacking)
                self._measured(item, item.target())
            except InputError:  # reported where the target itself is asked for
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
                for item in members[:: max(1, -(-len(members) // TYPICAL))]:
                    assert item.target is not None
                    with suppress(InputError):
                        boxes.append(self._measured(item, item.target()))
                centre = (
                    np.median([centre for centre, _ in boxes], axis=0) if boxes else np.zeros(3)
                )
                self._medians[category] = (
                    centre,
                    float(np.median([size for _, size in boxes])) if boxes else 1.0,
                )
            return self._medians[category]
