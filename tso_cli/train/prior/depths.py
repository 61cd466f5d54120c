"""Depth maps of meshes in the axes of a view, by ray casting."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...geometry.arrays import Array, Floats
from ...io.meshes import Mesh
from ...render.rays import RayScene
from .masks import HALF_SIDE, SCENE_GRID

# Rays start in front of the object, whose longest side is 1.
NEAREST = -1.0


def depth_of(
    vertices: Floats, faces: NDArray[np.int32], rotation: Array, closeness: float
) -> Floats:
    """z of the visible surface at the centres of cells, [SCENE_GRID, SCENE_GRID]; NaN for none.

    A point (x, y, z) in the axes of the view is seen at w = (x, y) / (1 + u z), see `masks.seen`:
    the ray of w is (w (1 + u z), z).
    """
    scene = RayScene(Mesh(vertices.astype(float) @ rotation.T, faces.astype(np.int64)))
    centres = (np.arange(SCENE_GRID) + 0.5) * (2.0 * HALF_SIDE / SCENE_GRID) - HALF_SIDE
    w = np.stack(np.meshgrid(centres, centres), -1).reshape(-1, 2)
    start = np.column_stack([w * (1.0 + closeness * NEAREST), np.full(len(w), NEAREST)])
    along = np.column_stack([w * closeness, np.ones(len(w))])
    depth = NEAREST + scene.first(start, along)
    return np.where(np.isfinite(depth), depth, np.nan).reshape(SCENE_GRID, -1).astype(np.float32)
