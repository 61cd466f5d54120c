"""What people commonly get wrong in cloud, camera and mask: one table of hypotheses."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..geometry.arrays import Array
from ..geometry.camera import Camera, from_shares

CameraChange = Callable[[Camera], Camera]

# In longer sides of the picture. A shorter focal length has a field of view of over 90 degrees,
# which few cameras have: it may be in another unit.
SHORTEST_FOCAL = 1.0 / 2.0


def focal_in_pixels(camera: Camera) -> bool:
    """Whether the focal length is likely to be in pixels (`SHORTEST_FOCAL`)."""
    longer = max(camera.width, camera.height)
    return camera.model != "perspective" or bool(camera.K[0, 0] >= SHORTEST_FOCAL * longer)


def _as_read(camera: Camera) -> Camera:
    return camera


def permutation(axes: str) -> Array:
    """[n, n], the orthogonal matrix of ``axes`` in words, as "x z -y": row i is the i-th axis."""
    names = axes.split()
    rows = [("xyz".index(name[-1]), -1.0 if name[0] == "-" else 1.0) for name in names]
    return np.stack([sign * np.eye(len(names))[column] for column, sign in rows])


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One way in which the input may be meant, if not as the conventions have it.

    name : what ``assume`` takes. says : in words.
    axes : the x, y and z of the scene, in the axes of the cloud.
    camera : the camera that is meant, from the camera as it was read.
    picture : the x and y of the picture that is meant, in the axes of the mask as it was read.
    inverted : whether foreground and background of the mask are exchanged.
    """

    name: str
    says: str
    axes: str = "x y z"
    camera: CameraChange = _as_read
    picture: str = "x y"
    inverted: bool = False

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Hypothesis) and other.name == self.name

    def __hash__(self) -> int:
        return hash(self.name)

    def __reduce__(self) -> tuple[Callable[[str], Hypothesis | None], tuple[str]]:
        # By name, since the functions of the table cannot be sent to another process.
        return hypothesis_called, (self.name,)

    @property
    def of_cloud(self) -> bool:
        """Whether it is about the cloud, and so the same for all views."""
        return self.name.startswith("cloud-")

    @property
    def of_mask(self) -> bool:
        return self.inverted or self.picture != "x y"

    @property
    def changes_camera(self) -> bool:
        return self.camera is not _as_read

    @property
    def turns(self) -> bool:
        """Whether the cloud is turned, so that it has other extents in the picture."""
        return self.axes != "x y z"

    def applies(self, camera: Camera) -> bool:
        """Whether it may hold for a ``camera`` as it was read."""
        if self in FOCAL_UNITS:
            return not focal_in_pixels(camera)
        # A picture that is turned by a right angle has the same size only if it is square.
        return self.picture not in ("-y x", "y -x") or camera.width == camera.height

    @cached_property
    def matrix(self) -> Array:
        """[3, 3], from points of the cloud to points of the scene; orthogonal."""
        return permutation(self.axes)


def _axes(*signs: float) -> CameraChange:
    """The axes of the camera's frame reversed by ``signs`` of x, y and z."""
    flip = np.array(signs)
    return lambda camera: replace(camera, R=flip[:, None] * camera.R, t=flip * camera.t)


def _transposed(camera: Camera) -> Camera:
    return replace(camera, R=camera.R.T)


def _inverse(camera: Camera) -> Camera:
    return replace(camera, R=camera.R.T, t=-camera.R.T @ camera.t)


def _unit(factor: float) -> CameraChange:
    """The cloud's unit is ``factor`` times the camera's unit."""

    def in_units_of_cloud(camera: Camera) -> Camera:
        flat = camera.model == "orthographic"
        K = camera.K @ np.diag([factor, factor, 1.0]) if flat else camera.K
        return replace(camera, K=K, t=camera.t / factor)

    return in_units_of_cloud


def _of_ndc(camera: Camera) -> Camera:
    half = min(camera.width, camera.height) / 2.0
    K = np.diag([half, half, 1.0]) @ camera.K
    K[:2, 2] = np.array([camera.width, camera.height]) / 2.0 - 0.5 - K[:2, 2]
    return replace(camera, K=K)


def _focal(factor: Callable[[Camera], float]) -> CameraChange:
    """The focal length is multiplied by ``factor``."""
    entries = np.array([[1, 1, 0], [0, 1, 0], [0, 0, 0]], bool)
    return lambda camera: replace(camera, K=camera.K * np.where(entries, factor(camera), 1.0))


def _of_degrees(camera: Camera) -> float:
    degrees = min(float(camera.K[0, 0]), 179.0)
    return camera.width / 2.0 / np.tan(np.radians(degrees / 2.0)) / float(camera.K[0, 0])


def _mask(name: str, says: str, picture: str) -> Hypothesis:
    return Hypothesis(f"mask-{name}", f"the mask is {says}", picture=picture)


def _units(what: str, unit: str, metres: float) -> Hypothesis:
    other = "camera" if what == "cloud" else "cloud"
    says = f"the {what} is in {unit}, the {other} in metres"
    return Hypothesis(f"{what}-{unit}", says, camera=_unit(metres))


def _size(name: str, says: str, factor: float) -> Hypothesis:
    return Hypothesis(f"cloud-{name}", f"the cloud is {says}", camera=_unit(factor))


_OPENGL, _X_LEFT = _axes(1.0, -1.0, -1.0), _axes(-1.0, -1.0, 1.0)
_LENGTHS = {"inches": 0.0254, "millimetres": 1e-3, "centimetres": 1e-2}
_MM = "the focal length is in mm, of a sensor {} mm wide"
_BACK = "R and t are camera-to-world"

