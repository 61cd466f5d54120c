"""Control points of a mesh: samples of its surface move, and the vertices follow."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array, Indices
from ..geometry.points import CANDIDATES, as_triangles, draw_surface, spread_subset
from .smooth_field import INTERPOLATED_FROM, falling_weights

# The displacements of control points are corrected by a dense linear system of this size.
MOST_CONTROL_POINTS = 4096
# Weight of changing a control point's displacement. The weight of the distance between the control
# point and where the faces carry it is 1.
RIDGE = 0.1


class Surface:
    """A triangle mesh and many points of it, drawn by area.

    The same mesh gives the same points, however it is cut into faces. Vertices of no face are not
    part of the surface.
    """

    def __init__(self, vertices: Array, triangles: Indices) -> None:
        """Raises InputError where the triangles [F, 3] have no area."""
        drawn, shares = draw_surface(vertices, triangles, CANDIDATES, np.random.default_rng(0))
        self.vertices = vertices
        self.corners = triangles[drawn]
        self.shares = np.concatenate([1.0 - shares.sum(1, keepdims=True), shares], axis=1)

    @classmethod
    def of(cls, vertices: Array, faces: Any, name: str) -> tuple[Surface | None, str]:
        """The surface of a mesh; or None, and why the vertices are taken for a cloud.

        That is where the faces have no area or join less than half of the vertices. Raises
        InputError where ``faces`` are not whole numbers [F, 3] that index ``vertices`` [V, 3].
        """
        triangles = as_triangles(faces, len(vertices), name)
        joined = len(np.unique(triangles))
        if 2 * joined < len(vertices):
            return None, f"the faces join {joined:,} of {len(vertices):,} vertices"
        try:
            return cls(vertices, triangles), ""
        except InputError:
            return None, "the faces have no area"

    def at(self, values: Array, chosen: Indices | slice = slice(None)) -> Array:
        """[S, C], ``values`` [V, C] of the vertices interpolated at the ``chosen`` points."""
        interpolated: Array = np.einsum(
            "sk,skc->sc", self.shares[chosen], values[self.corners[chosen]]
        )
        return interpolated


class SurfaceSamples:
    """At most ``most`` points of a surface that move by themselves, by farthest-point sampling.

    Attributes
    ----------
    control_points : [S, 3], in the unit of the vertices.
    """

    partial = True

    def __init__(self, surface: Surface, most: int) -> None:
        self._surface = surface
        points = surface.at(surface.vertices)
        self._chosen = spread_subset(points, min(most, MOST_CONTROL_POINTS))
        self.control_points = self.at_control_points(surface.vertices)

    def at_control_points(self, values: Array) -> Array:
        """[S, C], ``values`` [V, C] of the vertices interpolated at the control points."""
        return self._surface.at(values, self._chosen)

    def measured(self, values: Array) -> Array:
        """[M, C], the same at all points drawn by area: the surface as it is measured."""
        return self._surface.at(values)

    def follow(self, displacements: Array) -> Array:
        """Displacements [V, 3] of the vertices by those of the control points [S, 3].

        A vertex takes the weighted mean of its nearest control points, as a point of a large cloud
        does. At an edge or a tip a mean lags behind, and large faces spread the lag. So the
        displacements of the control points are first changed a little, by regularised linear least
        squares, until the flat faces carry the control points where they should go.

        Only its position decides how a vertex moves: duplicates, as along texture seams, stay
        together.
        """
        from scipy.spatial import cKDTree

        surface = self._surface
        distance, nearest = cKDTree(self.control_points).query(surface.vertices, INTERPOLATED_FROM)
        weights = falling_weights(distance)
        count = len(displacements)
        # [S, S]: how far the faces carry each control point, by the displacement of every one.
        carried = np.zeros((count, count))
        rows = np.arange(count)[:, None, None]
        corners, shares = surface.corners[self._chosen], surface.shares[self._chosen]
        np.add.at(carried, (rows, nearest[corners]), shares[..., None] * weights[corners])
        normal = carried.T @ carried + RIDGE * np.eye(count)
        lag = displacements - carried @ displacements
        corrected = displacements + np.linalg.solve(normal, carried.T @ lag)
        of_vertices: Array = (weights[..., None] * corrected[nearest]).sum(1)
        return of_vertices
