"""Starts that are what a network predicts from a picture of a scene's shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from ...errors import InputError, needed_by
from ...geometry.arrays import Array, Floats, Indices
from ...geometry.camera import CANONICAL_ROTATION, Camera, intrinsics
from ...geometry.view import View
from ...io.checkpoints import load_network
from ...io.meshes import Mesh
from ...io.reading import name_of
from ...io.shipped import CATEGORIES, DEFAULT, named_checkpoint
from ...network.input import network_input
from ...render.rays import RayScene, render_view
from ...render.variation import paint
from .masks import HALF_SIDE
from .scenes import LEAST_FOREGROUND, Scene, deformed
from .shapes import POINTS, Progress, ShapeSet

if TYPE_CHECKING:
    from ...network.model import BaseNetwork, NetworkConfig

# Of the starts of upright scenes of the categories that the network knows. They take the place of
# other shapes.
PREDICTED_SHARE = 0.5
# Pixels along a side of a picture: finer than the network's crop of it.
PICTURE = 128
# Where the y axis of the object, a unit vector, points in an upright picture: at most to a side, at
# least upward, and at most away from the camera, which is hardly lower than the object. In other
# pictures a network that has seen upright ones predicts badly: rolled by 10 degrees, aeroplanes
# that it knows are three times as far off.
MOST_ASIDE, LEAST_UPRIGHT, MOST_AWAY = 0.05, 0.75, 0.1
# Pictures that the network sees at once.
BATCH = 32
# An orthographic view has the picture of a camera that is far away.
SMALLEST_CLOSENESS = 0.05


@dataclass(frozen=True, eq=False)
class Predictor:
    """A network that predicts clouds of at least POINTS points.

    categories : that it knows; None for all.
    name : of its file, `name_of`.
    """

    network: BaseNetwork
    about: NetworkConfig
    categories: tuple[str, ...] | None
    name: str

    @classmethod
    def read(cls, checkpoint: Path) -> Predictor:
        """The network of a checkpoint, or the shipped one (`default`).

        A checkpoint does not say which categories it knows: another one than the shipped one is
        taken to know all. Raises InputError if the file cannot be used, or open3d is missing.
        """
        with needed_by("`predicted_by` needs"):
            if find_spec("open3d") is None:
                raise ModuleNotFoundError("No module named 'open3d'", name="open3d")
        path = named_checkpoint(checkpoint)
        network, about = load_network(path)
        if about.points < POINTS:
            found = f"the network predicts {about.points} points"
            raise InputError(f"{path}: {found}, expected {POINTS} or more for starts of a prior")
        known = CATEGORIES if str(checkpoint) == DEFAULT else None
        return cls(network, about, known, name_of(path, "a checkpoint"))

    def knows(self, category: str) -> bool:
        return self.categories is None or category in self.categories

    def clouds(self, images: Floats) -> Floats:
        """The clouds [B, N, 3] of ``images`` [B, 3, size, size], in the frame of the network."""
        with torch.no_grad():
            points: Floats = self.network(torch.from_numpy(images)).numpy()
        return points


@dataclass(frozen=True, eq=False)
class Predictions:
    """P predictions of S scenes.

    clouds : [P, POINTS, 3] in the frame of the truths; the first k points of each are as dense as
        all.
    of_scene : [S], the number of the prediction of each scene, -1 for a scene without one.
    chance : of a scene with a prediction, to start from it.
    """

    clouds: Floats
    of_scene: Indices
    chance: float

    @classmethod
    def none(cls, scenes: int) -> Predictions:
        """No prediction of any of that number of scenes."""
        return cls(np.zeros((0, POINTS, 3), np.float32), np.full(scenes, -1), 0.0)


def draw_predictions(
    predictor: Predictor,
    shapes: ShapeSet,
    scenes: Sequence[Scene],
    count: int,
    seed: int,
    progress: Progress | None = None,
) -> Predictions:
    """Up to ``count`` predictions, each of another scene of a category that the network knows.

    Each depends on the number of the scene, ``seed`` and the shapes. A hundred take about 10 s.

    Raises InputError if no scene is of such a category, or none can be seen.
    """
    known = [
        number
        for number, scene in enumerate(scenes)
        if predictor.knows(shapes.shapes[scene.shape].category) and _is_upright(scene)
    ]
    if not known:
        what = " or ".join(predictor.categories or ("an object",))
        raise InputError(
            f"`predicted_by`: none of {len(scenes)} scenes shows {what} upright, "
            "expected one that the network can predict; draw more scenes"
        )
    rng = np.random.default_rng([seed, 4])
    chosen = np.sort(rng.choice(known, min(count, len(known)), replace=False)).tolist()
    of_scene, clouds = np.full(len(scenes), -1), list[Floats]()
    for first in range(0, len(chosen), BATCH):
        seen = []
        for number in chosen[first : first + BATCH]:
            rng = np.random.default_rng([seed, 4, number])
            view = _seen(predictor.about, shapes, scenes[number], rng)
            if view is not None:
                seen.append((number, rng, *view))
        images = [image for *_, image in seen]
        predicted = predictor.clouds(np.stack(images)) if images else np.empty((0, 0, 3))
        for (number, rng, rotation, _), points in zip(seen, predicted, strict=True):
            of_scene[number] = len(clouds)
            some = points[rng.permutation(len(points))[:POINTS]]
            clouds.append((some @ rotation).astype(np.float32))
        if progress:
            progress(min(first + BATCH, len(chosen)), len(chosen), "")
    if not clouds:
        raise InputError("`predicted_by`: no scene can be seen in a picture, expected some")
    chance = min(1.0, PREDICTED_SHARE * len(known) / len(clouds))
    return Predictions(np.stack(clouds), of_scene, chance)


def _is_upright(scene: Scene) -> bool:
    """Whether up is up in the first view of a scene, as in the photos that networks learn from."""
    right, down, away = scene.views[0].rotation[:, 1]
    return abs(right) < MOST_ASIDE and -down > LEAST_UPRIGHT and away < MOST_AWAY


def _seen(
    about: NetworkConfig, shapes: ShapeSet, scene: Scene, rng: np.random.Generator
) -> tuple[Array, Floats] | None:
    """The rotation [3, 3] from the truth to the axes of a prediction, and the network's input.

    None if no picture shows enough of the shape.
    """
    shape = shapes.shapes[scene.shape]
    vertices = shape.vertices if scene.lattice is None else deformed(shape, scene.lattice)
    mesh = paint(Mesh(vertices.astype(np.float64), shape.faces.astype(np.int64)), rng)
    # The photo and the mask of a refinement are one picture: the first view of the scene.
    distance = 1.0 / max(scene.views[0].closeness, SMALLEST_CLOSENESS)
    K = intrinsics(distance * PICTURE / (2.0 * HALF_SIDE), PICTURE, PICTURE)
    rotation = scene.views[0].rotation.astype(np.float64)
    camera = Camera(K, rotation, np.array([0.0, 0.0, distance]), PICTURE, PICTURE)
    picture = render_view(RayScene(mesh), camera, rng)
    mask = picture.mask.astype(np.float32) / 255.0
    if not LEAST_FOREGROUND <= (mask > 0.5).sum() < mask.size:
        return None
    crop = about.image_size, about.crop_share, about.background
    image = network_input(picture.image, View(mask, camera, name=shape.name), *crop).image
    # The axes of a view-aligned network: x right, y up, z toward the viewer.
    turn = CANONICAL_ROTATION @ camera.R if about.frame == "view" else np.eye(3)
    return turn, image
