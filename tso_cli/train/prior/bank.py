"""What batches are drawn from: scenes and shapes as tensors on the device of the training."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...geometry.arrays import Indices
from ...workers.pool import WorkerPool
from .masks import SCENE_GRID
from .neighbours import Neighbours, find_neighbours
from .predictions import Predictions
from .scenes import CHANCES, Chances, Scene, SceneView, numbered_scene
from .shapes import Progress, ShapeSet

Draw = Callable[[ShapeSet, range], list[Scene]]
# Scenes that a process draws at once.
CHUNK = 25


@dataclass(frozen=True, eq=False)
class Bank:
    """S scenes of N shapes. Indices are numpy arrays; what they index are tensors on a device.

    shape : [S], the index of the shape of each scene.
    truths : [S, 2, POINTS, 3], two samplings of the shape in each scene.
    rotation, closeness, distance, window, foreign, hidden, outline, size : [S, VIEWS, ...], see
        `scenes.SceneView`.
    depth : [D, VIEWS, SCENE_GRID, SCENE_GRID], of the scenes that have depth maps.
    of_depth : [S], the row in ``depth``, or -1.
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
    foreign: Tensor
    hidden: Tensor
    outline: Tensor
    size: Tensor
    depth: Tensor
    of_depth: Indices
    samplings: Tensor
    mirror_axes: Indices
    neighbours: Neighbours
    predicted: Tensor
    prediction: Indices
    predicted_chance: float

    @property
    def device(self) -> torch.device:
        return self.truths.device

    def tensor(self, array: NDArray[Any]) -> Tensor:
        """The array on the device; floating-point numbers in single precision."""
        tensor = torch.from_numpy(np.ascontiguousarray(array)).to(self.device)
        return tensor.float() if tensor.is_floating_point() else tensor


def build_bank(
    shapes: ShapeSet,
    scenes: int,
    seed: int,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
    predict: Callable[[Sequence[Scene]], Predictions] | None = None,
    processes: int = 1,
    chances: Chances = CHANCES,
) -> Bank:
    """Draw ``scenes`` scenes of the shapes; the same seed gives the same bank.

    ``predict`` predicts some of the scenes. A scene takes about 40 ms of a process. Raises
    InputError if the shapes cannot be seen in any mask.
    """
    drawn = _drawn(shapes, scenes, seed, chances, processes, progress)
    predictions = predict(drawn) if predict else Predictions.none(scenes)

    def stacked(rows: Sequence[object]) -> Tensor:
        return torch.from_numpy(np.stack([np.asarray(row) for row in rows])).to(device)

    def of_views(name: str) -> Tensor:
        return stacked([[getattr(view, name) for view in scene.views] for scene in drawn])

    depths = [
        np.stack([view.depth for view in scene.views if view.depth is not None])
        for scene in drawn
        if scene.views[0].depth is not None
    ]
    has_depth = np.array([scene.views[0].depth is not None for scene in drawn])
    empty = np.zeros((0, len(drawn[0].views), SCENE_GRID, SCENE_GRID), np.float16)
    of_view = {name: of_views(name) for name in SceneView.__dataclass_fields__ if name != "depth"}
    return Bank(
        shape=np.array([scene.shape for scene in drawn]),
        truths=stacked([scene.samplings for scene in drawn]),
        **of_view,
        depth=stacked(depths) if depths else torch.from_numpy(empty).to(device),
        of_depth=np.where(has_depth, has_depth.cumsum() - 1, -1),
        samplings=stacked([shape.samplings for shape in shapes.shapes]),
        mirror_axes=np.array([shape.mirror_axis for shape in shapes.shapes]),
        neighbours=find_neighbours(shapes.shapes, np.random.default_rng([seed, 2])),
        predicted=torch.from_numpy(predictions.clouds).to(device),
        prediction=predictions.of_scene,
        predicted_chance=predictions.chance,
    )


def _drawn(
    shapes: ShapeSet,
    count: int,
    seed: int,
    chances: Chances,
    processes: int,
    progress: Progress | None,
) -> list[Scene]:
    """``count`` scenes; the number of ``processes`` does not change them."""
    firsts = range(0, count, CHUNK)
    chunks = [range(first, min(first + CHUNK, count)) for first in firsts]
    scenes: list[Scene] = []
    with _mapped(shapes, partial(_chunk, seed, chances), chunks, processes) as results:
        for chunk in results:
            scenes += chunk
            if progress:
                progress(len(scenes), count, "")
    return scenes


def _chunk(seed: int, chances: Chances, shapes: ShapeSet, numbers: range) -> list[Scene]:
    of_shapes = shapes.chances()
    return [numbered_scene(shapes, of_shapes, seed, number, chances) for number in numbers]


@contextmanager
def _mapped(
    shapes: ShapeSet, draw: Draw, chunks: list[range], processes: int
) -> Iterator[Iterator[list[Scene]]]:
    if processes <= 1:
        yield map(partial(draw, shapes), chunks)
        return
    with tempfile.TemporaryDirectory() as folder:
        # Each process reads the shapes once.
        path = Path(folder) / "shapes"
        path.write_bytes(pickle.dumps(shapes))
        pool = WorkerPool(processes)
        try:
            yield pool.map(partial(_of_process, draw, path), chunks)
        finally:
            pool.shutdown(cancel_futures=True)


def _of_process(draw: Draw, path: Path, numbers: range) -> list[Scene]:
    torch.set_num_threads(1)
    return draw(_shapes_of(path), numbers)


@lru_cache(maxsize=1)
def _shapes_of(path: Path) -> ShapeSet:
    shapes: ShapeSet = pickle.loads(path.read_bytes())
    return shapes
