"""One step's worth of data, drawn from (seed, step) alone: whoever asks for it, and whenever, gets the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import CANONICAL_ROTATION
from ..network.input import NetworkInput
from .data import TrainingData

Floats = NDArray[np.float32]
# Left and right exchanged, of pixels and of x alike.
MIRROR = np.diag([-1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Batch:
    """B objects. V is 0 without mask supervision."""

    images: Floats  # [B, 3, 64, 64]
    targets: list[Floats]  # B times [M, 3], in the frame of the prediction; empty where only masks supervise
    masks: Floats  # [B, V, 64, 64]
    known: Floats  # [B, V, 64, 64], 1 or 0
    K: NDArray[np.float64]  # [B, V, 3, 3]
    R: NDArray[np.float64]  # [B, V, 3, 3], frame of the prediction to camera
    t: NDArray[np.float64]  # [B, V, 3]
    categories: list[str]  # B of them

    def select(self, chosen: NDArray[np.int64]) -> Batch:
        """The objects at the indices ``chosen``."""
        return Batch(
            self.images[chosen],
            [self.targets[i] for i in chosen] if self.targets else [],
            self.masks[chosen],
            self.known[chosen],
            self.K[chosen],
            self.R[chosen],
            self.t[chosen],
            [self.categories[i] for i in chosen],
        )


@dataclass(frozen=True)
class Drawing:
    """How batches are drawn.

    Parameters
    ----------
    seed, size, frame : of the run; ``size`` objects a step.
    views : V, the supervising masks of each object.
    targets : whether the points of each object are wanted.
    own_view : the input view itself is the one that supervises (V = 1).
    balance : every category equally often, however many objects it has.
    augment : mirror half of the pictures (view frame only) and change brightness, contrast and colour of the object.
    """

    seed: int
    size: int
    frame: str
    views: int = 0
    targets: bool = True
    own_view: bool = False
    balance: bool = False
    augment: bool = False


@dataclass(frozen=True, eq=False)
class Draw:
    """One object of a batch.

    index : of the object; given : number of its input view; supervising : numbers of the views whose masks supervise.
    mirror : left for right; colour : a seed, None leaves the colours; behind : the seed of the background.
    """

    index: int
    given: int
    supervising: tuple[int, ...] = ()
    mirror: bool = False
    colour: int | None = None
    behind: int = 0


def draw_batch(data: TrainingData, drawing: Drawing, step: int, part: tuple[int, int] = (0, 1)) -> Batch:
    """The batch of a step, or of it the share that process ``part`` = (rank, processes) works on.

    Objects come in a new random order every time all have been seen (those of each category, with ``balance``); the input
    view and the supervising views (all different; the input view may be among them) are drawn at random.
    """
    rng = np.random.default_rng([drawing.seed, 1, step])
    draws = []
    for place in range(step * drawing.size, (step + 1) * drawing.size):
        index = _object_at(data, drawing, place)
        count = len(data.objects[index].views)
        given = int(rng.integers(count))
        order = rng.permutation(count)[: drawing.views].tolist()
        mirror = bool(rng.random() < 0.5)
        colour, behind = (int(rng.integers(2**31)) for _ in range(2))
        draws.append(
            Draw(
                index,
                given,
                (given,) if drawing.own_view else tuple(order),
                mirror and drawing.augment and drawing.frame == "view",
                colour if drawing.augment else None,
                behind,
            )
        )
    return assemble(data, draws[part[0] :: part[1]], drawing.frame, drawing.targets)


def _object_at(data: TrainingData, drawing: Drawing, place: int) -> int:
    """The object at ``place`` of the endless row of objects."""
    if not drawing.balance:
        epoch, slot = divmod(place, len(data.objects))
        return int(np.random.default_rng([drawing.seed, 2, epoch]).permutation(len(data.objects))[slot])
    which = place % len(data.categories)
    members = data.categories[which]
    epoch, slot = divmod(place // len(data.categories), len(members))
    return int(members[np.random.default_rng([drawing.seed, 3, which, epoch]).permutation(len(members))[slot]])


def assemble(data: TrainingData, draws: list[Draw], frame: str, targets: bool = True) -> Batch:
    """The batch of these draws.

    In the view frame the prediction is y = C R0 X, with X the object's points, R0 the rotation of the input camera and
    C = diag(1, -1, -1): x right, y up, z toward the viewer. Camera v then sees R_v R0^T C y + t_v. Mirrored, with
    M = diag(-1, 1, 1), the prediction is M y and camera v sees M R_v R0^T C M (M y) + M t_v.
    """
    images, points, masks, known = [], [], [], []
    K, R, t, categories = [], [], [], []
    for draw in draws:
        index, given, picture = data.usable(draw.index, draw.given, targets)
        # rows of X times this are rows of y; identity in the canonical frame
        turn = np.eye(3) if frame == "canonical" else (CANONICAL_ROTATION @ picture.camera.R).T
        flip = MIRROR if draw.mirror else np.eye(3)
        image = picture.image if draw.colour is None else recoloured(picture, np.random.default_rng(draw.colour))
        image = _mirrored(image, draw.mirror)
        if data.backgrounds:
            behind = data.backgrounds.sample(np.random.default_rng(draw.behind))
            image = image + behind * (np.float32(1.0) - _mirrored(picture.mask, draw.mirror))
        images.append(image)
        categories.append(data.objects[index].category)
        if targets:
            points.append((data.target(index) @ (turn @ flip)).astype(np.float32))
        # The object or its input view may have been replaced; then the same object supervises.
        views = [given if view == draw.given else view for view in draw.supervising]
        seen = [data.usable(index, view)[2] for view in views]
        masks.append([_mirrored(item.mask, draw.mirror) for item in seen])
        known.append([_mirrored(item.known, draw.mirror) for item in seen])
        K.append([_mirrored_intrinsics(item, draw.mirror) for item in seen])
        R.append([flip @ item.camera.R @ turn @ flip for item in seen])
        t.append([flip @ item.camera.t for item in seen])
    return Batch(
        np.stack(images).astype(np.float32, copy=False),
        points,
        np.asarray(masks, dtype=np.float32),
        np.asarray(known, dtype=np.float32),
        np.asarray(K, dtype=np.float64),
        np.asarray(R, dtype=np.float64),
        np.asarray(t, dtype=np.float64),
        categories,
    )


def recoloured(picture: NetworkInput, rng: np.random.Generator) -> Floats:
    """The object [3, H, W] in another light and colour; what stands around it stays as it is."""
    gamma, brightness = np.exp(rng.uniform(-0.4, 0.4)), rng.uniform(-0.5, 0.3)
    gain = np.exp(brightness + rng.uniform(-0.4, 0.4) * rng.uniform(-1.0, 1.0, (3, 1, 1)))
    offset = rng.uniform(-0.1, 0.1)
    # The mask is the object's share of each pixel, so that its rim blends as before.
    share = picture.mask[None]
    changed = np.clip(np.power(picture.image, gamma) * gain + offset, 0.0, 1.0)
    return (picture.image * (1.0 - share) + changed * share).astype(np.float32)


def _mirrored(pixels: NDArray[Any], mirror: bool) -> NDArray[Any]:
    return pixels[..., ::-1] if mirror else pixels


def _mirrored_intrinsics(item: NetworkInput, mirror: bool) -> NDArray[np.float64]:
    """K of the picture with its columns in reverse: u becomes W - 1 - u, and x of the camera -x."""
    if not mirror:
        return item.camera.K
    K = item.camera.K.copy()
    K[0, 1] = -K[0, 1]
    K[0, 2] = item.camera.width - 1 - K[0, 2]
    return K
