"""Training and unseen shapes of a split, predictions of networks, and their distance to the truth.

And an answer that needs no network: the mean of the training shapes.
"""

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

from tso_cli.datasets.items import ObjectItem
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.points import Array, normalise_longest_side, sample_surface
from tso_cli.network.model import BaseNetwork
from tso_cli.render.settings import RenderSettings
from tso_cli.silhouette.chamfer import chamfer as batch_chamfer
from tso_cli.train.batches import Draw, assemble
from tso_cli.train.data import TrainingData
from tso_cli.train.sources import rendered_object

from ..study import Report
from .shapes import Shape, see, shapes_of_part

Floats = NDArray[np.float32]
INPUT_VIEWS = 4
"""Views of each unseen shape that a network predicts from; the others are not given to it."""
CHAMFER = "squared distances, mean over points, forward (target -> prediction) + backward "
CHAMFER += "(prediction -> target); by the paper's protocol each cloud is centred and scaled to "
CHAMFER += "longest side 1 by its own box"
MEAN_SHAPE = "mean training shape"
"""Its name in tables."""
POINTS = 1024
# Of Adam, for the mean shape; after these steps the loss has stopped falling in the third digit.
MEAN_STEPS, MEAN_RATE, MEAN_BATCH = 300, 3e-3, 16
# Pictures are larger than the network's input, so that cutting the input out blurs nothing.
TRAINING_VIEWS, TEST_VIEWS, SIZE = 24, 8, 96
DENSE = 16_384
"""Points of the surface that depth maps are made of."""
FRAME = "canonical"
"""Of the networks that studies train: the axes of the object."""
ALL = "all"
"""In place of a category: all categories of the study together."""


