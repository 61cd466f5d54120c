"""Render settings and camera placement."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array
from ..geometry.camera import CANONICAL_DISTANCE, Camera

MARGIN_PX = 2.0  # the border around the object in pictures of `fitting_distance`


@dataclass(frozen=True)
class RenderSettings:
    """What to render of every mesh. Raises InputError for impossible values.

    views : number of pictures of each object.
    size : width and height of the pictures in pixels.
    azimuth, elevation : range in degrees; each view draws uniformly from it.
    samples : number of points to draw from the surface.
    points : number of these points that farthest-point sampling keeps.
    copies : number of warped copies of each mesh that are rendered too.
    paint : give each connected part a random colour.
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
                    f"{name} is {low:g} to {high:g}, "
                    f"expected a range within -{limit:g} to {limit:g} degrees"
                )
        if not 1 <= self.points <= self.samples:
            raise InputError(
                f"points is {self.points} and samples {self.samples}, "
                "expected 1 <= points <= samples"
            )


def look_at(azimuth: float, elevation: float, distance: float, size: tuple[int, int]) -> Camera:
    """The camera that looks at the origin from ``azimuth``, ``elevation`` (degrees), ``distance``.

    ``size`` is width, height. The focal length is the canonical camera's.
    """
    sin_a, cos_a = np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))
    sin_e, cos_e = np.sin(np.radians(elevation)), np.cos(np.radians(elevation))
    right = [cos_a, 0.0, -sin_a]
    down = [sin_e * sin_a, -cos_e, sin_e * cos_a]
    forward = [-cos_e * sin_a, -sin_e, -cos_e * cos_a]
    R = np.array([right, down, forward])
    return replace(Camera.canonical(*size), R=R, t=np.array([0.0, 0.0, distance]))


def fitting_distance(
    vertices: Array,
    camera: Camera,
    margin: float = MARGIN_PX,
    least: float = CANONICAL_DISTANCE,
) -> float:
    """The distance of ``camera`` from the origin at which ``vertices`` [V, 3] fit into its picture.

    It is the smallest distance d, at least ``least``, that leaves ``margin`` pixels on every side.
    With x, z the coordinates of a vertex in the camera's axes, |fx x| / (z + d) <= W/2 - margin
    holds for d >= |fx x| / (W/2 - margin) - z, and likewise for y.
    """
    half = np.array([camera.width, camera.height]) / 2.0
    half -= np.minimum(margin, half / 4.0)
    rotated = vertices @ camera.R.T
    distances = np.abs(rotated[:, :2]) * camera.K[[0, 1], [0, 1]] / half - rotated[:, 2:]
    # The last term keeps vertices on the optical axis in front of the camera, by a hundredth of the
    # mesh's longest side.
    return float(max(least, distances.max(), 0.01 - rotated[:, 2].min()))


def sample_cameras(
    settings: RenderSettings, vertices: Array, rng: np.random.Generator
) -> list[Camera]:
    """Cameras in random directions that see all ``vertices`` [V, 3] of a normalised mesh."""
    cameras = []
    for _ in range(settings.views):
        azimuth, elevation = rng.uniform(*settings.azimuth), rng.uniform(*settings.elevation)
        camera = look_at(azimuth, elevation, CANONICAL_DISTANCE, settings.size)
        cameras.append(replace(camera, t=np.array([0.0, 0.0, fitting_distance(vertices, camera)])))
    return cameras
