"""One size for all objects of a data set: longest side 1, centred, and cameras that see them so.

ShapeNet scales a model to unit diagonal, so that the longest side of chairs is 0.6 to 0.85. The network's input is cut out
around the object and hides that: no network can learn it, and a Chamfer distance to such a target is mostly an error of scale.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..geometry import Array, bounding_box_normalisation
from .common import LazyViews
from .items import Dataset, Floats, ObjectItem, ViewItem

# Objects of a category whose median stands for one that has no 3D file of its own.
TYPICAL = 32


def normalised(dataset: Dataset) -> Dataset:
    """The objects with targets of longest side 1, centred on their box, and with cameras moved so that no picture changes.

    The middle and the size of an object are those of its target, read when one of its views or its target is first asked for.
    An object without a readable target takes the median of its category; where no object of it has one, it stays as it is.
    """
    scales = _Scales(dataset)
    return replace(dataset, objects=[_scaled(item, scales) for item in dataset.objects])


class _Scales:
    """Middle and longest side of every object that was needed so far."""

    def __init__(self, dataset: Dataset) -> None:
        self._known: dict[str, tuple[Array, float]] = {}
        self._typical: dict[str, tuple[Array, float]] = {}
        self._members: dict[str, list[ObjectItem]] = defaultdict(list)
        for item in dataset.objects:
            if item.target is not None:
                self._members[item.category].append(item)

    def of(self, item: ObjectItem) -> tuple[Array, float]:
        if item.name not in self._known:
            found = _measured(item)
            self._known[item.name] = self._usual(item.category) if found is None else found
        return self._known[item.name]

    def _usual(self, category: str) -> tuple[Array, float]:
        if category not in self._typical:
            members = self._members[category]
            chosen = members[:: max(1, -(-len(members) // TYPICAL))]
            found = [own for own in map(_measured, chosen) if own is not None]
            middle = np.median([centre for centre, _ in found], axis=0) if found else np.zeros(3)
            self._typical[category] = middle, float(np.median([side for _, side in found])) if found else 1.0
        return self._typical[category]


def _measured(item: ObjectItem) -> tuple[Array, float] | None:
    if item.target is None:
        return None
    try:
        return bounding_box_normalisation(item.target(), item.name)
    except InputError:
        return None  # said where the target itself is asked for


def _scaled(item: ObjectItem, scales: _Scales) -> ObjectItem:
    read = item.target

    def view(index: int) -> ViewItem:
        seen = item.views[index]
        return replace(seen, camera=seen.camera.for_normalised(*scales.of(item)))

    def target() -> Floats:
        assert read is not None
        points = read()
        centre, side = bounding_box_normalisation(points, item.name)
        return ((points - centre) / side).astype(np.float32)

    return replace(item, views=LazyViews(len(item.views), view), target=None if read is None else target)
