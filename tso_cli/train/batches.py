"""Batches of training data. A batch depends on seed and step alone."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Floats
from ..geometry.camera import CANONICAL_ROTATION, Camera
from ..network.input import NetworkInput
from .data import TrainingData

MIRROR = np.diag([-1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Batch:
    """B objects, each with V supervising masks. V is 0 if masks do not supervise."""

    images: Floats  # [B, 3, 64, 64]
    # B times [M, 3], in the frame of the prediction; empty if only masks supervise
    targets: list[Floats]
    masks: Floats  # [B, V, 64, 64]
    known: Floats  # [B, V, 64, 64], 1 or 0
    K: NDArray[np.float64]  # [B, V, 3, 3]
    R: NDArray[np.float64]  # [B, V, 3, 3], frame of the prediction to camera
    t: NDArray[np.float64]  # [B, V, 3]
    categories: list[str]  # B names

    def select(self, indices: NDArray[np.int64]) -> Batch:
        """The objects at ``indices``."""

        def rows(values: Any) -> Any:
            if isinstance(values, np.ndarray):
                return values[indices]
            return [values[i] for i in indices if values]

        return Batch(*(rows(getattr(self, field.name)) for field in fields(self)))


@dataclass(frozen=True)
class Drawing:
    """How batches are drawn.

    size : number of objects in a step.
    views : V, the number of supervising masks of each object.
    targets : whether batches hold the points of each object.
    input_supervises : the mask of the input view supervises, and no other (V = 1).
    balance : draw every category equally often, however many objects it has.
    augment : mirror half of the pictures (view frame only), and change brightness, contrast and
        colour of the objects.
    """

    seed: int
    size: int
    frame: str
    views: int = 0
    targets: bool = True
    input_supervises: bool = False
    balance: bool = False
    augment: bool = False


@dataclass(frozen=True, eq=False)
class Draw:
    """One object of a batch.

    index : index of the object.
    view : number of its input view.
    supervising : numbers of the views whose masks supervise.
    mirror : whether left and right are exchanged.
    colour_seed : seed of the change of colours; None keeps them.
    background_seed : seed of the background.
    """

    index: int
    view: int
    supervising: tuple[int, ...] = ()
    mirror: bool = False
    colour_seed: int | None = None
    background_seed: int = 0


def draw_batch(
    data: TrainingData, drawing: Drawing, step: int, part: tuple[int, int] = (0, 1)
) -> Batch:
    """The batch of a step, or its part for one process: ``part`` is (rank, processes).

    Objects are drawn in a random order, which is new after all objects (with ``balance``: all
    objects of the category) have been drawn. The input view and the supervising views are drawn at
    random. The supervising views are all different, and may include the input view.
    """
    rng = np.random.default_rng([drawing.seed, 1, step])
    draws = []
    for place in range(step * drawing.size, (step + 1) * drawing.size):
        index = _object_at(data, drawing, place)
        count = len(data.objects[index].views)
        # All these are drawn under any settings, so that a setting does not change other draws.
        view = int(rng.integers(count))
        supervising = rng.permutation(count)[: drawing.views].tolist()
        mirror = bool(rng.random() < 0.5) and drawing.augment and drawing.frame == "view"
        colour_seed, background_seed = (int(rng.integers(2**31)) for _ in range(2))
        if drawing.input_supervises:
            supervising = [view]
        colour = colour_seed if drawing.augment else None
        draws.append(Draw(index, view, tuple(supervising), mirror, colour, background_seed))
    return assemble(data, draws[part[0] :: part[1]], drawing.frame, drawing.targets)


def _object_at(data: TrainingData, drawing: Drawing, place: int) -> int:
    """Index of the object at ``place`` in the sequence of all epochs.

    With ``balance`` categories take turns.
    """
    if not drawing.balance:
        epoch, slot = divmod(place, len(data.objects))
        rng = np.random.default_rng([drawing.seed, 2, epoch])
        return int(rng.permutation(len(data.objects))[slot])
    turn, category = divmod(place, len(data.categories))
    members = data.categories[category]
    epoch, slot = divmod(turn, len(members))
    rng = np.random.default_rng([drawing.seed, 3, category, epoch])
    return int(members[rng.permutation(len(members))[slot]])


def assemble(data: TrainingData, draws: list[Draw], frame: str, targets: bool = True) -> Batch:
    """The batch of these draws.

    1. In the view frame (x right, y up, z toward the viewer) the prediction is y = C R0 X, with X
       the object's points, R0 the rotation of the input camera and C = diag(1, -1, -1). Camera v
       sees R_v R0^T C y + t_v.
    2. Mirrored, with M = diag(-1, 1, 1), the prediction is M y, and camera v sees
       M R_v R0^T C M (M y) + M t_v.
    """
    images, points, masks, known = [], [], [], []
    K, R, t, categories = [], [], [], []
    for draw in draws:
        index, number, picture = data.usable(draw.index, draw.view, targets)
        # From rows of X to rows of y.
        to_frame = np.eye(3)
        if frame != "canonical":
            to_frame = (CANONICAL_ROTATION @ picture.camera.R).T
        flip = MIRROR if draw.mirror else np.eye(3)
        image = picture.image
        if draw.colour_seed is not None:
            image = recoloured(picture, np.random.default_rng(draw.colour_seed))
        image = _mirrored(image, draw.mirror)
        if data.backgrounds:
            background = data.backgrounds.sample(np.random.default_rng(draw.background_seed))
            image = image + background * (np.float32(1.0) - _mirrored(picture.mask, draw.mirror))
        images.append(image)
        categories.append(data.objects[index].category)
        if targets:
            points.append((data.target(index) @ (to_frame @ flip)).astype(np.float32))
        # Object and input view may replace unusable ones; the replacement then supervises too.
        numbers = (number if view == draw.view else view for view in draw.supervising)
        views = [data.usable(index, each)[2] for each in numbers]
        masks.append([_mirrored(view.mask, draw.mirror) for view in views])
        known.append([_mirrored(view.known, draw.mirror) for view in views])
        K.append([_intrinsics(view.camera, draw.mirror) for view in views])
        R.append([flip @ view.camera.R @ to_frame @ flip for view in views])
        t.append([flip @ view.camera.t for view in views])
    inputs, masks_array, known_array = (
        np.asarray(rows, dtype=np.float32) for rows in (images, masks, known)
    )
    K_array, R_array, t_array = (np.asarray(rows, dtype=np.float64) for rows in (K, R, t))
    return Batch(inputs, points, masks_array, known_array, K_array, R_array, t_array, categories)


def recoloured(picture: NetworkInput, rng: np.random.Generator) -> Floats:
    """The picture [3, H, W] with light and colour of the object changed; its surroundings stay."""
    gamma, brightness = np.exp(rng.uniform(-0.4, 0.4)), rng.uniform(-0.5, 0.3)
    gain = np.exp(brightness + rng.uniform(-0.4, 0.4) * rng.uniform(-1.0, 1.0, (3, 1, 1)))
    offset = rng.uniform(-0.1, 0.1)
    changed = np.clip(np.power(picture.image, gamma) * gain + offset, 0.0, 1.0)
    # The soft mask blends the rim of the object as before.
    opacity = picture.mask[None]
    return (picture.image * (1.0 - opacity) + changed * opacity).astype(np.float32)


def _mirrored(pixels: NDArray[Any], mirror: bool) -> NDArray[Any]:
    return pixels[..., ::-1] if mirror else pixels


def _intrinsics(camera: Camera, mirror: bool) -> NDArray[np.float64]:
    """K of the picture; mirrored, u becomes W - 1 - u, and the camera's x becomes -x."""
    if not mirror:
        return camera.K
    K = camera.K.copy()
    K[0, 1:] = -K[0, 1], camera.width - 1 - K[0, 2]
    return K
