"""Removing surface that nobody can see, as models made by hand lack it."""

from __future__ import annotations

import numpy as np

from ...io.meshes import Mesh
from .parts import Array

FINE = 0.15
"""Longest edge of the triangles that are kept or removed as a whole, in the unit of the parts."""


def without_hidden(parts: list[Mesh]) -> list[Mesh]:
    """The parts cut into small triangles, without those that lie inside another part that is convex."""
    planes = [_planes(part) for part in parts]
    boxes = [(part.vertices.min(axis=0), part.vertices.max(axis=0)) for part in parts]
    seen = []
    for own, part in enumerate(parts):
        others = [boxes[k] for k, plane in enumerate(planes) if k != own and plane is not None]
        fine = _divided(part, others)
        middle = fine.vertices[fine.faces].mean(axis=1)
        inside = np.zeros(len(middle), dtype=bool)
        for other, plane in enumerate(planes):
            if other != own and plane is not None:
                inside |= (middle @ plane[:, :3].T - plane[:, 3]).max(axis=1) < -1e-4
        if not inside.all():
            seen.append(Mesh(fine.vertices, fine.faces[~inside]))
    return seen


def _planes(part: Mesh) -> Array | None:
    """Normals and distances [F, 4] of the faces of a convex part; None for any other."""
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    normal = normal[length > 1e-10] / length[length > 1e-10, None]
    distance = (normal * a[length > 1e-10]).sum(axis=1)
    convex = (part.vertices @ normal.T - distance).max() < 1e-3
    return np.column_stack([normal, distance]) if convex else None


def _divided(part: Mesh, boxes: list[tuple[Array, Array]]) -> Mesh:
    """The same surface; triangles that reach into a box (its low and high corner) have edges of at most `FINE`."""
    corners = part.vertices[part.faces]
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    pieces = []
    steps = np.maximum(np.ceil(edge / FINE).astype(int), 1)
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = [((low < b) & (high > a)).all(axis=1) for a, b in boxes]
    steps = np.where(np.any(near, axis=0), steps, 1) if near else np.ones_like(steps)
    for n in np.unique(steps):
        i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        up, down = i + j < n, i + j < n - 1
        first, second = np.stack([i, j], 1)[up], np.stack([i, j], 1)[down]
        cells = np.concatenate([first[:, None] + [[0, 0], [1, 0], [0, 1]], second[:, None] + [[1, 0], [1, 1], [0, 1]]]) / n
        a, b, c = (corners[steps == n, k][:, None, None] for k in range(3))
        pieces.append((a + cells[None, ..., :1] * (b - a) + cells[None, ..., 1:] * (c - a)).reshape(-1, 3))
    vertices = np.concatenate(pieces)
    # Corners that several triangles share become one again.
    _, kept, faces = np.unique(np.round(vertices, 7) @ [1.0, np.e, np.pi], return_index=True, return_inverse=True)
    return Mesh(vertices[kept], faces.reshape(-1, 3).astype(np.int64))
