"""Shapes of a split as training data, rendered in memory when they are first needed."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...datasets.items import Dataset, ObjectItem
from ...geometry.points import sample_surface
from ...io.meshes import read_mesh
from ...io.shipped import CATEGORIES
from ...render import RenderSettings, normalise
from ...train.data import TrainingData
from ...train.sources import rendered_object, sized
from ..study import Report
from .parts import SPLIT, Shape, see, shapes_of_part

# Pictures are larger than the network's input, so that cutting it out of them blurs nothing.
TRAINING_VIEWS, TEST_VIEWS, SIZE = 24, 8, 96
DENSE = 16_384
"""Points of the surface where depth maps are made of them."""
ALL = "all"
"""In place of a category: all of the study's at once."""


@dataclass(frozen=True)
class Source:
    """Where the shapes come from.

    meshes : folder of CATEGORY/NAME for every name of ``split``, a file.
    part : list to judge on, "test" or "validation".
    limit : at most so many training shapes of each category, spread evenly over the list; None for all.
    seed : of the pictures.
    """

    meshes: Path
    split: Path = SPLIT
    part: str = "test"
    categories: tuple[str, ...] = CATEGORIES
    limit: int | None = None
    seed: int = 0


class Material:
    """Training data of each category and of all together, and the same for the shapes to judge on.

    Raises InputError where the split or the folder lacks a shape; nothing is rendered yet.
    """

    def __init__(self, source: Source, report: Report | None = None) -> None:
        self.source, self._report = source, report
        training = shapes_of_part(source.meshes, source.split, "train", source.categories, source.limit)
        judged = shapes_of_part(source.meshes, source.split, source.part, source.categories)
        self._shapes = {True: training, False: judged}
        self._objects: dict[tuple[str, bool], list[ObjectItem]] = {}

    def _of(self, category: str, training: bool) -> list[Shape]:
        return [shape for shape in self._shapes[training] if shape.category == category]

    def counts(self) -> dict[str, dict[str, int]]:
        """{category: {"training", "judged"}}, numbers of shapes."""
        return {
            name: {"training": len(self._of(name, True)), "judged": len(self._of(name, False))}
            for name in self.source.categories
        }

    def fingerprint(self) -> str:
        """Changes when the names of the shapes do."""
        names = "\n".join(shape.name for training in (True, False) for shape in self._shapes[training])
        return hashlib.sha256(names.encode()).hexdigest()[:16]

    def data(self, category: str, training: bool, dense: bool = False, whole: bool = False) -> TrainingData:
        """The training or the judged shapes of ``category``, or of `ALL`.

        dense : targets of 16,384 points. whole : shapes of unit diagonal, as ShapeNet has them, in pictures that show size.
        """
        names = self.source.categories if category == ALL else (category,)
        objects = [item for name in names for item in self._rendered(name, training)]
        if dense:
            paths = {shape.name: shape.path for shape in self._shapes[training]}
            objects = [replace(item, target=partial(_dense, paths[item.name])) for item in objects]
        part = "train" if training else self.source.part
        described = f"{len(objects)} meshes of {self.source.split.name}, {part}: {category}"
        return sized(Dataset(objects, described), 0.0 if whole else 0.9)

    def _rendered(self, category: str, training: bool) -> list[ObjectItem]:
        key = (category, training)
        if key not in self._objects:
            settings = RenderSettings(views=TRAINING_VIEWS if training else TEST_VIEWS, size=(SIZE, SIZE))
            shapes, objects = self._of(*key), []
            for done, shape in enumerate(shapes, 1):
                seen = see(shape, settings, self.source.seed)
                objects.append(rendered_object(shape.name, category, seen.views, seen.target.astype(np.float32)))
                if self._report:
                    self._report(f"rendering {category}", done, len(shapes))
            self._objects[key] = objects
        return self._objects[key]


def _dense(path: Path) -> NDArray[np.float32]:
    mesh = normalise(read_mesh(path))
    return sample_surface(mesh.vertices, mesh.faces, DENSE, np.random.default_rng(0)).astype(np.float32)
