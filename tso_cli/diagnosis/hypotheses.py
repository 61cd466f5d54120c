"""What people commonly get wrong in cloud, camera and mask: named assumptions, and views as they are meant under them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..geometry.camera import Array, Camera
from ..geometry.view import View
from ..optimisation.symmetry import MirrorPlane


@dataclass(frozen=True)
class Assumption:
    """How the input is meant, if not as the conventions have it.

    what : in words. axes : the x, y and z of the scene in those of the cloud. camera : from the camera of the file. mask :
    "inverted", "left-right" or "upside-down". option : that gave it. view : name of the only view that it is about, or "".
    of_cloud : whether it is about the cloud, the same for all views. handicap : IoU by which it must explain the views better
    than others: a start of another shape may be smaller or larger too.
    """

    what: str
    axes: str = "x y z"
    camera: Callable[[Camera], Camera] | None = None
    mask: str = ""
    option: str = ""
    view: str = ""
    of_cloud: bool = False
    handicap: float = 0.0

    @cached_property
    def matrix(self) -> Array:
        """[3, 3], from points of the cloud to points of the scene; orthogonal."""
        rows = [
            np.eye(3)["xyz".index(axis[-1])] * (-1.0 if axis[0] == "-" else 1.0)
            for axis in self.axes.split()
        ]
        return np.stack(rows)

    def of_view(self, view: View) -> View:
        """The view with mask and camera as they are meant. Its depth map and photo are taken as right."""
        mask, known = view.mask, view.known
        if self.mask == "inverted":
            mask = np.float32(1.0) - mask
        elif self.mask:
            order = np.s_[:, ::-1] if self.mask == "left-right" else np.s_[::-1]
            mask, known = mask[order], None if known is None else known[order]
        return replace(view, mask=mask, known=known, camera=self.of_camera(view.camera))

    def of_camera(self, camera: Camera) -> Camera:
        return self.camera(camera) if self.camera else camera

    def read(self, view: View) -> View:
        """The view as it is meant, of points in the axes of the cloud."""
        return in_axes_of_cloud(self.of_view(view), self.matrix)


def _axes(*signs: float) -> Callable[[Camera], Camera]:
    """The axes of the camera's frame turned: ``signs`` of x, y and z."""
    flip = np.array(signs)
    return lambda camera: replace(camera, R=flip[:, None] * camera.R, t=flip * camera.t)


def _to_camera(camera: Camera) -> Camera:
    return replace(camera, R=camera.R.T, t=-camera.R.T @ camera.t)


def _unit(factor: float) -> Callable[[Camera], Camera]:
    """The cloud's unit is ``factor`` times that of the camera."""

    def camera_in_units(camera: Camera) -> Camera:
        K = camera.K if camera.model == "perspective" else camera.K @ np.diag([factor, factor, 1.0])
        return replace(camera, K=K, t=camera.t / factor)

    return camera_in_units


def _of_image(factor: float) -> Callable[[Camera], Camera]:
    """K is of the image enlarged by 1 / ``factor``; centres of pixels are at integers."""
    change = np.array(
        [[factor, 0.0, (factor - 1.0) / 2.0], [0.0, factor, (factor - 1.0) / 2.0], [0.0, 0.0, 1.0]]
    )
    return lambda camera: replace(camera, K=change @ camera.K)


def _exchanged(camera: Camera) -> Camera:
    K = camera.K.copy()
    K[:2, 2] = K[1::-1, 2]
    return replace(camera, K=K)


