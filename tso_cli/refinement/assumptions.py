"""What people commonly get wrong in cloud, camera and mask: named assumptions, and which of them would make the input fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.camera import Array, Camera
from ..geometry.view import View, object_box
from ..losses.projection import pixels_under

# Cells along the longer side of the mask's box, in which silhouettes are compared, and points that are projected.
CELLS, POINTS = 16, 1024
# An assumption is suspected if silhouettes then agree better than as given by this IoU, and at least so far.
MARGIN, LEAST_IOU = 0.16, 0.4
# Others that fit about as well as the best.
SIMILAR, MOST_SUSPECTS = 0.03, 3
# An inverted mask is foreground along at least so much of the picture's border.
BORDER = 0.6
GOLDEN = (5.0**0.5 - 1.0) / 2.0


@dataclass(frozen=True)
class Assumption:
    """How the input is meant, if not as the conventions have it.

    what : in words. axes : the x, y and z of the scene in those of the cloud. camera : from the camera of the file. mask :
    "inverted", "left-right" or "upside-down".
    """

    what: str
    axes: str = "x y z"
    camera: Callable[[Camera], Camera] | None = None
    mask: str = ""

    @property
    def matrix(self) -> Array:
        """[3, 3], from points of the cloud to points of the scene; orthogonal."""
        rows = [np.eye(3)["xyz".index(axis[-1])] * (-1.0 if axis[0] == "-" else 1.0) for axis in self.axes.split()]
        return np.stack(rows)

    def of_view(self, view: View) -> View:
        """The view as it is meant."""
        mask, known = view.mask, view.known
        if self.mask == "inverted":
            mask = np.float32(1.0) - mask
        elif self.mask:
            order = np.s_[:, ::-1] if self.mask == "left-right" else np.s_[::-1]
            mask, known = mask[order], None if known is None else known[order]
        return replace(view, mask=mask, known=known, camera=self.of_camera(view.camera))

    def of_camera(self, camera: Camera) -> Camera:
        return self.camera(camera) if self.camera else camera


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
    change = np.array([[factor, 0.0, (factor - 1.0) / 2.0], [0.0, factor, (factor - 1.0) / 2.0], [0.0, 0.0, 1.0]])
    return lambda camera: replace(camera, K=change @ camera.K)


def _exchanged(camera: Camera) -> Camera:
    K = camera.K.copy()
    K[:2, 2] = K[1::-1, 2]
    return replace(camera, K=K)


ASSUMPTIONS = {
    "mask-inverted": Assumption("the mask is inverted", mask="inverted"),
    "mask-flipped": Assumption("the mask is flipped left to right", mask="left-right"),
    "mask-upside-down": Assumption("the mask is upside down", mask="upside-down"),
    "cloud-z-up": Assumption("the cloud's z points up, the scene's y", "x z -y"),
    "cloud-y-up": Assumption("the cloud's y points up, the scene's z", "x -z y"),
    "cloud-upside-down": Assumption("the cloud is upside down", "x -y -z"),
    "cloud-xy-swapped": Assumption("x and y of the cloud are exchanged", "y x z"),
    "cloud-yz-swapped": Assumption("y and z of the cloud are exchanged", "x z y"),
    "cloud-xz-swapped": Assumption("x and z of the cloud are exchanged", "z y x"),
    "cloud-yzx": Assumption("the cloud's axes are y, z, x", "z x y"),
    "cloud-zxy": Assumption("the cloud's axes are z, x, y", "y z x"),
    "cloud-inches": Assumption("the cloud is in inches, the camera in metres", camera=_unit(0.0254)),
    "cloud-millimetres": Assumption("the cloud is in millimetres, the camera in metres", camera=_unit(1e-3)),
    "cloud-centimetres": Assumption("the cloud is in centimetres, the camera in metres", camera=_unit(1e-2)),
    "camera-millimetres": Assumption("the camera is in millimetres, the cloud in metres", camera=_unit(1e3)),
    "camera-centimetres": Assumption("the camera is in centimetres, the cloud in metres", camera=_unit(1e2)),
    "opengl": Assumption("the camera's axes are OpenGL's (y up, z backward)", camera=_axes(1.0, -1.0, -1.0)),
    "pytorch3d": Assumption("the camera's axes are PyTorch3D's (x left, y up)", camera=_axes(-1.0, -1.0, 1.0)),
    "camera-to-world": Assumption("R and t are camera-to-world", camera=_to_camera),
    "opengl-camera-to-world": Assumption(
        "R and t are camera-to-world with OpenGL's axes, as Blender's and NeRF's",
        camera=lambda camera: _axes(1.0, -1.0, -1.0)(_to_camera(camera)),
    ),
    "R-transposed": Assumption("R is transposed", camera=lambda camera: replace(camera, R=camera.R.T)),
    "K-of-half-size": Assumption("K is of an image half as wide", camera=_of_image(2.0)),
    "K-of-double-size": Assumption("K is of an image twice as wide", camera=_of_image(0.5)),
    "principal-point-swapped": Assumption("x and y of the principal point are exchanged", camera=_exchanged),
}
"""By the name that `tso refine --assume` takes."""


class Suspect(NamedTuple):
    """An assumption that would make the input fit: ``what`` in words, the ``option`` that makes it, the IoU then."""

    what: str
    option: str
    score: float


def assumptions_of(names: Sequence[str]) -> list[Assumption]:
    """The assumptions of these names; InputError for another name."""
    for name in names:
        if name not in ASSUMPTIONS:
            raise InputError(f"--assume is {name!r}, expected one of {', '.join(ASSUMPTIONS)}")
    return [ASSUMPTIONS[name] for name in names]


@dataclass(frozen=True)
class Agreement:
    """How far the silhouette of a cloud and the masks agree, mean IoU in coarse cells of the views.

    as_given : of the input as it is. best : under the best of `ASSUMPTIONS`. suspects : those that may be true, best first.
    """

    as_given: float
    best: float
    suspects: tuple[Suspect, ...]

    @classmethod
    def of(cls, points: Array, views: Sequence[View]) -> Agreement:
        """Of ``points`` [N, 3]; a few milliseconds."""
        # Points of organised clouds at equal steps may all be of one column: those at multiples of the golden ratio are not.
        points = points[(len(points) * (np.arange(min(len(points), POINTS)) * GOLDEN % 1.0)).astype(np.int64)]
        targets = [{mask: _Cells.of(view, mask) for mask in ("", "inverted")} for view in views]
        as_given = _agreement(Assumption(""), points, views, targets)
        possible = {name: assumption for name, assumption in ASSUMPTIONS.items() if _possible(assumption, views)}
        scores = {name: _agreement(assumption, points, views, targets) for name, assumption in possible.items()}
        best = max(scores.values())
        likely = []
        if best >= max(as_given + MARGIN, LEAST_IOU):
            likely = sorted((name for name in scores if scores[name] >= best - SIMILAR), key=lambda name: -scores[name])
        suspects = [Suspect(ASSUMPTIONS[name].what, f"--assume {name}", scores[name]) for name in likely[:MOST_SUSPECTS]]
        return cls(as_given, best, tuple(suspects))

    def __str__(self) -> str:
        """The suspects in words, nothing without any."""
        if not self.suspects:
            return ""
        others = "".join(f", or {suspect.option}" for suspect in self.suspects[1:])
        return f"it looks as if {self.suspects[0].what}: try {self.suspects[0].option}{others}"


def _possible(assumption: Assumption, views: Sequence[View]) -> bool:
    """False for masks that cannot be inverted: an object that the border truncates, or a speck, would pass for one."""
    if assumption.mask != "inverted":
        return True
    borders = [np.concatenate([*view.inside[[0, -1]], *view.inside[:, [0, -1]].T]) for view in views]
    return bool(np.mean([border.mean() for border in borders]) >= BORDER)


@dataclass(frozen=True, eq=False)
class _Cells:
    """A mask in coarse cells."""

    low: Array  # [2], column and row of the first cell's corner, px
    edge: int  # of a cell, px
    inside: NDArray[np.bool_]  # [rows, columns]
    view: View

    @classmethod
    def of(cls, view: View, mask: str) -> _Cells:
        inside = view.inside if not mask else ~view.inside if view.known is None else ~view.inside & view.known
        left, top, right, bottom = object_box(inside)
        edge = -(-max(right - left, bottom - top) // CELLS)
        rows, columns = -(-(bottom - top) // edge), -(-(right - left) // edge)
        padded = np.zeros((rows * edge, columns * edge), bool)
        padded[: bottom - top, : right - left] = inside[top:bottom, left:right]
        cells = padded.reshape(rows, edge, columns, edge).mean((1, 3)) > 0.1
        return cls(np.array([left, top]) - 0.5, edge, cells, view)

    def iou(self, pixels: Array) -> float:
        """With the cells that ``pixels`` [N, 2] fall in, but for those outside the image or unknown."""
        camera, known = self.view.camera, self.view.known
        finite = np.asarray(np.isfinite(pixels).all(1))
        pixel, visible = pixels_under(pixels, finite, camera.height, camera.width)
        pixels = pixels[visible if known is None else visible & known.ravel()[pixel]]
        column, row = np.floor((pixels - self.low) / self.edge).astype(np.int64).T
        height, width = self.inside.shape
        within = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        covered = np.zeros_like(self.inside)
        covered[row[within], column[within]] = True
        beside = len(np.unique(column[~within] * (1 << 32) + row[~within]))
        common = np.count_nonzero(covered & self.inside)
        return common / (np.count_nonzero(covered | self.inside) + beside)


def _agreement(assumption: Assumption, points: Array, views: Sequence[View], targets: list[dict[str, _Cells]]) -> float:
    """Mean IoU over the views."""
    points, ious = points @ assumption.matrix.T, []
    for view, cells in zip(views, targets, strict=True):
        camera = assumption.of_camera(view.camera)
        pixels, _ = camera.project(points)
        # The mask flipped is the cloud's picture flipped.
        if assumption.mask == "left-right":
            pixels[:, 0] = camera.width - 1.0 - pixels[:, 0]
        elif assumption.mask == "upside-down":
            pixels[:, 1] = camera.height - 1.0 - pixels[:, 1]
        ious.append(cells["inverted" if assumption.mask == "inverted" else ""].iou(pixels))
    return float(np.mean(ious))
