"""Training data that is not a data set on disk: meshes rendered in memory, shipped examples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..datasets.common import load_pair
from ..datasets.items import Dataset, ObjectItem, ViewItem
from ..datasets.scale import of_unit_diagonal
from ..geometry.arrays import Floats
from ..geometry.points import normalise_longest_side
from ..io.cameras import read_cameras
from ..io.clouds import read_cloud
from ..io.meshes import read_mesh
from ..io.shipped import CATEGORIES, examples_folder
from ..network import Background
from ..render.folder import render_mesh
from ..render.rays import RenderedView
from ..render.settings import RenderSettings
from .data import TrainingData


def from_meshes(
    meshes: Sequence[Path],
    description: str,
    crop_share: float = 0.9,
    background: Background = "black",
    progress: Callable[[int, int, str], None] | None = None,
    views: int = 32,
) -> TrainingData:
    """Meshes rendered in memory; the pictures of a mesh depend only on its place in the list.

    With a ``crop_share`` of 0 the meshes get a unit diagonal, like ShapeNet's models, so that the
    pictures show sizes.
    """
    # After the crop the pictures have about the size of the network's input.
    settings = RenderSettings(views=views, size=(96, 96))
    objects = []
    for number, path in enumerate(meshes):
        rendered = render_mesh(read_mesh(path), settings, np.random.default_rng([0, number]))
        category = path.parent.name
        objects.append(
            rendered_object(f"{category}/{path.stem}", category, rendered.views, rendered.target)
        )
        if progress:
            progress(number + 1, len(meshes), "")
    return sized(Dataset(objects, description), crop_share, background)


def sized(dataset: Dataset, crop_share: float, background: Background = "black") -> TrainingData:
    """Objects of longest side 1 as training data.

    They are scaled to unit diagonal if ``crop_share`` is 0, because pictures then show sizes.
    """
    dataset = dataset if crop_share else of_unit_diagonal(dataset)
    return TrainingData(
        dataset.objects, dataset.description, crop_share, background, scale=dataset.scale
    )


def rendered_object(
    name: str, category: str, views: Sequence[RenderedView], target: Floats
) -> ObjectItem:
    """A shape whose pictures and points [P, 3] are held in memory."""

    def pixels_of(view: RenderedView) -> Callable[[], tuple[NDArray[np.uint8], Floats]]:
        # Kept in bytes, because a mask of floats takes four times the memory.
        return lambda: (view.image, view.mask.astype(np.float32) / np.float32(255.0))

    items = [
        ViewItem(f"{name} view {i}", view.camera, pixels_of(view)) for i, view in enumerate(views)
    ]
    return ObjectItem(name, category, items, lambda: target)


def shipped_examples(crop_share: float = 0.9, background: Background = "black") -> TrainingData:
    """The pictures and true shapes of the shipped examples.

    A network that is trained on the shipped meshes has not seen them.
    """
    objects = []
    for category in CATEGORIES:
        folder = examples_folder() / category
        camera = read_cameras(folder / "camera.json")[0].camera
        image, mask = folder / "image.png", folder / "mask.png"
        view = ViewItem(str(mask), camera, partial(load_pair, image, mask, camera, "as its camera"))
        target = partial(_normalised_cloud, folder / "target.ply")
        objects.append(ObjectItem(category, category, [view], target))
    return sized(Dataset(objects, "shipped examples"), crop_share, background)


def _normalised_cloud(path: Path) -> Floats:
    return normalise_longest_side(read_cloud(path).points).astype(np.float32)
