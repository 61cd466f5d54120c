"""Networks judged on shapes they never saw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ...evaluation.metrics import chamfer
from ...geometry.camera import CANONICAL_ROTATION, Camera
from ...geometry.points import Array, normalise_longest_side
from ...network.model import BaseNetwork
from ...train.batches import Draw, assemble
from ...train.data import TrainingData

JUDGED_VIEWS = 4
"""Input views of each shape that are judged, the first ones."""
CONVENTION = {
    "chamfer": "squared distances, mean over points, forward (target -> prediction) + backward (prediction -> target)",
    "capnet": "the paper's protocol: each cloud is centred and scaled to longest side 1 by its own box",
    "plain": "the network's own coordinates against the target's, longest side 1",
}


@dataclass(frozen=True, eq=False)
class Predicted:
    """What a network makes of one shape.

    index : of the shape in its data.
    points, target : [v, N, 3] and [v, M, 3] float64, prediction and truth for each of the first v views.
    frame : "canonical" or "view", that of both.
    """

    index: int
    name: str
    category: str
    points: Array
    target: Array
    frame: str


def predict(network: BaseNetwork | None, data: TrainingData, frame: str, views: int = JUDGED_VIEWS) -> list[Predicted]:
    """The clouds that ``network`` predicts from the first ``views`` views of every shape; without a network no points."""
    device = next(network.parameters()).device if network else torch.device("cpu")
    predicted = []
    for index, item in enumerate(data.objects):
        batch = assemble(data, [Draw(index, view) for view in range(min(views, len(item.views)))], frame)
        images = torch.as_tensor(batch.images, device=device)
        with torch.no_grad():
            points = network(images) if network else images.new_empty(len(images), 0, 3)
        clouds, targets = points.cpu().numpy().astype(np.float64), np.stack(batch.targets).astype(np.float64)
        predicted.append(Predicted(index, item.name, item.category, clouds, targets, frame))
    return predicted


def judge(predicted: list[Predicted]) -> dict[str, Any]:
    """Chamfer distances by category: {category: {"shapes", "capnet": {forward, backward, chamfer}, "plain": {...}}}, raw.

    Means over the views of a shape, then over shapes.
    """
    rows: dict[str, list[Array]] = {}
    for shape in predicted:
        distances = []  # [view, protocol, direction]
        for points, target in zip(shape.points, shape.target, strict=True):
            scaled = normalise_longest_side(points, "prediction"), normalise_longest_side(target, "target")
            both = chamfer(*scaled), chamfer(points, target)
            distances.append([[distance.forward, distance.backward] for distance in both])
        rows.setdefault(shape.category, []).append(np.mean(distances, axis=0))
    judged: dict[str, Any] = {}
    for category, shapes in rows.items():
        judged[category] = {"shapes": len(shapes)}
        for protocol, (forward, backward) in zip(("capnet", "plain"), np.mean(shapes, axis=0).tolist(), strict=True):
            judged[category][protocol] = {"forward": forward, "backward": backward, "chamfer": forward + backward}
    return judged


def object_axes(points: Array, camera: Camera, frame: str) -> Array:
    """Predicted ``points`` [N, 3] in the object's own axes; ``camera`` is that of the input view."""
    return points if frame == "canonical" else points @ (CANONICAL_ROTATION @ camera.R)


def camera_axes(points: Array, camera: Camera, frame: str) -> Array:
    """Predicted ``points`` [N, 3] in the axes of the input camera: right, down, away from it."""
    return object_axes(points, camera, frame) @ camera.R.T
