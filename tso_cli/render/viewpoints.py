"""Render settings and camera placement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry.arrays import Array
from ..geometry.camera import CANONICAL_DISTANCE, Camera
from .settings import RenderSettings

MARGIN_PX = 2.0  # the border around the object in pictures of `fitting_distance`


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