# About the axes of the camera, and which axis of the cloud points up: two mistakes that files of
# other tools combine, as Blender's cameras and glTF's clouds.
OF_AXES = (
    Hypothesis("opengl", "the camera's axes are OpenGL's (y up, z backward)", camera=_OPENGL),
    Hypothesis("pix3d", "the camera's axes are Pix3D's (x left, y up)", camera=_X_LEFT),
    Hypothesis(
        "pytorch3d",
        "R and T are PyTorch3D's (they multiply rows; x left, y up)",
        camera=lambda camera: _X_LEFT(_transposed(camera)),
    ),
    Hypothesis("camera-to-world", _BACK, camera=_inverse),
    Hypothesis(
        "opengl-camera-to-world",
        f"{_BACK} with OpenGL's axes, as Blender's and NeRF's",
        camera=lambda camera: _OPENGL(_inverse(camera)),
    ),
    Hypothesis("R-transposed", "R is transposed, or multiplies rows", camera=_transposed),
)
UPRIGHT = (
    Hypothesis("cloud-z-up", "the cloud's z points up, the scene's y", "x z -y"),
    Hypothesis("cloud-y-up", "the cloud's y points up, the scene's z", "x -z y"),
    Hypothesis("cloud-upside-down", "the cloud is upside down", "x -y -z"),
)
FOCAL_UNITS = (
    Hypothesis(
        "K-normalised",
        "K is in shares of the width and height",
        # Pixel centres are at halves, as MoGe's.
        camera=lambda camera: replace(camera, K=from_shares(camera.K, camera.width, camera.height)),
    ),
    Hypothesis("K-ndc", "K is in normalised device coordinates, as PyTorch3D's", camera=_of_ndc),
    Hypothesis(
        "focal-mm-36",
        f"{_MM.format(36)} (focal-mm-32: 32 mm)",
        camera=_focal(lambda camera: camera.width / 36.0),
    ),
    Hypothesis(
        "focal-mm-32",
        f"{_MM.format(32)}, as Pix3D's",
        camera=_focal(lambda camera: camera.width / 32.0),
    ),
    Hypothesis(
        "focal-degrees",
        "the focal length is the horizontal field of view in degrees",
        camera=_focal(_of_degrees),
    ),
)
HYPOTHESES = {
    hypothesis.name: hypothesis
    for hypothesis in (
        Hypothesis("mask-inverted", "the mask is inverted", inverted=True),
        _mask("flipped", "flipped left to right", "-x y"),
        _mask("upside-down", "upside down", "x -y"),
        _mask("turned", "turned by 180 degrees", "-x -y"),
        _mask("turned-left", "turned by 90 degrees to the left", "-y x"),
        _mask("turned-right", "turned by 90 degrees to the right", "y -x"),
        *UPRIGHT,
        Hypothesis("cloud-xy-swapped", "x and y of the cloud are exchanged", "y x z"),
        Hypothesis("cloud-yz-swapped", "y and z of the cloud are exchanged", "x z y"),
        Hypothesis("cloud-xz-swapped", "x and z of the cloud are exchanged", "z y x"),
        Hypothesis("cloud-yzx", "the cloud's axes are y, z, x", "z x y"),
        Hypothesis("cloud-zxy", "the cloud's axes are z, x, y", "y z x"),
        *(_units("cloud", name, metres) for name, metres in _LENGTHS.items()),
        *(_units("camera", name, 1.0 / metres) for name, metres in _LENGTHS.items()),
        _size("ten-times-large", "ten times too large, as millimetres for centimetres", 0.1),
        _size("ten-times-small", "ten times too small, as centimetres for millimetres", 10.0),
        _size("twice-large", "about twice too large", 0.5),
        _size("half-large", "about half as large as it should be", 2.0),
        *OF_AXES,
        Hypothesis(
            "t-of-position",
            "t is the camera's position",
            camera=lambda camera: replace(camera, t=-camera.R @ camera.t),
        ),
        *FOCAL_UNITS,
        Hypothesis(
            "principal-point-swapped",
            "x and y of the principal point are exchanged",
            camera=lambda camera: replace(
                camera, K=np.column_stack([camera.K[:, :2], camera.K[[1, 0, 2], 2]])
            ),
        ),
    )
}
"""By name; and there is `of_width` for each width of an image."""

OF_WIDTH = "K-of-width"


def of_width(width: int, height: int | None = None) -> Hypothesis:
    """K is of the image resized to this ``width`` and ``height``; pixel centres are at integers.

    Without a height the image kept its proportions.
    """

    def resized(camera: Camera) -> Camera:
        sx = camera.width / width
        sy = camera.height / height if height else sx
        shift = np.array(
            [[sx, 0.0, (sx - 1.0) / 2.0], [0.0, sy, (sy - 1.0) / 2.0], [0.0, 0.0, 1.0]]
        )
        return replace(camera, K=shift @ camera.K)

    size, what = (f"{width}x{height}", "of") if height else (f"{width}", "with a width of")
    return Hypothesis(f"{OF_WIDTH}={size}", f"K is of an image {what} {size} px", camera=resized)


def hypothesis_called(name: str) -> Hypothesis | None:
    """The hypothesis of this name; None if there is none."""
    size = re.fullmatch(rf"{OF_WIDTH}=([1-9]\d{{0,5}})(?:x([1-9]\d{{0,5}}))?", name)
    if size is None:
        return HYPOTHESES.get(name)
    return of_width(*(int(number) for number in size.groups() if number))
