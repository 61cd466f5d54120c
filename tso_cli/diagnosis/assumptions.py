"""Hypotheses that are taken as true: views stay as read, and `as_meant` is a view under them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array
from ..geometry.camera import Camera
from ..geometry.mirror_plane import MirrorPlane
from ..geometry.view import View
from .hypotheses import HYPOTHESES, OF_WIDTH, Hypothesis, hypothesis_called, permutation


@dataclass(frozen=True)
class Assumption:
    """A hypothesis that is taken as true: of all views, or of the ``view`` of this name alone."""

    hypothesis: Hypothesis
    view: str = ""

    @property
    def text(self) -> str:
        """As ``assume`` takes it: NAME, or NAME@VIEW."""
        return f"{self.hypothesis.name}@{self.view}" if self.view else self.hypothesis.name

    def is_about(self, view: View) -> bool:
        return self.view in ("", view.name)


INVERTED = Assumption(HYPOTHESES["mask-inverted"])


class MaskChange(NamedTuple):
    """How the mask that is meant differs from the mask as it was read.

    inverted : whether foreground and background are exchanged.
    turn : [2, 2], from the mask as read to the mask that is meant: pixels from the middle.
    """

    inverted: bool
    turn: Array

    def of(self, picture: NDArray[Any]) -> NDArray[Any]:
        """``picture`` [H, W, ...] turned; a mask is not inverted by this."""
        if self.turn[0, 0] == 0.0:
            picture = picture.swapaxes(0, 1)
        x, y = self.turn.sum(1).astype(int)
        return picture[::y, ::x]


def assumptions_of(texts: Sequence[str], views: Sequence[str]) -> tuple[Assumption, ...]:
    """The assumptions that ``texts`` name: NAME, or NAME@VIEW for one view alone.

    A view is named by its whole name or by the last part of a path. Raises InputError for a name
    that is not in the table, a view that is not in ``views``, or a text that is given twice.
    """
    assumptions = []
    for text in texts:
        name, at, view = text.partition("@")
        hypothesis = hypothesis_called(name)
        if hypothesis is None or (at and not view):
            raise InputError(
                f"`assume` is {text!r}, expected a name of `assume` list, such as {_like(name)}, "
                "or NAME@MASK for one mask of several"
            )
        if at and hypothesis.of_cloud:
            raise InputError(
                f"`assume` is {text!r}, expected {name} alone: the cloud is the same for all masks"
            )
        if texts.count(text) > 1:
            raise InputError(f"`assume` has {text} twice, expected it once")
        assumptions.append(Assumption(hypothesis, _named(text, view, views) if at else ""))
    return tuple(assumptions)


def _like(name: str) -> str:
    """The hypothesis whose name is most like ``name``."""
    from difflib import get_close_matches

    names = [*HYPOTHESES, f"{OF_WIDTH}=518"]
    longer = [other for other in names if name and name in other]
    return next(iter(get_close_matches(name, longer or names, 1, 0.0)), "mask-inverted")


def _named(text: str, view: str, views: Sequence[str]) -> str:
    """The one of ``views`` that ``view`` names."""
    view = str(Path(view))
    names = [name for name in views if name == view]
    names = names or [name for name in views if Path(name).name == view]
    if len(names) != 1:
        count = f"there are {len(names)} such masks" if names else "there is no such mask"
        raise InputError(f"`assume` is {text!r}: {count}, expected one of {', '.join(views)}")
    return names[0]


def as_meant(view: View, assumptions: Iterable[Assumption]) -> View:
    """``view``, as it was read, under ``assumptions``: as it sees points in the cloud's axes.

    Depth map and photo are taken as right.
    """
    of_view = [assumption for assumption in assumptions if assumption.is_about(view)]
    if not of_view:
        return view
    change, axes = mask_change(view, of_view), axes_of(of_view)
    mask = change.of(view.mask)
    if change.inverted:
        mask = np.float32(1.0) - mask
    known = None if view.known is None else change.of(view.known)
    camera = camera_under(view.camera, (assumption.hypothesis for assumption in of_view))
    view = replace(view, mask=mask, known=known, camera=camera)
    # The camera sees points of the cloud where it saw ``axes`` times them. For left-handed axes the
    # pictures are mirrored with it: no camera is a reflection.
    if np.linalg.det(axes) < 0.0:
        mirror = MirrorPlane(np.array([1.0, 0.0, 0.0]), 0.0)
        flipped, axes = mirror.flipped(view), mirror.reflect(axes.T).T
        image = None if view.image is None else view.image[:, ::-1]
        pictures = {name: getattr(flipped, name) for name in ("mask", "known", "depth", "camera")}
        view = replace(view, image=image, **pictures)
    return replace(view, camera=replace(view.camera, R=view.camera.R @ axes))


def camera_under(camera: Camera, hypotheses: Iterable[Hypothesis]) -> Camera:
    """The camera that is meant, of a ``camera`` as it was read."""
    for hypothesis in hypotheses:
        camera = hypothesis.camera(camera)
    return camera


def mask_change(view: View, assumptions: Iterable[Assumption]) -> MaskChange:
    """How the mask of a view differs from what is meant; a change made twice is none."""
    inverted, turn = False, np.eye(2)
    for assumption in assumptions:
        if assumption.is_about(view):
            inverted ^= assumption.hypothesis.inverted
            turn = permutation(assumption.hypothesis.picture) @ turn
    return MaskChange(inverted, turn)


def axes_of(assumptions: Iterable[Assumption]) -> Array:
    """[3, 3], from points of the cloud to points of the scene, under all assumptions."""
    axes = np.eye(3)
    for assumption in assumptions:
        axes = assumption.hypothesis.matrix @ axes
    return axes


def left_handed(assumptions: Iterable[Assumption]) -> bool:
    """Whether the cloud has left-handed axes, so that pictures and cameras are mirrored."""
    return bool(np.linalg.det(axes_of(assumptions)) < 0.0)
