"""How good is the base network on shapes it has not seen? Beside it, what needs no network: the mean and the nearest shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...io.checkpoints import load_network
from ...network.model import NetworkConfig
from ...silhouette.chamfer import chamfer
from ...train.batches import Draw, assemble
from ...version import __version__
from .material import Material, Source
from .mean_shape import TURNS, aligned_mean, mean_shape, pair_chamfer, view_targets
from .protocol import Report

Floats = NDArray[np.float32]
PARTS = ("validation", "test")


def study_network(checkpoint: Path, source: Source, report: Report | None = None) -> dict[str, Any]:
    """Judge a network by Chamfer distance on the validation and test shapes of a split, beside three answers without one.

    - ``mean_view``: the mean training shape in the network's own frame, the cloud nearest on average to all training
      targets as the cameras see them. It is what a network that ignores the picture would learn.
    - ``mean_aligned``: the mean training shape in the objects' frame, turned toward each judged shape by the best of four
      quarter turns: it is told the pose, and told it better than any picture could.
    - ``nearest``: of all training shapes, in the best of four quarter turns, the one nearest to the judged shape: the best that
      retrieval could do, were it told which.

    Parameters
    ----------
    checkpoint : a view-aligned network.
    source : the meshes and their split; ``part`` is ignored.

    Returns
    -------
    A JSON-able record {"study", "settings", "convention", "summary": {part: {category: {...}}}, "shapes": [...]}. Raw.
    """
    network, config = load_network(checkpoint)
    materials = {part: Material(replace(source, part=part), report) for part in PARTS}
    summary: dict[str, dict[str, Any]] = {part: {} for part in PARTS}
    shapes: list[dict[str, Any]] = []
    for category in source.categories:
        training = materials[PARTS[0]].data(category, training=True)
        mean_view = mean_shape(view_targets(training), source.seed)
        own = [training.target(i) for i in range(len(training.objects))]
        mean_aligned = aligned_mean(own, source.seed)
        for part in PARTS:
            judged = materials[part].data(category, training=False)
            rows = []
            for index, item in enumerate(judged.objects):
                batch = assemble(judged, [Draw(index, view) for view in range(len(item.views))], "view")
                truth = judged.target(index)
                rows.append(
                    {
                        "part": part,
                        "shape": item.name,
                        "network": _distances(_predicted(network, batch.images), batch.targets),
                        "mean_view": _distances([mean_view] * len(batch.targets), batch.targets),
                        "mean_aligned": nearest_of([mean_aligned], truth),
                        "nearest": nearest_of(own, truth),
                    }
                )
                if report:
                    report(f"{category}: judging, {part}", index + 1, len(judged.objects))
            shapes += rows
            summary[part][category] = _summary(rows, len(own))
    return {
        "study": "network",
        "version": __version__,
        "settings": {**_about(config), "seed": source.seed, "split": source.split.name, "device": "cpu"},
        "convention": "squared distances, mean over points, forward + backward; targets of longest side 1, in the view's frame",
        "summary": summary,
        "shapes": shapes,
    }


def nearest_of(clouds: Sequence[Floats], truth: Floats) -> float:
    """Chamfer distance from ``truth`` to the nearest of ``clouds``, in the best of four quarter turns."""
    return min(pair_chamfer(cloud, truth @ turn) for cloud in clouds for turn in TURNS)


def _distances(clouds: Sequence[Floats] | Tensor, targets: Sequence[Floats]) -> float:
    stacked = clouds if isinstance(clouds, Tensor) else torch.from_numpy(np.stack(clouds))
    forward, backward = chamfer(stacked, torch.from_numpy(np.stack(targets)))
    return float((forward + backward).mean())


def _predicted(network: torch.nn.Module, images: Floats) -> Tensor:
    with torch.no_grad():
        points: Tensor = network(torch.from_numpy(images))
    return points


def _summary(rows: list[dict[str, Any]], training: int) -> dict[str, Any]:
    values = {name: np.array([row[name] for row in rows]) for name in ("network", "mean_view", "mean_aligned", "nearest")}
    means = {name: float(value.mean()) for name, value in values.items()}
    medians = {f"{name}_median": float(np.median(value)) for name, value in values.items()}
    return {
        "shapes": len(rows),
        "training_shapes": training,
        **means,
        **medians,
        "over_mean_view": means["network"] / means["mean_view"],
        "over_mean_aligned": means["network"] / means["mean_aligned"],
        "over_nearest": means["network"] / means["nearest"],
    }


def _about(config: NetworkConfig) -> dict[str, Any]:
    return {"steps": config.steps, "training_set": config.training_set, "points": config.points, "sigma_sq": config.sigma_sq}
