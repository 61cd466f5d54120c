"""Networks judged on shapes they never saw, and the best answer without a network: the mean training shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ...evaluation.metrics import chamfer
from ...geometry.camera import CANONICAL_ROTATION, Camera
from ...geometry.points import Array, normalise_longest_side
from ...network.model import BaseNetwork
from ...silhouette.chamfer import chamfer as batch_chamfer
from ...train.batches import Draw, assemble
from ...train.data import TrainingData

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


@dataclass(frozen=True, eq=False)
class Predicted:
    """What a network makes of one shape.

    index : of the shape in its data.
    points, target : [v, N, 3] and [v, M, 3] float64, prediction and truth for each of the first v views.
    frame : "canonical" or "view", that of both.
    """

    index: int
    category: str
    points: Array
    target: Array
    frame: str


def predict(network: BaseNetwork | None, data: TrainingData, frame: str) -> list[Predicted]:
    """The clouds that ``network`` predicts from the judged views of every shape; without a network no points."""
    device = next(network.parameters()).device if network else torch.device("cpu")
    predicted = []
    for index, item in enumerate(data.objects):
        batch = assemble(data, [Draw(index, view) for view in range(min(JUDGED_VIEWS, len(item.views)))], frame)
        images = torch.as_tensor(batch.images, device=device)
        with torch.no_grad():
            points = network(images) if network else images.new_empty(len(images), 0, 3)
        clouds, targets = points.cpu().numpy().astype(np.float64), np.stack(batch.targets).astype(np.float64)
        predicted.append(Predicted(index, item.category, clouds, targets, frame))
    return predicted


def judge(predicted: list[Predicted]) -> dict[str, float]:
    """Chamfer distance by category under the paper's protocol, x1000: means over the views of a shape, then over shapes."""
    means: dict[str, list[float]] = {}
    for shape in predicted:
        scaled = [[normalise_longest_side(cloud) for cloud in pair] for pair in zip(shape.points, shape.target, strict=True)]
        means.setdefault(shape.category, []).append(float(np.mean([chamfer(*pair).chamfer for pair in scaled])))
    return {category: 1e3 * float(np.mean(values)) for category, values in means.items()}


def object_axes(points: Array, camera: Camera, frame: str) -> Array:
    """Predicted ``points`` [N, 3] in the object's own axes; ``camera`` is that of the input view."""
    return points if frame == "canonical" else points @ (CANONICAL_ROTATION @ camera.R)


def camera_axes(points: Array, camera: Camera, frame: str) -> Array:
    """Predicted ``points`` [N, 3] in the axes of the input camera: right, down, away from it."""
    return object_axes(points, camera, frame) @ camera.R.T


def mean_shape(targets: Sequence[Floats], seed: int = 0, steps: int = MEAN_STEPS) -> Floats:
    """The cloud of 1,024 points with the least mean Chamfer distance to ``targets`` (of [1024, 3])."""
    rng = np.random.default_rng([seed, 11])
    stacked = torch.from_numpy(np.stack(targets))
    pool = stacked.reshape(-1, 3)
    points = pool[torch.from_numpy(rng.permutation(len(pool))[:POINTS])].clone().requires_grad_(True)
    optimiser = torch.optim.Adam([points], lr=MEAN_RATE)
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = MEAN_RATE * (1.0 - step / steps)
        batch = stacked[torch.from_numpy(rng.permutation(len(stacked))[:MEAN_BATCH])]
        forward, backward = batch_chamfer(points.expand(len(batch), -1, -1), batch)
        optimiser.zero_grad()
        (forward + backward).mean().backward()
        optimiser.step()
    mean: Floats = points.detach().numpy()
    return mean


def constant_answer(training: TrainingData, judged: TrainingData, frame: str) -> list[Predicted]:
    """The mean training shape in ``frame`` as the prediction for every view that is judged."""
    canonical = frame == "canonical"
    targets = [training.target(i) for i in range(len(training.objects))] if canonical else view_targets(training)
    mean = mean_shape(targets).astype(np.float64)
    return [replace(shape, points=np.repeat(mean[None], len(shape.target), axis=0)) for shape in predict(None, judged, frame)]


def view_targets(data: TrainingData, views: int = 8) -> list[Floats]:
    """Targets as the first cameras of each object see them."""
    draws = [Draw(index, view) for index, item in enumerate(data.objects) for view in range(min(views, len(item.views)))]
    return assemble(data, draws, "view").targets
