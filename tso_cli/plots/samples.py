"""What a network makes of a few pictures of a data set."""

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
    found = []
    device = next(network.parameters()).device
    for index in np.unique(np.linspace(0, len(data.objects) - 1, min(count, len(data.objects))).round().astype(int)):
        item = data.objects[index]
        known = data.readable(int(index))
        if data.usable(int(index), 0, known)[0] != index:
            continue  # no picture of it can be read
        batch = assemble(data, [Draw(int(index), 0)], frame, targets=known)
        with torch.no_grad():
            points = network(torch.as_tensor(batch.images, device=device))[0].cpu().numpy().astype(np.float64)
        target = batch.targets[0].astype(np.float64) if batch.targets else None
        distance = None if target is None else chamfer(points, target).chamfer
        found.append(Sample(item.name, batch.images[0], points, target, distance))
    return found
