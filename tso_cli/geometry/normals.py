"""Normals of a surface that was deformed."""

from __future__ import annotations

import numpy as np

from .arrays import Array, Indices
from .rotations import from_vectors


def turned_normals(
    normals: Array, of_corners: Indices, faces: Indices, before: Array, after: Array
) -> Array:
    """``normals`` [K, 3] after the vertices moved from ``before`` to ``after`` [V, 3].

    Each normal is turned as the faces around it turn, so that smooth parts stay smooth and hard
    edges stay hard.

    Parameters
    ----------
    of_corners : [F, 3], the normal of each corner of the ``faces`` [F, 3].
    """
    means = []
    for vertices in (before, after):
        origin, first, second = vertices[faces].transpose(1, 0, 2)
        area = np.cross(first - origin, second - origin)  # [F, 3]
        total = np.zeros_like(normals)
        for corner in range(3):
            np.add.at(total, of_corners[:, corner], area)
        means.append(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300))
    axis = np.cross(*means)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, (means[0] * means[1]).sum(1))
    vectors = axis * (angle / np.maximum(sine, 1e-300))[:, None]
    turned: Array = np.einsum("kij,kj->ki", from_vectors(vectors), normals)
    return turned


def rigid_turn(before: Array, after: Array) -> Array | None:
    """The rotation [3, 3] of a motion that only turns, shifts and scales all vertices alike.

    It is fitted to the vertices ``before`` and ``after`` [V, 3] (Kabsch). None if a vertex is
    further from it than a millionth of the size, or if the vertices lie on a line.
    """
    old, new = before - before.mean(0), after - after.mean(0)
    left, sizes, right = np.linalg.svd(old.T @ new)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    if not sizes[1] > 1e-9 * sizes[0] > 0.0:
        return None
    turn: Array = (right.T * signs) @ left.T
    scale = (sizes * signs).sum() / (old**2).sum()
    gap = np.abs(scale * old @ turn.T - new).max()
    if gap > 1e-6 * np.abs(new).max():
        return None
    # Rounding alone is no turn: what only shifts keeps its normals bit for bit.
    return np.eye(3) if np.abs(turn - np.eye(3)).max() < 1e-9 else turn


def same_places(values: Array) -> Indices:
    """[V], the number of the distinct row that each row of ``values`` [V, C] is."""
    _, index = np.unique(values, axis=0, return_inverse=True)
    return index.reshape(-1).astype(np.int64)
