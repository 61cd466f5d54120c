"""What people commonly get wrong in cloud, camera and mask: a table of hypotheses.

A hypothesis that is taken as true is an assumption. Views stay as they were read; `as_meant` is a
view under assumptions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array
from ..geometry.camera import Camera, from_shares
from ..geometry.mirror_plane import MirrorPlane
from ..geometry.view import View

MaskChange = Literal["", "inverted", "left-right", "upside-down"]


# In longer sides of the picture. A shorter focal length has a field of view of over 127 degrees,
# more than the widest lens of a phone: it is not in pixels.
SHORTEST_FOCAL = 1.0 / 4.0


def _as_read(camera: Camera) -> Camera:
    return camera


def focal_in_pixels(camera: Camera) -> bool:
    """Whether the focal length may be in pixels (`SHORTEST_FOCAL`)."""
    longer = max(camera.width, camera.height)
    return camera.model != "perspective" or bool(camera.K[0, 0] >= SHORTEST_FOCAL * longer)


@dataclass(frozen=True)
class Hypothesis:
    """One way in which the input may be meant, if not as the conventions have it.

    name : what ``assume`` takes. says : in words.
    axes : the x, y and z of the scene, in the axes of the cloud.
    camera : the camera that is meant, from the camera as it was read.
    mask : how the mask that is meant differs from the mask as it was read.
    of_cloud : whether it is about the cloud, and so the same for all views.
    prior : IoU by which it must explain the views better than other hypotheses do. A start of
        another shape may be smaller or larger than the object too.
    unit_of_focal : whether it is about a focal length that is not in pixels. It is only tried if
        this may be so (`focal_in_pixels`).
    """

    name: str
    says: str
    axes: str = "x y z"
    camera: Callable[[Camera], Camera] = _as_read
    mask: MaskChange = ""
    of_cloud: bool = False
    prior: float = 0.0
    unit_of_focal: bool = False

    def __reduce__(self) -> tuple[Callable[[str], Hypothesis], tuple[str]]:
        # By name, since the functions of the table cannot be sent to another process.
        return _by_name, (self.name,)

    @property
    def changes_camera(self) -> bool:
        return self.camera is not _as_read

    @cached_property
    def matrix(self) -> Array:
        """[3, 3], from points of the cloud to points of the scene; orthogonal."""
        rows = []
        for axis in self.axes.split():
            sign = -1.0 if axis.startswith("-") else 1.0
            rows.append(sign * np.eye(3)["xyz".index(axis[-1])])
        return np.stack(rows)


def _axes(*signs: float) -> Callable[[Camera], Camera]:
    """The axes of the camera's frame reversed by ``signs`` of x, y and z."""
    flip = np.array(signs)
    return lambda camera: replace(camera, R=flip[:, None] * camera.R, t=flip * camera.t)


def _inverse(camera: Camera) -> Camera:
    return replace(camera, R=camera.R.T, t=-camera.R.T @ camera.t)


def _unit(factor: float) -> Callable[[Camera], Camera]:
    """The cloud's unit is ``factor`` times the camera's unit."""

    def in_units_of_cloud(camera: Camera) -> Camera:
        K = camera.K
        if camera.model == "orthographic":
            K = K @ np.diag([factor, factor, 1.0])
        return replace(camera, K=K, t=camera.t / factor)

    return in_units_of_cloud


def _image(factor: float) -> Callable[[Camera], Camera]:
    """K is of the image enlarged by 1 / ``factor``; pixel centres are at integers."""
    shift = (factor - 1.0) / 2.0
    change = np.array([[factor, 0.0, shift], [0.0, factor, shift], [0.0, 0.0, 1.0]])
    return lambda camera: replace(camera, K=change @ camera.K)


def _of_shares(camera: Camera) -> Camera:
    """K is in shares of width and height, with pixel centres at halves, as MoGe's."""
    return replace(camera, K=from_shares(camera.K, camera.width, camera.height))


def _of_ndc(camera: Camera) -> Camera:
    """K is in PyTorch3D's normalised device coordinates."""
    half = min(camera.width, camera.height) / 2.0
    K = np.diag([half, half, 1.0]) @ camera.K
    K[:2, 2] = np.array([camera.width, camera.height]) / 2.0 - 0.5 - K[:2, 2]
    return replace(camera, K=K)


def _focal(change: Callable[[Camera], float]) -> Callable[[Camera], Camera]:
    """The focal length is multiplied by ``change``."""

    def changed(camera: Camera) -> Camera:
        factor = change(camera)
        K = camera.K.copy()
        K[[0, 1, 0], [0, 1, 1]] *= factor
        return replace(camera, K=K)

    return changed


def _of_sensor(millimetres: float) -> Callable[[Camera], Camera]:
    """The focal length is in mm of a sensor of this width."""
    return _focal(lambda camera: camera.width / millimetres)


def _of_degrees(camera: Camera) -> float:
    degrees = min(float(camera.K[0, 0]), 179.0)
    return camera.width / 2.0 / np.tan(np.radians(degrees / 2.0)) / float(camera.K[0, 0])


