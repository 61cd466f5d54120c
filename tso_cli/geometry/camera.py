"""The camera model and the frame changes that keep its pictures the same.

Conventions (OpenCV): x right, y down, z forward; ``X_camera = R X_world + t``. ``u`` is the column
and ``v`` the row of a pixel. The centre of a pixel lies at integer coordinates. ``K`` is in pixels
of the image that it belongs to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import InputError
from .arrays import LARGEST, Array, Bits, Box, as_numbers
from .points import longest_side

# The canonical camera is the camera of the CAPNet authors' code.
CANONICAL_ROTATION = np.diag([1.0, -1.0, -1.0])
CANONICAL_DISTANCE = 2.0
CANONICAL_FOCAL_AT_64 = 120.0  # pixels, for an image whose longer side is 64 pixels
SMALLEST_FOCAL = 1e-15  # pixels; a pose has no correct digits before a smaller one
MODELS = ("perspective", "orthographic")
# The least depth of a visible point, in units of the cloud's longest side.
NEAR = 1e-3
MOST_PIXELS = 1_000_000_000  # of a side


@dataclass(frozen=True, eq=False)
class Camera:
    """One calibrated view.

    Raises InputError if a shape is wrong, a number is not finite, K is singular or R is not a
    rotation.
    """

    K: Array  # [3, 3] intrinsics in pixels of the image; last row (0, 0, 1)
    R: Array  # [3, 3] rotation, world to camera
    t: Array  # [3] or [3, 1] translation, world units
    width: int  # of the image in pixels
    height: int
    model: str = "perspective"  # u = fx X/Z + cx, or "orthographic": u = fx X + cx

    def __post_init__(self) -> None:
        for name, shape in (("K", (3, 3)), ("R", (3, 3)), ("t", (3,))):
            object.__setattr__(self, name, self._checked_array(name, shape))
        for name in ("width", "height"):
            object.__setattr__(self, name, _checked_size(name, getattr(self, name)))
        if not isinstance(self.model, str) or self.model not in MODELS:
            raise InputError(f"model is {self.model!r}, expected one of {', '.join(MODELS)}")
        if (np.abs(self.K[2] - [0.0, 0.0, 1.0]) > [1e-8, 1e-8, 1e-5]).any() or self.K[1, 0] != 0.0:
            raise InputError(
                f"K is {self.K.tolist()}, expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]]"
            )
        fx, fy = self.K[0, 0], self.K[1, 1]
        if min(fx, fy) <= 0.0:
            mirrored = max(fx, fy) < 0.0 or min(fx, fy) < 0.0 < max(fx, fy)
            advice = "; make it positive and negate that row of R and t" if mirrored else ""
            raise InputError(
                f"K is singular or mirrored: fx = {fx:g}, fy = {fy:g}, expected both > 0{advice}"
            )
        if self.model == "perspective" and min(fx, fy) < SMALLEST_FOCAL:
            raise InputError(
                f"K has fx = {fx:g} and fy = {fy:g} pixels, expected at least {SMALLEST_FOCAL:g}"
            )
        with np.errstate(over="ignore", invalid="ignore"):
            error, handedness = np.abs(self.R @ self.R.T - np.eye(3)).max(), np.linalg.det(self.R)
        if not (error <= 1e-3 and handedness > 0.0):
            raise InputError(
                f"R is not a rotation: |R R^T - I| = {error:.2g}, det R = {handedness:.3g}, "
                f"expected 0 and 1{_advice_for(self.R, handedness)}"
            )

    def _checked_array(self, name: str, shape: tuple[int, ...]) -> Array:
        value: Array = as_numbers(getattr(self, name), name)
        if value.shape == (3, 1):
            value = value[:, 0]
        if value.shape != shape:
            raise InputError(f"{name} has shape {list(value.shape)}, expected {list(shape)}")
        if not np.isfinite(value).all():
            raise InputError(f"{name} holds a number that is not finite, expected finite ones")
        if (largest := np.abs(value).max()) > LARGEST:
            raise InputError(f"{name} holds {largest:g}, expected at most {LARGEST:g}")
        return value

    @classmethod
    def canonical(cls, width: int, height: int) -> Camera:
        """The camera that is assumed when none is given: the camera of the CAPNet authors' code.

        The cloud is aligned with the view (x right, y up, z toward the viewer). Its centre is 2
        units away. The focal length is 120 px for each 64 px of the longer side.
        """
        width, height = _checked_size("width", width), _checked_size("height", height)
        K = intrinsics(CANONICAL_FOCAL_AT_64 * max(width, height) / 64.0, width, height)
        return cls(K, CANONICAL_ROTATION, np.array([0.0, 0.0, CANONICAL_DISTANCE]), width, height)

    @property
    def position(self) -> Array:
        """[3] where a perspective camera stands, world units: -R^T t."""
        return -self.R.T @ self.t

    def resized(self, width: int, height: int) -> Camera:
        """The same camera for its image resized to ``width`` x ``height``."""
        return self.cropped((-0.5, -0.5, self.width - 0.5, self.height - 0.5), width, height)

    def cropped(self, box: Box, width: int, height: int) -> Camera:
        """The camera of the region ``box`` of the image, resized to ``width`` x ``height``."""
        left, top, right, bottom = box
        sx, sy = width / (right - left), height / (bottom - top)
        change = np.array(
            [[sx, 0.0, -left * sx - 0.5], [0.0, sy, -top * sy - 0.5], [0.0, 0.0, 1.0]]
        )
        return replace(self, K=change @ self.K, width=width, height=height)

    def for_normalised(self, centre: Array, scale: float) -> Camera:
        """The camera that sees ``(X - centre) / scale`` exactly where this one sees ``X``."""
        return self.before_placed(np.eye(3), centre, scale)

    def before_placed(self, R: Array, t: Array, size: float) -> Camera:
        """The camera that sees ``X`` exactly where this one sees ``size * R X + t``."""
        K = self.K
        if self.model == "orthographic":
            K = K @ np.diag([size, size, 1.0])
        return replace(self, K=K, R=self.R @ R, t=(self.R @ t + self.t) / size)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Pixel coordinates [N, 2] and depth [N] of ``points`` [N, 3] (Eq. 1 of the paper).

        The pixel coordinates of points behind a perspective camera are NaN.
        """
        camera = points @ self.R.T + self.t
        depth = camera[:, 2]
        plane = camera[:, :2]
        if self.model == "perspective":
            with np.errstate(divide="ignore", invalid="ignore"):
                plane = np.where(depth[:, None] > 0.0, plane / depth[:, None], np.nan)
        return plane @ self.K[:2, :2].T + self.K[:2, 2], depth

    def ray_lengths(self, row: Array, column: Array) -> Array:
        """Lengths of the rays through pixels, up to depth 1; ``row`` and ``column`` broadcast."""
        y = (row - self.K[1, 2]) / self.K[1, 1]
        x = (column - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0]
        return np.asarray(np.sqrt(x * x + y * y + 1.0))

    def project_visible(self, points: Array) -> tuple[Array, Array, Bits]:
        """As `project`, and which of the points [N] are visible.

        A point is visible if its pixel coordinates are finite, inside the image or not. A
        perspective camera sees only points whose depth is more than NEAR times the longest side of
        the cloud ``points``.
        """
        pixels, depth = self.project(points)
        visible: Bits = np.asarray(np.isfinite(pixels).all(1))
        if self.model == "perspective":
            visible &= depth > NEAR * longest_side(points)
        return pixels, depth, visible


