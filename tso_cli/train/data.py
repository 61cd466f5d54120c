"""What training sees: pictures, masks and cameras of objects, drawn anew for every step from (seed, step) alone."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..camera import CANONICAL_ROTATION, Camera
from ..errors import InputError
from ..geometry import normalise_longest_side
from ..network_input import NetworkInput, network_input
from ..scene import View

if TYPE_CHECKING:
    from ..datasets.rendered import RenderedDataset

Floats = NDArray[np.float32]
# Prepared views kept in memory; the rest is read again when it is needed.
CACHE_BYTES = 1 << 30
# Pictures of each shipped mesh, and their side in pixels: about the size of the network's input once cropped.
EXAMPLE_VIEWS, EXAMPLE_SIZE = 32, 96


@dataclass(frozen=True, eq=False)
class TrainingView:
    """One picture of an object; ``load`` gives the image [H, W, 3] uint8 and the mask [H, W] in [0, 1]."""

    camera: Camera
    load: Callable[[], tuple[NDArray[np.uint8], Floats]]
    name: str = "view"


@dataclass(frozen=True, eq=False)
class TrainingObject:
    """One shape: its views, and its surface points [M, 3] centred at the origin with longest side 1."""

    name: str
    views: Sequence[TrainingView]
    target: Floats


@dataclass(frozen=True, eq=False)
class Batch:
    """One step's worth of B objects. V is 0 without mask supervision."""

    images: Floats  # [B, 3, 64, 64]
    targets: list[Floats]  # B times [M, 3], in the frame of the prediction
    masks: Floats  # [B, V, 64, 64]
    known: Floats  # [B, V, 64, 64], 1 or 0
    K: NDArray[np.float64]  # [B, V, 3, 3]
    R: NDArray[np.float64]  # [B, V, 3, 3], frame of the prediction to camera
    t: NDArray[np.float64]  # [B, V, 3]


class TrainingData:
    """Objects prepared for training.

    Parameters
    ----------
    objects : at least one, each with at least one view.
    description : what they are, in words; it is written into the checkpoint.
    crop_share, background : how a picture becomes network input (see `network_input`).
    """

    def __init__(
        self, objects: Sequence[TrainingObject], description: str, crop_share: float = 0.9, background: str = "black"
    ) -> None:
        if not objects:
            raise InputError("the training set holds no object, expected at least one")
        for item in objects:
            if not item.views:
                raise InputError(f"{item.name}: has no view, expected at least one")
            for view in item.views:
                if view.camera.model != "perspective":
                    raise InputError(f"{view.name}: its camera is {view.camera.model}, expected perspective for training")
        self.objects, self.description = list(objects), description
        self.crop_share, self.background = crop_share, background
        self._cache: dict[tuple[int, int], NetworkInput] = {}
        self._cached_bytes = 0

    def fingerprint(self) -> str:
        """Changes when objects, cameras or targets do: a resumed run must see the same data."""
        digest = hashlib.sha256(f"{self.crop_share}/{self.background}".encode())
        for item in self.objects:
            digest.update(f"{item.name}/{len(item.views)}".encode())
            digest.update(np.ascontiguousarray(item.target, dtype=np.float32).tobytes())
            for view in item.views:
                for matrix in (view.camera.K, view.camera.R, view.camera.t):
                    digest.update(matrix.tobytes())
        return digest.hexdigest()[:16]

    def prepared(self, index: int, view: int) -> NetworkInput:
        """Picture, mask and camera of one view, cropped as the network's input."""
        key = (index, view)
        if key in self._cache:
            return self._cache[key]
        source = self.objects[index].views[view]
        image, mask = source.load()
        prepared = network_input(
            image, View(mask, source.camera, name=source.name), crop_share=self.crop_share, background=self.background
        )
        size = prepared.image.nbytes + prepared.mask.nbytes + prepared.known.nbytes
        if self._cached_bytes + size <= CACHE_BYTES:
            self._cache[key] = prepared
            self._cached_bytes += size
        return prepared

    def batch(self, seed: int, step: int, size: int, views: int, frame: str) -> Batch:
        """The batch of a step, a function of its arguments alone.

        Objects come in a new random order every time all have been seen; the input view and the ``views`` supervising
        views (all different; the input view may be among them) are drawn at random.
        """
        rng = np.random.default_rng([seed, 1, step])
        pairs = []
        for place in range(step * size, (step + 1) * size):
            epoch, slot = divmod(place, len(self.objects))
            index = int(np.random.default_rng([seed, 2, epoch]).permutation(len(self.objects))[slot])
            count = len(self.objects[index].views)
            pairs.append((index, int(rng.integers(count)), rng.permutation(count)[:views].tolist()))
        return self.assemble(pairs, frame)

    def assemble(self, chosen: Sequence[tuple[int, int, list[int]]], frame: str) -> Batch:
        """A batch of (object, input view, supervising views).

        In the view frame the prediction is y = C R0 X, with X the object's points, R0 the rotation of the input camera and
        C = diag(1, -1, -1): x right, y up, z toward the viewer. Camera v then sees R_v R0^T C y + t_v.
        """
        images, targets, masks, known = [], [], [], []
        K, R, t = [], [], []
        for index, given, supervising in chosen:
            picture = self.prepared(index, given)
            # rows of X times this are rows of y; identity in the canonical frame
            turn = np.eye(3) if frame == "canonical" else (CANONICAL_ROTATION @ picture.camera.R).T
            images.append(picture.image)
            targets.append((self.objects[index].target @ turn).astype(np.float32))
            seen = [self.prepared(index, view) for view in supervising]
            masks.append([item.mask for item in seen])
            known.append([item.known for item in seen])
            K.append([item.camera.K for item in seen])
            R.append([item.camera.R @ turn for item in seen])
            t.append([item.camera.t for item in seen])
        return Batch(
            np.stack(images),
            targets,
            np.asarray(masks, dtype=np.float32),
            np.asarray(known, dtype=np.float32),
            np.asarray(K, dtype=np.float64),
            np.asarray(R, dtype=np.float64),
            np.asarray(t, dtype=np.float64),
        )


