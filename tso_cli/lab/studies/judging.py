"""Shapes of a split to train on, networks judged on those they never saw, and what needs no network: the mean shape."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from ...datasets.items import ObjectItem
from ...evaluation.metrics import chamfer
from ...geometry.points import Array, normalise_longest_side, sample_surface
from ...network.model import BaseNetwork
from ...render import RenderSettings
from ...silhouette.chamfer import chamfer as batch_chamfer
from ...train.batches import Draw, assemble
from ...train.data import TrainingData
from ...train.sources import rendered_object
from ..study import Report
from .shapes import Shape, see, shapes_of_part

Floats = NDArray[np.float32]
JUDGED_VIEWS = 4
"""Input views of each shape that are judged, the first ones."""
CONVENTION = {
    "Chamfer": "squared distances, mean over points, forward (target -> prediction) + backward (prediction -> target); by the "
    "paper's protocol each cloud is centred and scaled to longest side 1 by its own box"
}
MEAN_SHAPE = "mean training shape"
"""Its name in tables."""
POINTS = 1024
# Adam's; by then the loss has stopped falling in the third digit.
MEAN_STEPS, MEAN_RATE, MEAN_BATCH = 300, 3e-3, 16
# Pictures are larger than the network's input, so that cutting it out of them blurs nothing.
TRAINING_VIEWS, TEST_VIEWS, SIZE = 24, 8, 96
DENSE = 16_384
"""Points of the surface where depth maps are made of them."""
FRAME = "canonical"
"""That of the networks which studies train: the axes of the object."""
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
        training, judged = (
            Counter(shape.category for shape in shapes) for shapes in self._shapes.values()
        )
        return {
            name: {"training": training[name], "judged": judged[name]} for name in self.categories
        }

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
        return TrainingData(
            objects, f"{len(objects)} meshes, {'train' if training else self.part}: {category}"
        )

    def _items(self, category: str, training: bool) -> list[ObjectItem]:
        if (category, training) not in self._rendered:
            settings = RenderSettings(
                views=TRAINING_VIEWS if training else TEST_VIEWS, size=(SIZE, SIZE)
            )
            shapes, items = (
                [shape for shape in self._shapes[training] if shape.category == category],
                [],
            )
            for done, shape in enumerate(shapes, 1):
                seen = see(shape, settings, self.seed)
                items.append(
                    rendered_object(
                        shape.name, category, seen.views, seen.target.astype(np.float32)
                    )
                )
                self.report(f"rendering {category}", done, len(shapes))
            self._rendered[category, training] = items
        return self._rendered[category, training]


def _dense(shape: Shape) -> Floats:
    mesh = shape.mesh()
    return sample_surface(mesh.vertices, mesh.faces, DENSE, np.random.default_rng(0)).astype(
        np.float32
    )


@dataclass(frozen=True, eq=False)
class Predicted:
    """What a network makes of one shape.

    index : of the shape in its data.
    points, target : [v, N, 3] and [v, M, 3] float64, prediction and truth for each of the first v views, in the object's axes.
    """

    index: int
    category: str
    points: Array
    target: Array


def predict(network: BaseNetwork | None, data: TrainingData) -> list[Predicted]:
    """The clouds that ``network`` predicts from the judged views of every shape; without a network no points."""
    device = next(network.parameters()).device if network else torch.device("cpu")
    predicted = []
    for index, item in enumerate(data.objects):
        batch = assemble(
            data, [Draw(index, view) for view in range(min(JUDGED_VIEWS, len(item.views)))], FRAME
        )
        images = torch.as_tensor(batch.images, device=device)
        with torch.no_grad():
            points = network(images) if network else images.new_empty(len(images), 0, 3)
        clouds, targets = (
            points.cpu().numpy().astype(np.float64),
            np.stack(batch.targets).astype(np.float64),
        )
        predicted.append(Predicted(index, item.category, clouds, targets))
    return predicted


def judge(predicted: list[Predicted]) -> dict[str, float]:
    """Chamfer distance by category under the paper's protocol, x1000: means over the views of a shape, then over shapes."""
    means: dict[str, list[float]] = {}
    for shape in predicted:
        scaled = [
            [normalise_longest_side(cloud) for cloud in pair]
            for pair in zip(shape.points, shape.target, strict=True)
        ]
        means.setdefault(shape.category, []).append(
            float(np.mean([chamfer(*pair).chamfer for pair in scaled]))
        )
    return {category: 1e3 * float(np.mean(values)) for category, values in means.items()}


def mean_shape(targets: Sequence[Floats], seed: int = 0, steps: int = MEAN_STEPS) -> Floats:
    """The cloud of 1,024 points with the least mean Chamfer distance to ``targets`` (of [1024, 3])."""
    rng = np.random.default_rng([seed, 11])
    stacked = torch.from_numpy(np.stack(targets))
    pool = stacked.reshape(-1, 3)
    points = (
        pool[torch.from_numpy(rng.permutation(len(pool))[:POINTS])].clone().requires_grad_(True)
    )
    optimiser = torch.optim.Adam([points], lr=MEAN_RATE)
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = MEAN_RATE * (1.0 - step / steps)
        batch = stacked[torch.from_numpy(rng.permutation(len(stacked))[:MEAN_BATCH])]
        forward, backward = batch_chamfer(points.expand(len(batch), -1, -1), batch)
        optimiser.zero_grad()
        (forward + backward).mean().backward()
        optimiser.step()
    return np.asarray(points.detach().numpy())


def constant_answer(training: TrainingData, judged: TrainingData) -> list[Predicted]:
    """The mean training shape as the prediction for every view that is judged."""
    mean = mean_shape([training.target(i) for i in range(len(training.objects))]).astype(np.float64)
    return [
        replace(shape, points=np.repeat(mean[None], len(shape.target), axis=0))
        for shape in predict(None, judged)
    ]
