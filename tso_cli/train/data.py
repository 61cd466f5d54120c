"""What training sees: objects with pictures, masks, cameras and points, prepared once and kept while there is room."""

from __future__ import annotations

import hashlib
import threading
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..datasets.items import ObjectItem
from ..errors import InputError
from ..geometry.camera import Camera
from ..geometry.resampling import Box
from ..geometry.view import View
from ..network.input import NetworkInput, network_input
from .backgrounds import Backgrounds

Floats = NDArray[np.float32]
# Prepared views kept in memory, 16 KiB each; the rest is read again when it is needed.
CACHE_BYTES = 1 << 30
# Pictures left out that are warned of; the command counts them all.
NAMED = 10
# Objects whose first picture tells whether a resumed run sees the same data.
FINGERPRINTED = 16


class TrainingData:
    """Objects prepared for training. Safe to be used from several threads.

    Parameters
    ----------
    objects : at least one, each with at least one view.
    description : what they are, in words; it is written into the checkpoint.
    crop_share, background : how a picture becomes network input (see `network_input`).
    backgrounds : what `batches` puts behind the object, cut out by its mask; needs background "keep", for the network will
        see photos whole.
    strict : an unusable picture is an error; else it is named once, counted in ``unusable``, and another takes its place.
    skipped : what the data set left out before -> why.
    scale : of all clouds and cameras, in words.

    Attributes
    ----------
    categories : indices of the objects of each category, one array a category.
    unusable : picture, or object without points to be read -> why it could not be used.
    not_judged : object -> why its points, which nothing was to learn from, could not be read.
    """

    def __init__(
        self,
        objects: Sequence[ObjectItem],
        description: str,
        crop_share: float = 0.9,
        background: str = "black",
        strict: bool = False,
        backgrounds: Backgrounds | None = None,
        skipped: Mapping[str, str] | None = None,
        scale: str = "longest side 1",
    ) -> None:
        if not objects:
            raise InputError("the training set holds no object, expected at least one")
        for item in objects:
            if not item.views:
                raise InputError(f"{item.name}: has no view, expected at least one")
        first = objects[0].views[0]  # the others when they are loaded: a camera may take reading a model
        _require_perspective(first.name, first.camera)
        self.objects, self.description = objects, description
        if backgrounds is not None and background != "keep":
            raise InputError(f"backgrounds with background {background!r}, expected 'keep': they stay in the picture")
        self.crop_share, self.background, self.strict, self.backgrounds = crop_share, background, strict, backgrounds
        names = sorted({item.category for item in objects})
        self.categories = [np.array([i for i, o in enumerate(objects) if o.category == name]) for name in names]
        self.unusable: dict[str, str] = {}
        self.not_judged: dict[str, str] = {}
        self.skipped, self.scale = dict(skipped or {}), scale
        self._bad: set[tuple[int, int]] = set()
        self._pointed: dict[int, bool] = {}
        self._cache: dict[tuple[int, int], _Packed] = {}
        self._targets: dict[int, Floats] = {}
        self._cached_bytes = 0
        self._lock = threading.Lock()

    def fingerprint(self) -> str:
        """Changes when the objects do, or the first view of a few of them: a resumed run must see the same data."""
        behind = self.backgrounds.source if self.backgrounds else ""
        digest = hashlib.sha256(f"{self.crop_share}/{self.background}/{behind}".encode())
        for item in self.objects:
            digest.update(f"{item.name}/{len(item.views)}".encode())
        for index in self.spread(FINGERPRINTED):
            try:
                first = self.prepared(index, 0)
            except InputError:
                continue  # left out, or an error, when its turn comes
            for array in (first.image, first.mask, first.camera.K, first.camera.R, first.camera.t):
                digest.update(array.tobytes())
        return digest.hexdigest()[:16]

    def spread(self, most: int) -> list[int]:
        """Indices of at most ``most`` objects, evenly from the first to the last."""
        return _spread(list(range(len(self.objects))), most)

    def readable(self, index: int) -> bool:
        """Whether the points of an object can be read; where not, ``not_judged`` says why."""
        try:
            self.target(index)
        except InputError as error:
            self.not_judged[self.objects[index].name] = self.objects[index].lacking or str(error)
            return False
        return True

    def judged(self, most: int) -> list[int]:
        """Indices of at most ``most`` objects, spread evenly over those that have a 3D file, less what cannot be read."""
        found = []
        for index in _spread([index for index, item in enumerate(self.objects) if item.target is not None], most):
            try:
                if self.readable(index) and self.usable(index, 0, points=True)[0] == index:
                    found.append(index)
            except InputError as error:
                self.not_judged[self.objects[index].name] = str(error)
        self.not_judged |= {item.name: item.lacking for item in self.objects if item.target is None}
        return found

    def target(self, index: int) -> Floats:
        """Points [M, 3] of an object, in its own frame."""
        if index not in self._targets:
            load = self.objects[index].target
            if load is None:
                raise InputError(f"{self.objects[index].name}: has no points, expected some to learn from")
            self._keep(self._targets, index, points := load(), points.nbytes)
            return points
        return self._targets[index]

    def prepared(self, index: int, view: int) -> NetworkInput:
        """Picture, mask and camera of one view, cropped as the network's input, in steps of 1/255.

        The object stands on black where it is to be put on ``backgrounds``.
        """
        key = (index, view)
        packed = self._cache.get(key)
        if packed is None:
            source = self.objects[index].views[view]
            _require_perspective(source.name, source.camera)
            image, mask = source.load()
            background = "black" if self.backgrounds else self.background
            made = network_input(
                image, View(mask, source.camera, name=source.name), crop_share=self.crop_share, background=background
            )
            packed = _Packed.of(made)
            self._keep(self._cache, key, packed, packed.nbytes)
        return packed.unpacked()

    def usable(self, index: int, view: int, points: bool = False) -> tuple[int, int, NetworkInput]:
        """``prepared``, or where that picture cannot be used the next one that can, of the same object or of the next.

        With ``points`` an object whose target cannot be read is passed over too. Returns the index of the object, the number
        of the view, and the view.

        Raises
        ------
        InputError
            With ``strict`` at the first picture or target that cannot be used; else if none can.
        """
        for other in range(len(self.objects)):
            at = (index + other) % len(self.objects)
            if points and not self._has_points(at):
                continue
            count = len(self.objects[at].views)
            for offset in range(count):
                key = (at, (view + offset) % count)
                if key in self._bad:
                    continue
                try:
                    return *key, self.prepared(*key)
                except InputError as error:
                    if self.strict:
                        raise
                    self._bad.add(key)
                    self._leave_out(self.objects[at].views[key[1]].name, str(error))
        raise InputError(f"{self.description}: no picture can be used, the first: {next(iter(self.unusable.values()))}")

    def _has_points(self, index: int) -> bool:
        if index not in self._pointed:
            try:
                self.target(index)
                self._pointed[index] = True
            except InputError as error:
                if self.strict:
                    raise
                self._pointed[index] = False
                self._leave_out(self.objects[index].name, str(error))
        return self._pointed[index]

    def _leave_out(self, name: str, reason: str) -> None:
        with self._lock:
            known = name in self.unusable
            self.unusable[name] = reason
        if not known and len(self.unusable) <= NAMED:
            warnings.warn(f"{reason}; left out", stacklevel=3)

    def _keep(self, store: dict[Any, Any], key: object, value: object, size: int) -> None:
        with self._lock:
            if key not in store and self._cached_bytes + size <= CACHE_BYTES:
                store[key] = value
                self._cached_bytes += size


@dataclass(frozen=True, eq=False)
class _Packed:
    """A NetworkInput in bytes."""

    image: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    known: NDArray[np.bool_] | None
    camera: Camera
    box: Box

    @classmethod
    def of(cls, made: NetworkInput) -> _Packed:
        image, mask = (np.rint(values * 255.0).astype(np.uint8) for values in (made.image, made.mask))
        return cls(image, mask, None if made.known.all() else made.known, made.camera, made.box)

    @property
    def nbytes(self) -> int:
        return self.image.nbytes + self.mask.nbytes + (0 if self.known is None else self.known.nbytes)

    def unpacked(self) -> NetworkInput:
        scale = np.float32(1.0 / 255.0)
        known = np.ones(self.mask.shape, dtype=bool) if self.known is None else self.known
        return NetworkInput(self.image * scale, self.mask * scale, self.camera, known, self.box)


def _spread(indices: list[int], most: int) -> list[int]:
    places = np.unique(np.linspace(0, len(indices) - 1, min(most, len(indices))).round().astype(int))
    return [indices[place] for place in places]


def _require_perspective(name: str, camera: Camera) -> None:
    if camera.model != "perspective":
        raise InputError(f"{name}: its camera is {camera.model}, expected perspective for training")
