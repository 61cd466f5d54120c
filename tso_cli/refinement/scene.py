"""What a refinement is given, in memory: `RefineScene`."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..cloud.cloud import Cloud
from ..diagnosis.assumptions import Assumption, as_meant, assumptions_of
from ..diagnosis.findings import ASSUMED_CAMERA, Finding
from ..errors import InputError
from ..geometry.arrays import Array, Bits, as_numbers
from ..geometry.camera import Camera
from ..geometry.outline import shrunk
from ..geometry.view import OUTLINE_ERROR, View, as_mask
from ..pose.move import Move


@dataclass(frozen=True, eq=False)
class RefineScene:
    """A cloud and its views, as they were read.

    assumptions : how they are meant. known : findings of those who read them.
    settled : the views as they are meant, with depth maps along z; () before these are known.
    """

    cloud: Cloud
    read: tuple[View, ...]
    assumptions: tuple[Assumption, ...] = ()
    known: tuple[Finding, ...] = ()
    settled: tuple[View, ...] = ()

    @cached_property
    def views(self) -> tuple[View, ...]:
        """The views as they are meant, in the axes of the cloud."""
        return self.settled or tuple(as_meant(view, self.assumptions) for view in self.read)

    def with_views(self, views: Sequence[View], found: Sequence[Finding] = ()) -> RefineScene:
        """The same scene with other pictures in its views, and with what was ``found``."""
        return replace(self, settled=tuple(views), known=(*self.known, *found))

    def without(self, hidden: Mapping[int, Bits]) -> RefineScene:
        """The same scene, where ``hidden`` pixels [H, W] of views, by number, are unknown."""
        views = list(self.views)
        for number, pixels in hidden.items():
            known = views[number].known
            known = ~pixels if known is None else known & ~pixels
            views[number] = replace(views[number], known=known)
        return self.with_views(views)

    def with_outlines(self, growth: float) -> RefineScene:
        """The same scene, with masks whose outlines lie ``growth`` pixels further in."""
        views = [shrunk(view, growth) for view in self.views]
        how = "large" if growth > 0.0 else "small"
        values: dict[str, float | str] = {"pixels": abs(growth), "how": how}
        notes = [
            Finding("outline-corrected", (number,), values=values)
            for number, (before, view) in enumerate(zip(self.views, views, strict=True))
            if view is not before and abs(growth) >= OUTLINE_ERROR
        ]
        return self.with_views(views, notes)

    def after(self, move: Move) -> RefineScene:
        """The same scene with the views of ``move``, which are as they are meant."""
        if move.kind == "nothing":
            return self
        known = self.known
        if move.why_unsure:
            known += (Finding("unsure-place", values={"why": move.why_unsure}),)
        return replace(self, read=move.views, assumptions=(), known=known, settled=())


def as_scene(
    cloud: Any,
    masks: Any,
    cameras: Camera | Sequence[Camera] | None = None,
    assume: Sequence[str | Assumption] = (),
    known: Sequence[Finding] = (),
    name: str = "points",
) -> RefineScene:
    """The scene of a `Cloud`, or of points [N, 3] called ``name`` in messages, and its views."""
    cloud = as_cloud(cloud, name)
    views = as_views(masks, cameras)
    listed = masks if isinstance(masks, Sequence) else [masks]
    with_camera = cameras is not None or any(isinstance(entry, View) for entry in listed)
    if not with_camera and not cloud.predicted:
        known = (*known, Finding(ASSUMED_CAMERA, (0,)))
    if isinstance(assume, str) or not isinstance(assume, Iterable):
        raise InputError(f"`assume` is {assume!r}, expected a sequence of names")
    if wrong := [entry for entry in assume if not isinstance(entry, (str, Assumption))]:
        raise InputError(f"`assume` holds {wrong[0]!r}, expected names")
    texts = [entry for entry in assume if isinstance(entry, str)]
    assumptions = [entry for entry in assume if isinstance(entry, Assumption)]
    assumptions += assumptions_of(texts, [view.name for view in views]) if texts else ()
    return RefineScene(cloud, views, tuple(assumptions), tuple(known))


def as_cloud(points: Any, name: str, faces: Any = None) -> Cloud:
    """The cloud of points [N, 3] or [1, N, 3], of a mesh with ``faces``; a `Cloud` as it is.

    Points of a cloud without finite coordinates are left out, with a warning.
    """
    if isinstance(points, Cloud):
        return points
    array: Array = as_numbers(points, f"{name}: what was given")
    if array.ndim == 3 and len(array) == 1:
        array = array[0]
    # Of another shape `Cloud` says what is wrong.
    finite: Bits = np.asarray(np.isfinite(array).all(1) if array.ndim == 2 else [True])
    if faces is None and finite.any() and not finite.all():
        wrong = f"{np.count_nonzero(~finite):,} of {len(finite):,}"
        warnings.warn(
            f"{name}: {wrong} have a NaN or infinite coordinate and are left out", stacklevel=3
        )
        array = array[finite]
    return Cloud(array, name, faces=faces)


def as_views(masks: Any, cameras: Camera | Sequence[Camera] | None = None) -> tuple[View, ...]:
    """One `View` for each mask."""
    if isinstance(masks, View):
        masks = [masks]
    if isinstance(masks, Sequence) and masks and all(isinstance(mask, View) for mask in masks):
        if cameras is not None:
            raise InputError("views have their own cameras, expected no others with them")
        return tuple(masks)
    shape: tuple[int, ...] = getattr(masks, "shape", ())
    if len(shape) == 2 or (len(shape) == 3 and shape[2] == 1) or hasattr(masks, "getbands"):
        masks = [masks]
    try:
        listed = list(masks)
    except TypeError:
        listed = [""]
    try:
        arrays = [as_mask(mask, "a mask") for mask in listed]
    except InputError:
        raise InputError(
            "masks are not arrays of numbers, expected one [H, W] or a sequence of them"
        ) from None
    if wrong := [list(mask.shape) for mask in arrays if mask.ndim != 2]:
        raise InputError(f"a mask has shape {wrong[0]}, expected [H, W]")
    if cameras is None:
        cameras = [Camera.canonical(mask.shape[1], mask.shape[0]) for mask in arrays]
    elif isinstance(cameras, Camera):
        cameras = [cameras]
    if not (
        isinstance(cameras, Sequence) and all(isinstance(camera, Camera) for camera in cameras)
    ):
        type_name = type(cameras).__name__
        raise InputError(f"the cameras are of type {type_name}, expected a Camera for each mask")
    if len(arrays) == 0 or len(arrays) != len(cameras):
        raise InputError(
            f"found {len(arrays)} masks and {len(cameras)} cameras, expected one camera for each "
            "mask"
        )
    pairs = zip(arrays, cameras, strict=True)
    return tuple(
        View(mask, camera, name=f"mask {number}") for number, (mask, camera) in enumerate(pairs)
    )
