"""Training data: objects with pictures, masks, cameras and points.

They are prepared once and cached while there is room.
"""

from __future__ import annotations

import hashlib
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..datasets.items import ObjectItem
from ..errors import InputError
from ..geometry.arrays import Floats
from ..geometry.camera import Camera
from ..geometry.points import evenly
from ..geometry.view import View
from ..network import Background
from ..network.input import NetworkInput, network_input
from .backgrounds import Backgrounds

T = TypeVar("T")
# Memory for prepared views, 20 KiB each, and targets. Other views are read again when they are
# needed.
CACHE_BYTES = 1 << 30


@dataclass(eq=False)
class TrainingData:
    """Objects prepared for training. Several threads may use them at once.

    objects : at least one, each with at least one view.
    description : the data in words, for the checkpoint.
    crop_share, background : arguments of `network_input`.
    strict : whether an unusable picture is an error. Otherwise it causes a warning, and another
        picture takes its place.
    backgrounds : pictures that `batches` puts behind the object, which is cut out by its mask; they
        need background "keep".
    skipped : item that the data set left out -> why.
    scale : scale of all clouds and cameras, in words.
    categories : indices of the objects of each category, one array for each category.
    unusable : picture, or object whose points cannot be read -> why.
    not_evaluated : object that cannot be evaluated because its points cannot be read -> why.
    """

    objects: Sequence[ObjectItem]
    description: str
    crop_share: float = 0.9
    background: Background = "black"
    strict: bool = False
    backgrounds: Backgrounds | None = None
    skipped: Mapping[str, str] = field(default_factory=dict)
    scale: str = "longest side 1"
    categories: list[NDArray[np.int64]] = field(init=False)
    unusable: dict[str, str] = field(init=False, default_factory=dict)
    not_evaluated: dict[str, str] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        # The other cameras are checked when they are loaded, because some need a model to be read.
        first = self.objects[0].views[0]
        _require_perspective(first.name, first.camera)
        if self.backgrounds is not None and self.background != "keep":
            raise InputError(
                f"backgrounds with background {self.background!r}, "
                "expected 'keep', which leaves them in the picture"
            )
        _, category = np.unique([item.category for item in self.objects], return_inverse=True)
        self.categories = [np.flatnonzero(category == i) for i in range(category.max() + 1)]
        self._bad: set[tuple[int, int | None]] = set()
        self._with_points: set[int] = set()
        self._views: dict[tuple[int, int], NetworkInput] = {}
        self._targets: dict[int, Floats] = {}
        self._cached_bytes = 0
        self._lock = threading.Lock()

    def fingerprint(self) -> str:
        """A digest of all names and of the first view of at most 16 objects.

        A resumed run must see the same data.
        """
        backgrounds = self.backgrounds.source if self.backgrounds else ""
        digest = hashlib.sha256(
            f"{self.crop_share}/{self.background}/{backgrounds}".encode(errors="surrogateescape")
        )
        for item in self.objects:
            digest.update(f"{item.name}/{len(item.views)}".encode(errors="surrogateescape"))
        for index in evenly(len(self.objects), most=16):
            try:
                first = self.prepared(index, 0)
            except InputError:
                continue  # reported when the picture is drawn
            for array in (first.image, first.mask, first.camera.K, first.camera.R, first.camera.t):
                digest.update(array.tobytes())
        return digest.hexdigest()[:16]

    def readable(self, index: int) -> bool:
        """Whether the points of an object can be read; if not, ``not_evaluated`` says why."""
        try:
            self.target(index)
        except InputError as error:
            item = self.objects[index]
            self.not_evaluated[item.name] = item.lacking or str(error)
            return False
        return True

    def evaluable(self, most: int) -> list[int]:
        """Indices of at most ``most`` objects, spread evenly over the objects with a 3D file.

        Objects that cannot be read are left out.
        """
        indices = []
        with_target = [i for i, item in enumerate(self.objects) if item.target is not None]
        for index in (with_target[place] for place in evenly(len(with_target), most)):
            try:
                if self.readable(index) and self.usable(index, 0, points=True)[0] == index:
                    indices.append(index)
            except InputError as error:
                self.not_evaluated[self.objects[index].name] = str(error)
        for item in self.objects:
            if item.target is None:
                self.not_evaluated[item.name] = item.lacking
        return indices

    def target(self, index: int) -> Floats:
        """Points [M, 3] of an object, in its own frame."""
        points = self._targets.get(index)
        if points is None:
            load = self.objects[index].target
            if load is None:
                raise InputError(
                    f"{self.objects[index].name}: has no points, expected some to learn from"
                )
            points = load()
            self._cache(self._targets, index, points, points.nbytes)
        return points

    def prepared(self, index: int, view: int) -> NetworkInput:
        """Picture, mask and camera of one view, cropped to the network's input, in steps of 1/255.

        The object stands on black if one of ``backgrounds`` will be put behind it.
        """
        packed = self._views.get((index, view))
        if packed is None:
            source = self.objects[index].views[view]
            _require_perspective(source.name, source.camera)
            image, mask = source.load()
            background = "black" if self.backgrounds else self.background
            photo = View(mask, source.camera, name=source.name)
            inputs = network_input(image, photo, crop_share=self.crop_share, background=background)
            packed = replace(inputs, image=_as_bytes(inputs.image), mask=_as_bytes(inputs.mask))
            size = packed.image.nbytes + packed.mask.nbytes + packed.known.nbytes
            self._cache(self._views, (index, view), packed, size)
        step = np.float32(1.0 / 255.0)
        return replace(packed, image=packed.image * step, mask=packed.mask * step)

    def usable(self, index: int, view: int, points: bool = False) -> tuple[int, int, NetworkInput]:
        """The first usable view from this one on, in this object and the following objects.

        With ``points`` an object is passed over if its target cannot be read. Returns the index of
        the object, the number of the view, and the picture (`prepared`). Raises InputError if no
        picture can be used; with ``strict`` also at the first picture or target that cannot be
        used.
        """
        for step in range(len(self.objects)):
            at = (index + step) % len(self.objects)
            if points and at not in self._with_points:
                if self._attempt((at, None), partial(self.target, at)) is None:
                    continue
                self._with_points.add(at)
            count = len(self.objects[at].views)
            for number in ((view + i) % count for i in range(count)):
                picture = self._attempt((at, number), partial(self.prepared, at, number))
                if picture is not None:
                    return at, number, picture
        raise InputError(
            f"{self.description}: no picture can be used; "
            f"the first: {next(iter(self.unusable.values()))}"
        )

    def _attempt(self, key: tuple[int, int | None], load: Callable[[], T]) -> T | None:
        """What ``load`` returns; None if the view, or the points of an object, cannot be used.

        ``key`` is the object and the view, which is None for the object's points.
        """
        if key in self._bad:
            return None
        try:
            return load()
        except InputError as error:
            if self.strict:
                raise
            index, view = key
            item = self.objects[index]
            name = item.name if view is None else item.views[view].name
            with self._lock:
                first_time = name not in self.unusable
                self.unusable[name] = str(error)
                self._bad.add(key)
            # The first ten are named in warnings; the command counts all of them.
            if first_time and len(self.unusable) <= 10:
                warnings.warn(f"{error}; left out", stacklevel=3)
            return None

    def _cache(self, store: dict[Any, Any], key: object, value: object, size: int) -> None:
        with self._lock:
            if key not in store and self._cached_bytes + size <= CACHE_BYTES:
                store[key] = value
                self._cached_bytes += size


def _as_bytes(values: Floats) -> Any:
    return np.rint(values * 255.0).astype(np.uint8)


def _require_perspective(name: str, camera: Camera) -> None:
    if camera.model != "perspective":
        raise InputError(f"{name}: its camera is {camera.model}, expected perspective for training")