def _unit_of_focal(name: str, says: str, camera: Callable[[Camera], Camera]) -> Hypothesis:
    return Hypothesis(name, says, camera=camera, unit_of_focal=True)


def _principal_point_swapped(camera: Camera) -> Camera:
    K = camera.K.copy()
    K[:2, 2] = K[1::-1, 2]
    return replace(camera, K=K)


def _of_cloud(
    name: str, says: str, axes: str = "x y z", unit: float | None = None, prior: float = 0.0
) -> Hypothesis:
    """A hypothesis about the cloud's axes, or about its ``unit`` in units of the camera."""
    camera = _unit(unit) if unit else _as_read
    return Hypothesis(name, says, axes, camera, of_cloud=True, prior=prior)


# A start may be another shape, about twice or half as large as the object.
SIZE_PRIOR = 0.14
_OPENGL, _PYTORCH3D = _axes(1.0, -1.0, -1.0), _axes(-1.0, -1.0, 1.0)

HYPOTHESES = {
    hypothesis.name: hypothesis
    for hypothesis in (
        Hypothesis("mask-inverted", "the mask is inverted", mask="inverted"),
        Hypothesis("mask-flipped", "the mask is flipped left to right", mask="left-right"),
        Hypothesis("mask-upside-down", "the mask is upside down", mask="upside-down"),
        _of_cloud("cloud-z-up", "the cloud's z points up, the scene's y", "x z -y"),
        _of_cloud("cloud-y-up", "the cloud's y points up, the scene's z", "x -z y"),
        _of_cloud("cloud-upside-down", "the cloud is upside down", "x -y -z"),
        _of_cloud("cloud-xy-swapped", "x and y of the cloud are exchanged", "y x z"),
        _of_cloud("cloud-yz-swapped", "y and z of the cloud are exchanged", "x z y"),
        _of_cloud("cloud-xz-swapped", "x and z of the cloud are exchanged", "z y x"),
        _of_cloud("cloud-yzx", "the cloud's axes are y, z, x", "z x y"),
        _of_cloud("cloud-zxy", "the cloud's axes are z, x, y", "y z x"),
        _of_cloud("cloud-inches", "the cloud is in inches, the camera in metres", unit=0.0254),
        _of_cloud(
            "cloud-millimetres", "the cloud is in millimetres, the camera in metres", unit=1e-3
        ),
        _of_cloud(
            "cloud-centimetres", "the cloud is in centimetres, the camera in metres", unit=1e-2
        ),
        Hypothesis(
            "camera-inches",
            "the camera is in inches, the cloud in metres",
            camera=_unit(1.0 / 0.0254),
        ),
        Hypothesis(
            "camera-millimetres",
            "the camera is in millimetres, the cloud in metres",
            camera=_unit(1e3),
        ),
        Hypothesis(
            "camera-centimetres",
            "the camera is in centimetres, the cloud in metres",
            camera=_unit(1e2),
        ),
        _of_cloud(
            "cloud-ten-times-large",
            "the cloud is ten times too large, as millimetres for centimetres",
            unit=0.1,
        ),
        _of_cloud(
            "cloud-ten-times-small",
            "the cloud is ten times too small, as centimetres for millimetres",
            unit=10.0,
        ),
        _of_cloud(
            "cloud-twice-large", "the cloud is about twice too large", unit=0.5, prior=SIZE_PRIOR
        ),
        _of_cloud(
            "cloud-half-large",
            "the cloud is about half as large as it should be",
            unit=2.0,
            prior=SIZE_PRIOR,
        ),
        Hypothesis("opengl", "the camera's axes are OpenGL's (y up, z backward)", camera=_OPENGL),
        Hypothesis(
            "pytorch3d", "the camera's axes are PyTorch3D's (x left, y up)", camera=_PYTORCH3D
        ),
        Hypothesis("camera-to-world", "R and t are camera-to-world", camera=_inverse),
        Hypothesis(
            "opengl-camera-to-world",
            "R and t are camera-to-world with OpenGL's axes, as Blender's and NeRF's",
            camera=lambda camera: _OPENGL(_inverse(camera)),
        ),
        Hypothesis(
            "t-of-position",
            "t is the camera's position",
            camera=lambda camera: replace(camera, t=-camera.R @ camera.t),
        ),
        Hypothesis(
            "R-transposed", "R is transposed", camera=lambda camera: replace(camera, R=camera.R.T)
        ),
        Hypothesis("K-of-half-size", "K is of an image half as wide", camera=_image(2.0)),
        Hypothesis("K-of-double-size", "K is of an image twice as wide", camera=_image(0.5)),
        _unit_of_focal("K-normalised", "K is in shares of the width and height", _of_shares),
        _unit_of_focal(
            "K-ndc",
            "K is in normalised device coordinates, as PyTorch3D's (its axes: pytorch3d)",
            _of_ndc,
        ),
        _unit_of_focal(
            "focal-mm-36",
            "the focal length is in mm, of a sensor 36 mm wide (focal-mm-32: 32 mm)",
            _of_sensor(36.0),
        ),
        _unit_of_focal(
            "focal-mm-32",
            "the focal length is in mm, of a sensor 32 mm wide, as Pix3D's (focal-mm-36: 36 mm)",
            _of_sensor(32.0),
        ),
        _unit_of_focal(
            "focal-degrees",
            "the focal length is the horizontal field of view in degrees",
            _focal(_of_degrees),
        ),
        Hypothesis(
            "principal-point-swapped",
            "x and y of the principal point are exchanged",
            camera=_principal_point_swapped,
        ),
    )
}


