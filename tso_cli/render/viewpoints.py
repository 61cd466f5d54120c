"""Render settings and camera placement."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..geometry.camera import CANONICAL_DISTANCE, CANONICAL_FOCAL_AT_64, Camera
from ..geometry.points import Array

MARGIN_PX = 2.0
"""Border around the object in pictures of `fitting_distance`."""


@dataclass(frozen=True)
class RenderSettings:
    """What to render of every mesh. Raises InputError for impossible values.

    views : pictures of each object. size : width, height in pixels.
    azimuth, elevation : range in degrees from which each view is drawn uniformly.
    samples : points drawn from the surface; points : how many of them farthest-point sampling keeps.
    copies : warped copies of each mesh rendered beside it. paint : give each connected part a random colour.
    """

    views: int = 24
    size: tuple[int, int] = (64, 64)
    azimuth: tuple[float, float] = (0.0, 360.0)
    elevation: tuple[float, float] = (-5.0, 40.0)
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
            raise InputError(
                f"size is {self.size[0]}x{self.size[1]}, expected 8 to 8192 pixels each way"
            )
        for name, limit in (("azimuth", 360.0), ("elevation", 90.0)):
            low, high = getattr(self, name)
            if not -limit <= low <= high <= limit:
                raise InputError(
                    f"{name} is {low:g} to {high:g}, expected a range within -{limit:g} to {limit:g} degrees"
                )
        if not 1 <= self.points <= self.samples:
            raise InputError(
                f"points is {self.points} and samples {self.samples}, expected 1 <= points <= samples"
            )


def look_at(
    azimuth: float,
    elevation: float,
    distance: float,
    size: tuple[int, int],
    focal: float | None = None,
) -> Camera:
    """The camera at ``azimuth`` and ``elevation`` (degrees) and ``distance`` that looks at the origin.

    ``size`` is width, height; ``focal`` is in pixels, None for 120 for each 64 of the longer side.
    """
    width, height = size
    focal = CANONICAL_FOCAL_AT_64 * max(size) / 64.0 if focal is None else focal
    sin_a, cos_a = np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))
    sin_e, cos_e = np.sin(np.radians(elevation)), np.cos(np.radians(elevation))
    right = [cos_a, 0.0, -sin_a]
    down = [sin_e * sin_a, -cos_e, sin_e * cos_a]
    forward = [-cos_e * sin_a, -sin_e, -cos_e * cos_a]
    K = np.array(
        [[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]]
    )
    return Camera(
        K, np.array([right, down, forward]), np.array([0.0, 0.0, distance]), width, height
    )


def fitting_distance(vertices: Array, camera: Camera, margin: float = MARGIN_PX) -> float:
    """Smallest distance, 2 or more, at which ``vertices`` [V, 3] lie inside the picture of ``camera`` less ``margin`` px.

    With x, z the coordinates of a vertex in the camera's axes, |fx x| / (z + d) <= W/2 - margin from
    d = |fx x| / (W/2 - margin) - z on; the same for y.
    """
    half = np.array([camera.width, camera.height]) / 2.0
    half -= np.minimum(margin, half / 4.0)
    rotated = vertices @ camera.R.T
    distances = np.abs(rotated[:, :2]) * camera.K[[0, 1], [0, 1]] / half - rotated[:, 2:]
    # The last term keeps vertices on the optical axis in front of the camera.
    return float(max(CANONICAL_DISTANCE, distances.max(), 0.01 - rotated[:, 2].min()))


def sample_cameras(
    settings: RenderSettings, vertices: Array, rng: np.random.Generator
) -> list[Camera]:
    """Cameras in random directions that see all of the normalised ``vertices`` [V, 3]."""
    cameras = []
    for _ in range(settings.views):
        azimuth, elevation = rng.uniform(*settings.azimuth), rng.uniform(*settings.elevation)
        camera = look_at(azimuth, elevation, CANONICAL_DISTANCE, settings.size)
        cameras.append(replace(camera, t=np.array([0.0, 0.0, fitting_distance(vertices, camera)])))
    return cameras
