"""Meshes: samples of a surface move in place of its vertices, and the vertices follow."""

from __future__ import annotations

import warnings
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.points import CANDIDATES, as_triangles, draw_surface, spread_subset
from ..optimisation.presets import FIELD_NODES
from .smooth_field import INTERPOLATED_FROM, falling_weights

Array = NDArray[np.float64]

# Their displacements are corrected by a dense linear system.
MOST_SAMPLES = 4096
# Weight of changing a sample's displacement, beside that of the faces moving the sample elsewhere.
RIDGE = 0.1


class Surface:
    """A triangle mesh and some points of it, 1,024 at first, spread by farthest-point sampling among many drawn by area.

    The same mesh gives the same samples, however it is cut into faces.

    Attributes
    ----------
    vertices : [V, 3]; those of no face are no part of the surface.
    samples : [S, 3], in the unit of the vertices.
    """

    partial = True

    def __init__(self, vertices: Array, triangles: NDArray[np.int64]) -> None:
        """Raises InputError where the triangles [F, 3] have no area."""
        drawn, shares = draw_surface(vertices, triangles, CANDIDATES, np.random.default_rng(0))
        self.vertices = vertices
        self._corners = triangles[drawn]
        self._shares = np.concatenate([1.0 - shares.sum(1, keepdims=True), shares], axis=1)
        self._move(FIELD_NODES)

    def _move(self, count: int) -> None:
        self._chosen = spread_subset(self.judged(self.vertices), count)
        self.samples = self.at(self.vertices)

    def with_samples(self, most: int | None) -> Surface:
        """The same mesh with ``most`` samples, at most 4,096; None keeps their number. Itself if the number stays."""
        count = min(most or len(self.samples), MOST_SAMPLES)
        if count == len(self.samples):
            return self
        changed = copy(self)
        changed._move(count)
        return changed

    @classmethod
    def of(cls, vertices: Array, faces: Any, name: str) -> Surface | None:
        """The surface of a mesh; None, with a warning, where its faces have no area or join under half of its vertices.

        Raises InputError where ``faces`` are not whole numbers [F, 3] that index ``vertices`` [V, 3].
        """
        triangles = as_triangles(faces, len(vertices), name)
        joined = len(np.unique(triangles))
        reason = f"the faces join {joined:,} of {len(vertices):,} vertices, which are therefore taken for a cloud"
        try:
            surface = cls(vertices, triangles)
            if 2 * joined >= len(vertices):
                return surface
        except InputError:
            reason = "the faces have no area, the vertices are taken for a cloud"
        warnings.warn(f"{name}: {reason}", stacklevel=2)
        return None

    def at(self, values: Array) -> Array:
        """[S, C], values [V, C] of the vertices interpolated linearly at the samples."""
        return _interpolated(values, self._corners[self._chosen], self._shares[self._chosen])

    def judged(self, values: Array) -> Array:
        """[J, C], the same at all points drawn by area, of which the samples are a subset: the surface as it is judged."""
        return _interpolated(values, self._corners, self._shares)

    def followed(self, displacements: Array) -> Array:
        """Displacements [V, 3] of the vertices from those of the samples, [S, 3].

        Each vertex takes the weighted mean of the samples nearest to it, as points of a large cloud do.
        At an edge or a tip a mean lags behind, and large faces spread that: so the samples' displacements are first
        changed a little, by regularised linear least squares, until the flat faces carry the samples where they should go.

        Only its position decides how a vertex moves: duplicates, as along texture seams, stay together.
        """
        from scipy.spatial import cKDTree

        distance, nearest = cKDTree(self.samples).query(self.vertices, INTERPOLATED_FROM)
        weights = falling_weights(distance)
        count = len(displacements)
        # [S, S]: how far the faces carry each sample, per displacement of every sample.
        carried = np.zeros((count, count))
        rows, corners = np.arange(count)[:, None, None], self._corners[self._chosen]
        np.add.at(
            carried,
            (rows, nearest[corners]),
            self._shares[self._chosen][..., None] * weights[corners],
        )
        normal = carried.T @ carried + RIDGE * np.eye(count)
        corrected = displacements + np.linalg.solve(
            normal, carried.T @ (displacements - carried @ displacements)
        )
        of_vertices: Array = (weights[..., None] * corrected[nearest]).sum(1)
        return of_vertices


def _interpolated(values: Array, corners: NDArray[np.int64], shares: Array) -> Array:
    interpolated: Array = np.einsum("sk,skc->sc", shares, values[corners])
    return interpolated
