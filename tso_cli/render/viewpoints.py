"""What to render, and where the cameras stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry.camera import CANONICAL_DISTANCE, CANONICAL_FOCAL_AT_64, Camera
from ..geometry.points import Array

MARGIN_PX = 2.0
"""Free border left around the object when the distance is chosen here."""


@dataclass(frozen=True)
class RenderSettings:
    """What to render of every mesh.

    Parameters
    ----------
    views : pictures of each object.
    size : width, height in pixels.
    azimuth, elevation : range in degrees from which each view draws uniformly.
    distance : of the camera from the centre, in longest sides; None takes for each view the smallest, 2 or more, at which the
        whole object is in the picture.
    focal : focal length in pixels; None is 120 for each 64 of the longer side.
    samples : points drawn from the surface; points : how many of them farthest-point sampling keeps.
    copies : how many warped copies of each mesh are rendered beside it (see `variation.warp`), for training.
    paint : give each connected part a random colour; False keeps the mesh's own, or grey.

    Raises
    ------
    InputError
        A number is outside what makes sense.
    """

    views: int = 24
    size: tuple[int, int] = (64, 64)
    azimuth: tuple[float, float] = (0.0, 360.0)
    elevation: tuple[float, float] = (-5.0, 40.0)
    distance: float | None = None
    focal: float | None = None
    samples: int = 16384
    points: int = 1024
    copies: int = 0
    paint: bool = False

    def __post_init__(self) -> None:
        if self.views < 1:
            raise InputError(f"views is {self.views}, expected 1 or more")
        if not 0 <= self.copies <= 9999:
            raise InputError(f"copies is {self.copies}, expected 0 to 9999")
        if min(self.size) < 8 or max(self.size) > 8192:
            raise InputError(f"size is {self.size[0]}x{self.size[1]}, expected 8 to 8192 pixels each way")
        for name, limit in (("azimuth", 360.0), ("elevation", 90.0)):
            low, high = getattr(self, name)
            if not -limit <= low <= high <= limit:
                raise InputError(f"{name} is {low:g} to {high:g}, expected a range within -{limit:g} to {limit:g} degrees")
        for name in ("distance", "focal"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise InputError(f"{name} is {value:g}, expected more than 0")
        if not 1 <= self.points <= self.samples:
            raise InputError(f"points is {self.points} and samples {self.samples}, expected 1 <= points <= samples")


def look_at(azimuth: float, elevation: float, distance: float, size: tuple[int, int], focal: float | None = None) -> Camera:
    """The camera at ``azimuth`` and ``elevation`` (degrees), ``distance`` from the origin and looking at it.

    ``size`` is width, height; ``focal`` is in pixels, None is 120 for each 64 of the longer side.
    """
    width, height = size
    focal = CANONICAL_FOCAL_AT_64 * max(size) / 64.0 if focal is None else focal
    sin_a, cos_a = np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))
    sin_e, cos_e = np.sin(np.radians(elevation)), np.cos(np.radians(elevation))
    right = [cos_a, 0.0, -sin_a]
    down = [sin_e * sin_a, -cos_e, sin_e * cos_a]
    forward = [-cos_e * sin_a, -sin_e, -cos_e * cos_a]
    K = np.array([[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]])
    return Camera(K, np.array([right, down, forward]), np.array([0.0, 0.0, distance]), width, height)


def fitting_distance(vertices: Array, camera: Camera, margin: float = MARGIN_PX) -> float:
    """Smallest distance, 2 or more, at which ``vertices`` [V, 3] lie inside the picture of ``camera`` less ``margin`` px.

    Exact: with x, z the coordinates of a vertex in the camera's axes, |fx x| / (z + d) <= W/2 - margin holds from
    d = |fx x| / (W/2 - margin) - z on; the same for y, and the largest over the vertices is taken.
    """
    half = np.array([camera.width, camera.height]) / 2.0
    half -= np.minimum(margin, half / 4.0)
    turned = vertices @ camera.R.T
    needed = np.abs(turned[:, :2]) * camera.K[[0, 1], [0, 1]] / half - turned[:, 2:]
    # The last term keeps every vertex in front of the camera, also those on its axis.
    return float(max(CANONICAL_DISTANCE, needed.max(), 0.01 - turned[:, 2].min()))


def sample_cameras(settings: RenderSettings, vertices: Array, rng: np.random.Generator) -> list[Camera]:
    """Cameras on random directions around the normalised ``vertices`` [V, 3], as ``settings`` says.

    Raises InputError if a fixed distance puts the camera inside the object.
    """
    cameras = []
    for _ in range(settings.views):
        azimuth = rng.uniform(*settings.azimuth)
        elevation = rng.uniform(*settings.elevation)
        camera = look_at(azimuth, elevation, settings.distance or CANONICAL_DISTANCE, settings.size, settings.focal)
        if settings.distance is None:
            distance = fitting_distance(vertices, camera)
            camera = look_at(azimuth, elevation, distance, settings.size, settings.focal)
        elif camera.t[2] + (vertices @ camera.R[2]).min() <= 0.0:
            raise InputError(
                f"distance is {settings.distance:g}: the camera would stand inside the object, "
                "which reaches up to 0.87 from its centre; expected 1 or more"
            )
        cameras.append(camera)
    return cameras
