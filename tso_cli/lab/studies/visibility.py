"""Which points of a surface a camera sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...geometry.camera import Camera
from ...geometry.points import Array
from ...render import RayScene

TOLERANCE = 2e-3
"""How far behind the first hit along its ray a point may lie and still be seen, in longest sides."""
# Rays are cast through a grid of columns and rows, of which only the diagonal is wanted.
POINTS_AT_ONCE = 32


def visible_points(scene: RayScene, points: Array, camera: Camera) -> NDArray[np.bool_]:
    """For each of ``points`` [N, 3] on the surface of ``scene`` whether the perspective ``camera`` sees it.

    A point is seen when the first hit along its ray is no more than `TOLERANCE` before it, or when its ray, which grazes an
    edge, hits nothing at all.
    """
    pixels, depth = camera.project(points)
    rays = (points - camera.position) / depth[:, None]  # of depth 1 in the camera's axes
    hits, faces = np.zeros(len(points), dtype=bool), np.zeros(len(points), dtype=np.int64)
    normals = np.zeros((len(points), 3))
    for start in range(0, len(points), POINTS_AT_ONCE):
        part = slice(start, start + POINTS_AT_ONCE)
        rays_hit = scene.cast(camera, pixels[part, 0], pixels[part, 1])
        diagonal = np.arange(len(pixels[part]))
        hits[part], normals[part] = rays_hit["hit"][diagonal, diagonal], rays_hit["normal"][diagonal, diagonal]
        faces[part] = np.where(hits[part], rays_hit["face"][diagonal, diagonal].astype(np.int64), 0)
    corners = scene.mesh.vertices[scene.mesh.faces[faces, 0]]
    along = (normals * rays).sum(1)
    # Where the plane of the hit face meets the ray; a face seen edge-on hides nothing.
    with np.errstate(divide="ignore", invalid="ignore"):
        first = (normals * (corners - camera.position)).sum(1) / along
    hidden = hits & (np.abs(along) > 1e-9) & (first < depth - TOLERANCE)
    return ~hidden