def _checked_size(name: str, size: Any) -> int:
    number = isinstance(size, (int, float, np.integer)) and not isinstance(size, bool)
    if not number or not 1 <= size <= MOST_PIXELS or size % 1:
        raise InputError(
            f"{name} is {repr(size)[:40]}, expected a whole number of pixels, 1 or more"
        )
    return int(size)


def _advice_for(R: Array, determinant: float) -> str:
    """How to mend an R that is a rotation with a scale or a reflection in it."""
    scale = abs(determinant) ** (1.0 / 3.0)
    if not 0.0 < scale < np.inf or np.abs(R @ R.T / scale**2 - np.eye(3)).max() > 1e-3:
        return ""
    if determinant < 0.0:
        return "; it mirrors: negate the row of R and t whose axis points the other way"
    return f"; it has a scale: divide R and t by {scale:.6g}"


def intrinsics(focal: float, width: int, height: int) -> Array:
    """K [3, 3] with the focal length ``focal`` in pixels and the principal point in the middle."""
    return np.array(
        [[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]]
    )


def from_shares(K: Array, width: int, height: int) -> Array:
    """K [3, 3] in pixels, of a ``K`` in shares of width and height with pixel centres at halves."""
    in_pixels: Array = np.diag([float(width), float(height), 1.0]) @ K
    in_pixels[:2, 2] -= 0.5
    return in_pixels
