"""What a camera file says of one view, and the complete camera for a picture of some size."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...errors import InputError, prefixed
from ...geometry.arrays import Array
from ...geometry.camera import Camera, from_shares
from ...geometry.distortion import Distortion
from ..reading import plain

Intrinsics = Callable[[int, int], Array]
"""K [3, 3] in pixels of a picture of this width and height."""

# Between the axes of a camera of another program and those of OpenCV (x right, y down, z forward).
OPENGL = np.diag([1.0, -1.0, -1.0])  # x right, y up, z backward; also Blender, NeRF, glTF
PYTORCH3D = np.diag([-1.0, -1.0, 1.0])  # x left, y up, z forward; also Pix3D
# From points with y up, as glTF has them, to points with z up.
_Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
# Sides of pictures may differ by this many pixels if a program rounded a size.
ROUNDED = 1.0


@dataclass(frozen=True, eq=False)
class CameraRecord:
    """A complete camera and the files that it belongs to, if the camera file names them."""

    camera: Camera
    mask: Path | None = None
    image: Path | None = None


@dataclass(frozen=True, eq=False)
class PartialCamera:
    """What a camera file says of one view; None where it says nothing.

    title : what messages call the view: "views[1]", "image 003.png".
    intrinsics : K for a picture of a given size (`of_pixels`, `of_widths`, ...).
    R, t : [3, 3] and [3], world to camera in the axes of OpenCV.
    size : width and height of the picture, px.
    mask, image : the files that the view names.
    names : names of further files of this view, such as masks that a data set derives from it.
    z_up : whether the pose is that of an object whose z is up, though its mesh may have y up.
    unread : keys of the file that look like a pose, and do not say which way it leads.
    """

    title: str
    intrinsics: Intrinsics | None = None
    R: Array | None = None
    t: Array | None = None
    size: tuple[int, int] | None = None
    model: str = "perspective"
    distortion: Distortion | None = None
    mask: Path | None = None
    image: Path | None = None
    names: tuple[str, ...] = ()
    sized_by: Path | None = None  # the file that says the size, if it is another one
    z_up: bool = False
    unread: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """The file that the view names, or its title."""
        file = self.mask or self.image
        name = file.name if file else self.title
        return plain(name) if name else ""

    def for_y_up(self) -> PartialCamera:
        """The same view of the same object with its y up, if this is of one with its z up."""
        if not self.z_up or self.R is None:
            return self
        return replace(self, R=self.R @ _Y_UP_TO_Z_UP, z_up=False)

    def camera(self, path: Path, width: int, height: int) -> Camera:
        """The camera for a mask of ``width`` x ``height``; ``path`` is the camera file.

        If the file's picture has another size and the same shape, K is scaled. Raises InputError
        if the shapes differ, or if K or the pose is missing.
        """
        where = f"{path}: {plain(self.title)}: " if self.title else f"{path}: "
        if self.size and not same_shape(self.size, (width, height)):
            of_size = f"{self.sized_by}: " if self.sized_by else where
            raise InputError(
                f"{of_size}is for a picture of {self.size[0]}x{self.size[1]}, the mask is "
                f"{width}x{height}, expected the same proportions; resize or crop the mask as the "
                "picture was"
            )
        if self.intrinsics is None:
            raise InputError(
                f"{where}has a pose but no focal length, expected both; name a file with K: "
                "`intrinsics` FILE, or give `focal` PX or `fov` DEGREES"
            )
        if self.R is None or self.t is None:
            if path.stem == "cameras" and path.suffix in (".bin", ".txt"):
                raise InputError(
                    f"{where}has K but no pose, expected both; give the folder of the COLMAP "
                    f"model, with cameras{path.suffix} and images{path.suffix}"
                )
            if self.unread:
                raise InputError(
                    f"{where}has K, and {' and '.join(map(plain, self.unread[:3]))} may be the "
                    "pose, expected the name w2c (world to camera) or c2w (camera to world), with "
                    "z forward"
                )
            raise InputError(
                f"{where}has K but no pose, expected R and t; `camera` fit with `intrinsics` FILE "
                "estimates the pose of a single mask"
            )
        with prefixed(where), np.errstate(all="ignore"):
            return Camera(self.intrinsics(width, height), self.R, self.t, width, height, self.model)


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether two sizes (width, height) have the same proportions up to rounding."""
    (w, h), (width, height) = size, other
    larger = max(width / w, height / h, 1.0)
    return abs(width * h - height * w) <= ROUNDED * larger * max(w, h)


def from_world_to_camera(matrix: Array, axes: Array | None = None) -> tuple[Array, Array]:
    """R and t of a matrix [4, 4], or its upper rows, world to camera; its camera has ``axes``."""
    R, t = matrix[:3, :3], matrix[:3, 3]
    return (R, t) if axes is None else (axes @ R, axes @ t)


def from_camera_to_world(matrix: Array, axes: Array | None = None) -> tuple[Array, Array]:
    """R and t of a matrix [4, 4], or its upper rows, camera to world; its camera has ``axes``."""
    R = matrix[:3, :3].T if axes is None else axes @ matrix[:3, :3].T
    return R, -R @ matrix[:3, 3]


def of_pixels(K: Array, size: tuple[int, int] | None) -> Intrinsics:
    """``K`` in pixels of a picture of ``size``, with pixel centres at whole numbers."""

    def scaled(width: int, height: int) -> Array:
        if size is None or size == (width, height):
            return K
        sx, sy = width / size[0], height / size[1]
        change = np.array([[sx, 0.0, (sx - 1.0) / 2.0], [0.0, sy, (sy - 1.0) / 2.0], [0, 0, 1.0]])
        scaled: Array = change @ K
        return scaled

    return scaled


def matrix_of(fx: float, fy: float, cx: float, cy: float, *, corner: bool = False) -> Array:
    """K of these numbers; with ``corner`` pixel centres lie at halves, as in COLMAP."""
    shift = 0.5 if corner else 0.0
    return np.array([[fx, 0.0, cx - shift], [0.0, fy, cy - shift], [0.0, 0.0, 1.0]])


def _centred(focal: float, width: int, height: int) -> Array:
    return matrix_of(focal, focal, width / 2.0, height / 2.0, corner=True)


def of_widths(focal: float) -> Intrinsics:
    """Square pixels, the principal point in the middle, the focal length in widths."""
    return lambda width, height: _centred(focal * width, width, height)


def of_longer_sides(focal: float) -> Intrinsics:
    """As `of_widths`, in longer sides of the picture."""
    return lambda width, height: _centred(focal * max(width, height), width, height)


def of_horizontal_angle(radians: float) -> Intrinsics:
    """As `of_widths`, from the horizontal field of view."""
    return of_widths(0.5 / math.tan(radians / 2.0))


def of_vertical_angle(radians: float) -> Intrinsics:
    """As `of_widths`, from the vertical field of view."""
    focal = 0.5 / math.tan(radians / 2.0)
    return lambda width, height: _centred(focal * height, width, height)


def of_shares(K: Array) -> Intrinsics:
    """``K`` in shares of the width and the height, with pixel centres at halves, as MoGe's."""
    return lambda width, height: from_shares(K, width, height)


def of_ndc(fx: float, fy: float, px: float, py: float) -> Intrinsics:
    """PyTorch3D's normalised device coordinates: x left, y up, the shorter side spans -1 to 1."""

    def in_pixels(width: int, height: int) -> Array:
        half = min(width, height) / 2.0
        centre = width / 2.0 - half * px, height / 2.0 - half * py
        return matrix_of(half * fx, half * fy, *centre, corner=True)

    return in_pixels
