"""Predictions of a network for a few pictures of a data set."""

from __future__ import annotations

import numpy as np
import torch

from ..evaluation.metrics import chamfer
from ..network.model import BaseNetwork
from ..train.batches import Draw, assemble
from ..train.data import TrainingData
from .curves import Sample


def sample_predictions(network: BaseNetwork, data: TrainingData, frame: str, count: int = 6) -> list[Sample]:
    """Predictions from the first view of ``count`` objects, spread evenly over the data; fewer where there are fewer."""
    samples = []
    device = next(network.parameters()).device
    for index in np.linspace(0, len(data.objects) - 1, min(count, len(data.objects))).round().astype(int).tolist():
        has_target = data.readable(index)
        if data.usable(index, 0, has_target)[0] != index:
            continue  # no picture of it can be read
        batch = assemble(data, [Draw(index, 0)], frame, targets=has_target)
        with torch.no_grad():
            points = network(torch.as_tensor(batch.images, device=device))[0].cpu().numpy().astype(np.float64)
        target = batch.targets[0].astype(np.float64) if batch.targets else None
        distance = None if target is None else chamfer(points, target).chamfer
        samples.append(Sample(data.objects[index].name, batch.images[0], points, target, distance))
    return samples
