"""Meshes: samples of a surface move in place of its vertices, and the vertices follow."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.points import CANDIDATES, as_triangles, draw_surface, spread_subset
from .smooth_field import INTERPOLATED_FROM, falling_weights

Array = NDArray[np.float64]

# As many as the smooth fields have nodes; twice and four times as many come no nearer to the truth, on larger masks neither.
SAMPLES = 1024
# What it costs to change a sample's way, in units of what it costs that the faces bring the sample elsewhere.
HELD = 0.1


class Surface:
    """A triangle mesh and 1,024 points of it, spread evenly by farthest-point sampling among many drawn by area.

    The same mesh gives the same samples. How a surface is cut into faces, and how densely its vertices lie, hardly matters.

    Attributes
    ----------
    vertices : [V, 3]; those that no face has are no part of the surface.
    samples : [S, 3], in the unit of the vertices.
    """

    def __init__(self, vertices: Array, triangles: NDArray[np.int64]) -> None:
        """Raises InputError where the triangles [F, 3] have no area."""
        drawn, shares = draw_surface(vertices, triangles, CANDIDATES, np.random.default_rng(0))
        self.vertices = vertices
        self._corners = triangles[drawn]
        self._shares = np.concatenate([1.0 - shares.sum(1, keepdims=True), shares], axis=1)
        self._chosen = spread_subset(self.drawn(vertices), SAMPLES)
        self.samples = self.at(vertices)

    @classmethod
    def of(cls, vertices: Array, faces: Any, name: str) -> Surface | None:
        """The surface of a mesh; None, with a warning, where its faces have no area or join under half of its vertices.

        Raises InputError where ``faces`` are not whole numbers [F, 3] that index ``vertices`` [V, 3].
        """
        triangles = as_triangles(faces, len(vertices), name)
        joined = len(np.unique(triangles))
        try:
            found = cls(vertices, triangles)
        except InputError:
            warnings.warn(f"{name}: the faces have no area, the vertices are taken for a cloud", stacklevel=2)
            return None
        if 2 * joined >= len(vertices):
            return found
        told = f"{name}: the faces join {joined:,} of {len(vertices):,} vertices, which are therefore taken for a cloud"
        warnings.warn(told, stacklevel=2)
        return None

    def at(self, values: Array) -> Array:
        """What the samples have, [S, C], of values [V, C] that the vertices have and that are linear on every face."""
        return _mixed(values, self._corners[self._chosen], self._shares[self._chosen])

    def drawn(self, values: Array) -> Array:
        """The same of all points that were drawn by area, of which the samples are some: the surface as it is judged."""
        return _mixed(values, self._corners, self._shares)

    def followed(self, ways: Array) -> Array:
        """How far the vertices go, [V, 3], with samples that go ``ways`` [S, 3].

        Each takes the weighted mean of the samples nearest to it, as the points of a large cloud do of its nodes. A vertex at
        an edge or a tip would lag behind with a mean, and large faces carry that far: the samples' ways are therefore changed
        a little, by linear least squares, so that the faces, which stay flat, bring the samples to where they go.

        The place of a vertex alone counts: vertices in one place, as along the seams of a texture, stay in one place.
        """
        from scipy.spatial import cKDTree

        distance, nearest = cKDTree(self.samples).query(self.vertices, INTERPOLATED_FROM)
        weights = falling_weights(torch.from_numpy(distance)).numpy()
        count = len(ways)
        # [S, S], what the faces bring of the way of each sample to every other.
        taken = np.zeros((count, count))
        rows, corners = np.arange(count)[:, None, None], self._corners[self._chosen]
        np.add.at(taken, (rows, nearest[corners]), self._shares[self._chosen][..., None] * weights[corners])
        normal = taken.T @ taken + HELD * np.eye(count)
        ways = ways + np.linalg.solve(normal, taken.T @ (ways - taken @ ways))
        found: Array = (weights[..., None] * ways[nearest]).sum(1)
        return found


def _mixed(values: Array, corners: NDArray[np.int64], shares: Array) -> Array:
    found: Array = np.einsum("sk,skc->sc", shares, values[corners])
    return found