_of_cloud = partial(Assumption, of_cloud=True)
ASSUMPTIONS = {
    "mask-inverted": Assumption("the mask is inverted", mask="inverted"),
    "mask-flipped": Assumption("the mask is flipped left to right", mask="left-right"),
    "mask-upside-down": Assumption("the mask is upside down", mask="upside-down"),
    "cloud-z-up": _of_cloud("the cloud's z points up, the scene's y", "x z -y"),
    "cloud-y-up": _of_cloud("the cloud's y points up, the scene's z", "x -z y"),
    "cloud-upside-down": _of_cloud("the cloud is upside down", "x -y -z"),
    "cloud-xy-swapped": _of_cloud("x and y of the cloud are exchanged", "y x z"),
    "cloud-yz-swapped": _of_cloud("y and z of the cloud are exchanged", "x z y"),
    "cloud-xz-swapped": _of_cloud("x and z of the cloud are exchanged", "z y x"),
    "cloud-yzx": _of_cloud("the cloud's axes are y, z, x", "z x y"),
    "cloud-zxy": _of_cloud("the cloud's axes are z, x, y", "y z x"),
    "cloud-inches": _of_cloud("the cloud is in inches, the camera in metres", camera=_unit(0.0254)),
    "cloud-millimetres": _of_cloud(
        "the cloud is in millimetres, the camera in metres", camera=_unit(1e-3)
    ),
    "cloud-centimetres": _of_cloud(
        "the cloud is in centimetres, the camera in metres", camera=_unit(1e-2)
    ),
    "camera-inches": Assumption(
        "the camera is in inches, the cloud in metres", camera=_unit(1.0 / 0.0254)
    ),
    "camera-millimetres": Assumption(
        "the camera is in millimetres, the cloud in metres", camera=_unit(1e3)
    ),
    "camera-centimetres": Assumption(
        "the camera is in centimetres, the cloud in metres", camera=_unit(1e2)
    ),
    "cloud-ten-times-large": _of_cloud(
        "the cloud is ten times too large, as millimetres for centimetres", camera=_unit(0.1)
    ),
    "cloud-ten-times-small": _of_cloud(
        "the cloud is ten times too small, as centimetres for millimetres", camera=_unit(10.0)
    ),
    "cloud-twice-large": _of_cloud(
        "the cloud is about twice too large", camera=_unit(0.5), handicap=0.14
    ),
    "cloud-half-large": _of_cloud(
        "the cloud is about half as large as it should be", camera=_unit(2.0), handicap=0.14
    ),
    "opengl": Assumption(
        "the camera's axes are OpenGL's (y up, z backward)", camera=_axes(1.0, -1.0, -1.0)
    ),
    "pytorch3d": Assumption(
        "the camera's axes are PyTorch3D's (x left, y up)", camera=_axes(-1.0, -1.0, 1.0)
    ),
    "camera-to-world": Assumption("R and t are camera-to-world", camera=_to_camera),
    "opengl-camera-to-world": Assumption(
        "R and t are camera-to-world with OpenGL's axes, as Blender's and NeRF's",
        camera=lambda camera: _axes(1.0, -1.0, -1.0)(_to_camera(camera)),
    ),
    "t-of-position": Assumption(
        "t is the camera's position", camera=lambda camera: replace(camera, t=-camera.R @ camera.t)
    ),
    "R-transposed": Assumption(
        "R is transposed", camera=lambda camera: replace(camera, R=camera.R.T)
    ),
    "K-of-half-size": Assumption("K is of an image half as wide", camera=_of_image(2.0)),
    "K-of-double-size": Assumption("K is of an image twice as wide", camera=_of_image(0.5)),
    "principal-point-swapped": Assumption(
        "x and y of the principal point are exchanged", camera=_exchanged
    ),
}
"""By the name that `tso refine --assume` takes."""


INVERT_MASK = replace(ASSUMPTIONS["mask-inverted"], option="--invert-mask")


class Suspect(NamedTuple):
    """What may be wrong with the input: ``what`` in words, the ``option`` or file that mends it, the IoU then (0: unknown)."""

    what: str
    option: str
    score: float


def assumptions_of(texts: Sequence[str]) -> list[Assumption]:
    """The assumptions of NAME, or of NAME@MASK for the view of that mask alone; InputError for another name."""
    assumptions = []
    for text in texts:
        name, at, mask = text.partition("@")
        if name not in ASSUMPTIONS or (at and not mask):
            raise InputError(
                f"--assume is {text!r}, expected one of {', '.join(ASSUMPTIONS)}, or NAME@MASK for one mask of several"
            )
        if at and ASSUMPTIONS[name].of_cloud:
            raise InputError(
                f"--assume is {text!r}, expected {name} alone: the cloud is the same for all masks"
            )
        if texts.count(text) > 1:
            raise InputError(f"--assume {text} is given twice, expected once")
        assumptions.append(
            replace(
                ASSUMPTIONS[name], option=f"--assume {text}", view=str(Path(mask)) if mask else ""
            )
        )
    return assumptions


@dataclass(frozen=True, eq=False)
class AssumedView(View):
    """A view read under assumptions: ``given`` ones, and the ``camera_read``, of the file."""

    given: tuple[Assumption, ...] = ()
    camera_read: Camera | None = None


def about(view: View, assumptions: Sequence[Assumption]) -> list[Assumption]:
    """Those that are about all views, or about this one."""
    return [assumption for assumption in assumptions if assumption.view in ("", view.name)]


def axes_of(assumptions: Sequence[Assumption]) -> Array:
    """[3, 3], from points of the cloud to points of the scene, under all of them."""
    axes = np.eye(3)
    for assumption in assumptions:
        axes = assumption.matrix @ axes
    return axes


def mirrored(view: View) -> bool:
    """Whether its pictures and its camera are mirrored, as the cloud has left-handed axes."""
    return isinstance(view, AssumedView) and bool(
        np.linalg.det(axes_of(about(view, view.given))) < 0.0
    )


def in_axes_of_cloud(view: View, axes: Array) -> View:
    """The view whose camera sees points of the cloud where it saw ``axes`` times these.

    Of left-handed axes its pictures are mirrored, and its camera with them: no camera is a reflection.
    """
    if np.linalg.det(axes) < 0.0:
        mirror = MirrorPlane(np.array([1.0, 0.0, 0.0]), 0.0)
        mirrored, axes = mirror.view(view), mirror.reflect(axes.T).T
        image = None if view.image is None else view.image[:, ::-1]
        pictures = {name: getattr(mirrored, name) for name in ("mask", "known", "depth", "camera")}
        view = replace(view, image=image, **pictures)
    return replace(view, camera=replace(view.camera, R=view.camera.R @ axes))
