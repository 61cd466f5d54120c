"""What batches are drawn from: scenes and shapes as tensors on the device of the training."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...geometry.arrays import Indices
from .neighbours import Neighbours, find_neighbours
from .predictions import Predictions
from .scenes import Scene, draw_scenes
from .shapes import Progress, Shape, ShapeSet


@dataclass(frozen=True, eq=False)
class Bank:
    """S scenes of N shapes. Indices are numpy arrays; what they index are tensors on a device.

    shape : [S], the index of the shape of each scene.
    truths : [S, 2, POINTS, 3], two samplings of the shape in each scene.
    rotation, closeness, distance, window : [S, VIEWS, ...], see `scenes.Scene`.
    samplings : [N, 2, POINTS, 3] of the shapes.
    mirror_axes : [N], see `shapes.Shape`.
    predicted, prediction, predicted_chance : see `predictions.Predictions`.
    """

    shape: Indices
    truths: Tensor
    rotation: Tensor
    closeness: Tensor
    distance: Tensor
    window: Tensor
    samplings: Tensor
    mirror_axes: Indices
    neighbours: Neighbours
    predicted: Tensor
    prediction: Indices
    predicted_chance: float

    @property
    def device(self) -> torch.device:
        return self.truths.device


def build_bank(
    shapes: ShapeSet,
    scenes: int,
    seed: int,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
    predict: Callable[[Sequence[Scene]], Predictions] | None = None,
) -> Bank:
    """Draw ``scenes`` scenes of the shapes; the same seed gives the same bank.

    ``predict`` predicts some of the scenes. One scene takes about 20 ms. Raises InputError if the
    shapes cannot be seen in any mask.
    """
    drawn = draw_scenes(shapes, scenes, seed, progress)
    predictions = predict(drawn) if predict else Predictions.none(scenes)

    def stacked(items: Sequence[Scene | Shape], name: str) -> Tensor:
        return torch.from_numpy(np.stack([getattr(item, name) for item in items])).to(device)

    return Bank(
        shape=np.array([scene.shape for scene in drawn]),
        truths=stacked(drawn, "samplings"),
        rotation=stacked(drawn, "rotation"),
        closeness=stacked(drawn, "closeness"),
        distance=stacked(drawn, "distance"),
        window=stacked(drawn, "window"),
        samplings=stacked(shapes.shapes, "samplings"),
        mirror_axes=np.array([shape.mirror_axis for shape in shapes.shapes]),
        neighbours=find_neighbours(shapes.shapes, np.random.default_rng([seed, 2])),
        predicted=torch.from_numpy(predictions.clouds).to(device),
        prediction=predictions.of_scene,
        predicted_chance=predictions.chance,
    )