def from_folder(dataset: RenderedDataset, crop_share: float = 0.9, background: str = "black") -> TrainingData:
    """The folder that `tso render` wrote as training data; pictures are read when they are first needed."""

    def loader(view: object) -> Callable[[], tuple[NDArray[np.uint8], Floats]]:
        return lambda: (view.image(), view.mask())  # type: ignore[attr-defined]

    objects = [
        TrainingObject(
            item.name,
            [TrainingView(view.camera, loader(view), str(view.mask_path)) for view in item.views],
            item.target(),
        )
        for item in dataset.objects
    ]
    described = f"{dataset.folder.resolve().name}: {len(objects)} objects"
    return TrainingData(objects, described, crop_share, background)


def from_meshes(
    meshes: Sequence[Path],
    description: str,
    crop_share: float = 0.9,
    background: str = "black",
    seed: int = 0,
    progress: Callable[[int, int, str], None] | None = None,
    views: int = EXAMPLE_VIEWS,
    size: int = EXAMPLE_SIZE,
) -> TrainingData:
    """Meshes rendered in memory; the pictures of each depend on ``seed`` and its place in the list alone."""
    from ..files.meshes import read_mesh
    from ..render import RenderSettings, render_mesh

    settings = RenderSettings(views=views, size=(size, size))
    objects = []
    for number, path in enumerate(meshes):
        name = f"{path.parent.name}/{path.stem}"
        rendered = render_mesh(read_mesh(path), settings, np.random.default_rng([seed, number]), name)
        taken = [
            TrainingView(view.camera, _in_memory(view.image, view.mask), f"{name} view {i}")
            for i, view in enumerate(rendered.views)
        ]
        objects.append(TrainingObject(name, taken, rendered.target))
        if progress:
            progress(number + 1, len(meshes), "")
    return TrainingData(objects, description, crop_share, background)


def shipped_examples(crop_share: float = 0.9, background: str = "black") -> TrainingData:
    """The pictures of the shipped examples with their true shapes: unseen by a network trained on the shipped meshes."""
    from ..files.cameras import read_camera
    from ..files.clouds import read_cloud
    from ..files.images import read_image, read_mask
    from ..files.shipped import CATEGORIES, examples_folder

    objects = []
    for category in CATEGORIES:
        folder = examples_folder() / category
        image, mask = read_image(folder / "image.png"), read_mask(folder / "mask.png")
        camera = read_camera(folder / "camera.json", mask.shape[1], mask.shape[0])
        view = TrainingView(camera, _loaded(image[..., :3], mask), str(folder / "mask.png"))
        target = normalise_longest_side(read_cloud(folder / "target.ply").points).astype(np.float32)
        objects.append(TrainingObject(category, [view], target))
    return TrainingData(objects, "shipped examples", crop_share, background)


def _loaded(image: NDArray[np.uint8], mask: Floats) -> Callable[[], tuple[NDArray[np.uint8], Floats]]:
    return lambda: (image, mask)


def _in_memory(image: NDArray[np.uint8], mask: NDArray[np.uint8]) -> Callable[[], tuple[NDArray[np.uint8], Floats]]:
    return lambda: (image, mask.astype(np.float32) / np.float32(255.0))