def _by_name(name: str) -> Hypothesis:
    return HYPOTHESES[name]


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


def assumptions_of(texts: Sequence[str], views: Sequence[str]) -> tuple[Assumption, ...]:
    """The assumptions that ``texts`` name: NAME, or NAME@VIEW for one view alone.

    A view is named by its whole name or by the last part of a path. Raises InputError for a name
    that is not in the table, a view that is not in ``views``, or a text that is given twice.
    """
    found = []
    for text in texts:
        name, at, view = text.partition("@")
        if name not in HYPOTHESES or (at and not view):
            raise InputError(
                f"`assume` is {text!r}, expected a name of `assume` list, such as {_like(name)}, "
                "or NAME@MASK for one mask of several"
            )
        hypothesis = HYPOTHESES[name]
        if at and hypothesis.of_cloud:
            raise InputError(
                f"`assume` is {text!r}, expected {name} alone: the cloud is the same for all masks"
            )
        if texts.count(text) > 1:
            raise InputError(f"`assume` has {text} twice, expected it once")
        found.append(Assumption(hypothesis, _named(text, view, views) if at else ""))
    return tuple(found)


def _like(name: str) -> str:
    """The hypothesis whose name is most like ``name``."""
    from difflib import get_close_matches

    return next(iter(get_close_matches(name, HYPOTHESES, 1, 0.0)), "mask-inverted")


def _named(text: str, view: str, views: Sequence[str]) -> str:
    """The one of ``views`` that ``view`` names."""
    view = str(Path(view))
    found = [name for name in views if name == view]
    found = found or [name for name in views if Path(name).name == view]
    if len(found) != 1:
        count = f"there are {len(found)} such masks" if found else "there is no such mask"
        raise InputError(f"`assume` is {text!r}: {count}, expected one of {', '.join(views)}")
    return found[0]


def as_meant(view: View, assumptions: Iterable[Assumption]) -> View:
    """``view``, as it was read, under ``assumptions``: as it sees points in the cloud's axes.

    Depth map and photo are taken as right.
    """
    of_view = [one for one in assumptions if one.is_about(view)]
    if not of_view:
        return view
    mask, known, camera = view.mask, view.known, view.camera
    changes = mask_changes(view, of_view)
    if "inverted" in changes:
        mask = np.float32(1.0) - mask
    for change, order in (("left-right", np.s_[:, ::-1]), ("upside-down", np.s_[::-1])):
        if change in changes:
            mask, known = mask[order], None if known is None else known[order]
    for assumption in of_view:
        camera = assumption.hypothesis.camera(camera)
    meant = replace(view, mask=mask, known=known, camera=camera)
    return _in_axes_of_cloud(meant, axes_of(of_view))


def mask_changes(view: View, assumptions: Iterable[Assumption]) -> set[MaskChange]:
    """How the mask of a view differs from what is meant; a change made twice is none."""
    changes: set[MaskChange] = set()
    for assumption in assumptions:
        if assumption.is_about(view) and assumption.hypothesis.mask:
            changes ^= {assumption.hypothesis.mask}
    return changes


def axes_of(assumptions: Iterable[Assumption]) -> Array:
    """[3, 3], from points of the cloud to points of the scene, under all assumptions."""
    axes = np.eye(3)
    for assumption in assumptions:
        axes = assumption.hypothesis.matrix @ axes
    return axes


def left_handed(assumptions: Iterable[Assumption]) -> bool:
    """Whether the cloud has left-handed axes, so that pictures and cameras are mirrored."""
    return bool(np.linalg.det(axes_of(assumptions)) < 0.0)


def _in_axes_of_cloud(view: View, axes: Array) -> View:
    """The view whose camera sees points of the cloud where ``view`` sees ``axes`` times them.

    For left-handed axes its pictures are mirrored with the camera: no camera is a reflection.
    """
    if np.linalg.det(axes) < 0.0:
        mirror = MirrorPlane(np.array([1.0, 0.0, 0.0]), 0.0)
        flipped, axes = mirror.flipped(view), mirror.reflect(axes.T).T
        image = None if view.image is None else view.image[:, ::-1]
        pictures = {name: getattr(flipped, name) for name in ("mask", "known", "depth", "camera")}
        view = replace(view, image=image, **pictures)
    return replace(view, camera=replace(view.camera, R=view.camera.R @ axes))
