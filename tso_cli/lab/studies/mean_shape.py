"""The best constant answer: the cloud that is nearest on average to the training shapes, whatever the picture shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from ...silhouette.chamfer import chamfer
from ...train.batches import Draw, assemble
from ...train.data import TrainingData
from .judging import Predicted, predict

Floats = NDArray[np.float32]
MEAN_SHAPE = "mean training shape"
"""Its name in tables."""
POINTS = 1024
# Adam's; by then the loss has stopped falling in the third digit.
MEAN_STEPS, MEAN_RATE, MEAN_BATCH = 300, 3e-3, 16
# Quarter turns about y: shapes of one category may face any of four ways.
TURNS = tuple(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]], dtype=np.float32) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1)))


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
        forward, backward = chamfer(points.expand(len(batch), -1, -1), batch)
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


def aligned_mean(targets: Sequence[Floats], seed: int = 0) -> Floats:
    """The mean shape of ``targets`` in the quarter turns that fit it best; turns and mean alternate three times."""
    mean = targets[0]
    for _ in range(3):
        turned = [min((target @ turn for turn in TURNS), key=lambda cloud: pair_chamfer(mean, cloud)) for target in targets]
        mean = mean_shape(turned, seed)
    return mean


def view_targets(data: TrainingData, views: int = 8) -> list[Floats]:
    """Targets as the first cameras of each object see them."""
    draws = [Draw(index, view) for index, item in enumerate(data.objects) for view in range(min(views, len(item.views)))]
    return assemble(data, draws, "view").targets


def pair_chamfer(points: Floats, target: Floats) -> float:
    """Chamfer distance between two clouds [N, 3] and [M, 3], both directions summed."""
    forward, backward = chamfer(torch.from_numpy(points)[None], torch.from_numpy(target)[None])
    return float(forward + backward)
