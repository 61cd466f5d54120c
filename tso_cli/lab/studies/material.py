"""Shapes of a split as training data, rendered in memory when they are first needed."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...datasets.items import ObjectItem
from ...geometry.points import sample_surface
from ...render import RenderSettings
from ...train.data import TrainingData
from ...train.sources import rendered_object
from ..study import Report
from .shapes import Shape, see, shapes_of_part

# Pictures are larger than the network's input, so that cutting it out of them blurs nothing.
TRAINING_VIEWS, TEST_VIEWS, SIZE = 24, 8, 96
DENSE = 16_384
"""Points of the surface where depth maps are made of them."""
ALL = "all"
"""In place of a category: all of the study's at once."""


@dataclass(eq=False)
class Material:
    """Training data of each category and of all together, and the same for the shapes of ``part`` of a split, to judge on.

    ``limit`` : at most so many training shapes of each category. Raises InputError where the split or ``meshes`` lacks a shape.
    """

    meshes: Path
    split: Path | None
    part: str
    categories: Sequence[str]
    limit: int | None = None
    seed: int = 0
    report: Report = lambda what, done, total: None
    _rendered: dict[tuple[str, bool], list[ObjectItem]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self._shapes = {
            True: shapes_of_part(self.meshes, self.split, "train", self.categories, self.limit),
            False: shapes_of_part(self.meshes, self.split, self.part, self.categories),
        }

    def counts(self) -> dict[str, dict[str, int]]:
        """{category: {"training", "judged"}}, numbers of shapes."""
        training, judged = (Counter(shape.category for shape in shapes) for shapes in self._shapes.values())
        return {name: {"training": training[name], "judged": judged[name]} for name in self.categories}

    def names_hash(self) -> str:
        """Changes when the names of the shapes do."""
        names = "\n".join(shape.name for shapes in self._shapes.values() for shape in shapes)
        return hashlib.sha256(names.encode()).hexdigest()[:16]

    def data(self, category: str, training: bool, dense: bool = False) -> TrainingData:
        """The training or the judged shapes of ``category``, or of `ALL`; ``dense`` : with targets of 16,384 points."""
        names = self.categories if category == ALL else (category,)
        objects = [item for name in names for item in self._items(name, training)]
        if dense:
            shapes = {shape.name: shape for shape in self._shapes[training]}
            objects = [replace(item, target=partial(_dense, shapes[item.name])) for item in objects]
        return TrainingData(objects, f"{len(objects)} meshes, {'train' if training else self.part}: {category}")

    def _items(self, category: str, training: bool) -> list[ObjectItem]:
        if (category, training) not in self._rendered:
            settings = RenderSettings(views=TRAINING_VIEWS if training else TEST_VIEWS, size=(SIZE, SIZE))
            shapes, items = [shape for shape in self._shapes[training] if shape.category == category], []
            for done, shape in enumerate(shapes, 1):
                seen = see(shape, settings, self.seed)
                items.append(rendered_object(shape.name, category, seen.views, seen.target.astype(np.float32)))
                self.report(f"rendering {category}", done, len(shapes))
            self._rendered[category, training] = items
        return self._rendered[category, training]


def _dense(shape: Shape) -> NDArray[np.float32]:
    mesh = shape.mesh()
    return sample_surface(mesh.vertices, mesh.faces, DENSE, np.random.default_rng(0)).astype(np.float32)