@dataclass(eq=False)
class Material:
    """Training shapes by category, and unseen shapes from the list ``part`` of a split.

    limit : most training shapes of each category. views : of a training and of an unseen shape.
    size : pixels of the pictures each way. mean_steps : of Adam, for the mean training shape.

    Raises InputError where the split or ``meshes`` lacks a shape.
    """

    meshes: Path
    split: Path | None
    part: str
    categories: Sequence[str]
    limit: int | None = None
    seed: int = 0
    report: Report = lambda what, done, total: None
    views: tuple[int, int] = (TRAINING_VIEWS, TEST_VIEWS)
    size: int = SIZE
    mean_steps: int = MEAN_STEPS
    _rendered: dict[tuple[str, bool], list[ObjectItem]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self._shapes = {
            True: shapes_of_part(self.meshes, self.split, "train", self.categories, self.limit),
            False: shapes_of_part(self.meshes, self.split, self.part, self.categories),
        }

    def counts(self) -> dict[str, dict[str, int]]:
        """{category: {"training", "judged"}}, numbers of training and of unseen shapes."""
        training, unseen = (
            Counter(shape.category for shape in shapes) for shapes in self._shapes.values()
        )
        return {
            name: {"training": training[name], "judged": unseen[name]} for name in self.categories
        }

    def names_hash(self) -> str:
        """Changes when the names of the shapes do."""
        names = "\n".join(shape.name for shapes in self._shapes.values() for shape in shapes)
        return hashlib.sha256(names.encode()).hexdigest()[:16]

    def data(self, category: str, training: bool, dense: bool = False) -> TrainingData:
        """The training or the unseen shapes of ``category``, or of `ALL`.

        With ``dense`` their targets have 16,384 points.
        """
        names = self.categories if category == ALL else (category,)
        objects = [item for name in names for item in self._items(name, training)]
        if dense:
            shapes = {shape.name: shape for shape in self._shapes[training]}
            objects = [replace(item, target=partial(_dense, shapes[item.name])) for item in objects]
        part = "train" if training else self.part
        return TrainingData(objects, f"{len(objects)} meshes, {part}: {category}")

    def _items(self, category: str, training: bool) -> list[ObjectItem]:
        if (category, training) not in self._rendered:
            views = self.views[0 if training else 1]
            settings = RenderSettings(views=views, size=(self.size, self.size))
            shapes = [shape for shape in self._shapes[training] if shape.category == category]
            items = self._rendered[category, training] = []
            for done, shape in enumerate(shapes, 1):
                seen = see(shape, settings, self.seed)
                target = seen.target.astype(np.float32)
                items.append(rendered_object(shape.name, category, seen.views, target))
                self.report(f"rendering {category}", done, len(shapes))
        return self._rendered[category, training]


def _dense(shape: Shape) -> Floats:
    mesh, rng = shape.mesh(), np.random.default_rng(0)
    return sample_surface(mesh.vertices, mesh.faces, DENSE, rng).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Predicted:
    """What a network makes of one shape.

    index : of the shape in its data.
    points, target : [V, N, 3] and [V, M, 3] float64, prediction and truth for each of the first V
        views, in the object's axes.
    """

    index: int
    category: str
    points: Array
    target: Array


def predict(network: BaseNetwork | None, data: TrainingData) -> list[Predicted]:
    """The clouds that ``network`` predicts from the input views of every shape.

    Without a network they have no points.
    """
    device = next(network.parameters()).device if network else torch.device("cpu")
    predicted = []
    for index, item in enumerate(data.objects):
        draws = [Draw(index, view) for view in range(min(INPUT_VIEWS, len(item.views)))]
        batch = assemble(data, draws, FRAME)
        images = torch.as_tensor(batch.images, device=device)
        with torch.no_grad():
            points = network(images) if network else images.new_empty(len(images), 0, 3)
        clouds = points.cpu().numpy().astype(np.float64)
        targets = np.stack(batch.targets).astype(np.float64)
        predicted.append(Predicted(index, item.category, clouds, targets))
    return predicted


def distances(predicted: list[Predicted]) -> dict[str, float]:
    """Chamfer distance by category under the paper's protocol, x1000.

    The mean over the views of a shape, then over shapes.
    """
    means: dict[str, list[float]] = {}
    for shape in predicted:
        of_views = [
            chamfer(*map(normalise_longest_side, pair)).chamfer
            for pair in zip(shape.points, shape.target, strict=True)
        ]
        means.setdefault(shape.category, []).append(float(np.mean(of_views)))
    return {category: 1e3 * float(np.mean(values)) for category, values in means.items()}


def mean_shape(targets: Sequence[Floats], seed: int = 0, steps: int = MEAN_STEPS) -> Floats:
    """The 1,024 points with the least mean Chamfer distance to ``targets`` (of [1024, 3])."""
    rng = np.random.default_rng([seed, 11])
    stacked = torch.from_numpy(np.stack(targets))
    pool = stacked.reshape(-1, 3)
    chosen = torch.from_numpy(rng.permutation(len(pool))[:POINTS])
    points = pool[chosen].clone().requires_grad_(True)
    optimiser = torch.optim.Adam([points], lr=MEAN_RATE)
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = MEAN_RATE * (1.0 - step / steps)
        batch = stacked[torch.from_numpy(rng.permutation(len(stacked))[:MEAN_BATCH])]
        forward, backward = batch_chamfer(points.expand(len(batch), -1, -1), batch)
        optimiser.zero_grad()
        (forward + backward).mean().backward()
        optimiser.step()
    return np.asarray(points.detach().numpy())


def constant_answer(
    training: TrainingData, unseen: TrainingData, steps: int = MEAN_STEPS
) -> list[Predicted]:
    """The mean training shape as the prediction for every input view."""
    targets = [training.target(i) for i in range(len(training.objects))]
    mean = mean_shape(targets, steps=steps).astype(np.float64)
    return [
        replace(shape, points=np.repeat(mean[None], len(shape.target), axis=0))
        for shape in predict(None, unseen)
    ]
