"""Control points of a mesh: samples of its surface move, and the vertices follow."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..evaluation.footprint import Solid
from ..geometry.arrays import Array, Bits, Indices
from ..geometry.points import CANDIDATES, as_triangles, draw_surface, spread_subset
from ..io.paint import Paint
from ..losses.nearest import nearest_few
from .interpolation import INTERPOLATED_FROM, falling_weights

MOST_CONTROL_POINTS = 4096
# Weight of changing a control point's displacement. The weight of the distance between the control
# point and where the faces carry it is 1.
RIDGE = 0.1
# The displacements of control points are corrected by a linear system, up to this relative error.
# It takes about 20 steps. Vertices are then within 2e-5 longest sides of the exact solution.
SOLVED, MOST_SOLVER_STEPS = 1e-4, 500


class Surface:
    """A triangle mesh and many points of it, drawn by area.

    The same mesh gives the same points, however it is cut into faces. Vertices of no face are not
    part of the surface.
    """

    def __init__(self, vertices: Array, triangles: Indices) -> None:
        """Raises InputError where the triangles [F, 3] have no area."""
        drawn, shares = draw_surface(vertices, triangles, CANDIDATES, np.random.default_rng(0))
        self.vertices, self.triangles = vertices, triangles
        self.faces, self.corners = drawn, triangles[drawn]
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

    def without(self, left_out: Bits) -> tuple[Surface, Bits]:
        """The surface without faces all of whose vertices are ``left_out`` [V].

        And [V], the vertices that only such faces join. The surface stays if nothing would be left.
        """
        whole = ~left_out[self.triangles].all(1)
        if whole.all() or not whole.any():
            return self, np.zeros(len(left_out), bool)
        part = Surface(self.vertices, self.triangles[whole])
        part.faces = np.flatnonzero(whole)[part.faces]
        left_out = np.zeros(len(left_out), bool)
        left_out[self.triangles[~whole]] = True
        left_out[self.triangles[whole]] = False
        return part, left_out

    def at(self, values: Array, rows: Indices | slice = slice(None)) -> Array:
        """[S, C], ``values`` [V, C] of the vertices interpolated at the ``rows`` points."""
        interpolated: Array = np.einsum("sk,skc->sc", self.shares[rows], values[self.corners[rows]])
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

    def painted(self, paint: Paint) -> Array:
        """[S, 3], the colours of a ``paint`` at the control points."""
        surface, rows = self._surface, self._chosen
        return paint.at(surface.faces[rows], surface.shares[rows])

    def measured(self, values: Array) -> Array:
        """[M, C], the same at all points drawn by area: the surface as it is measured."""
        return self._surface.at(values)

    def solid(self, values: Array) -> Solid:
        """The triangles with their vertices at ``values`` [V, 3]."""
        joined, faces = np.unique(self._surface.triangles, return_inverse=True)
        return Solid(values[joined], faces.reshape(-1, 3))

    def follow(self, displacements: Array) -> Array:
        """Displacements [V, 3] of the vertices by those of the control points [S, 3].

        A vertex takes the weighted mean of its nearest control points, as a point of a large cloud
        does. At an edge or a tip a mean lags behind, and large faces spread the lag. So the
        displacements of the control points are first changed a little, by regularised linear least
        squares, until the flat faces carry the control points where they should go.

        Only its position decides how a vertex moves: duplicates, as along texture seams, stay
        together.
        """
        surface, count = self._surface, len(displacements)
        if not displacements.any():
            return np.zeros_like(surface.vertices)
        places, place = np.unique(surface.vertices, axis=0, return_inverse=True)
        place = place.ravel()
        near = nearest_few(places, self.control_points, min(INTERPOLATED_FROM, count))
        distance = np.sqrt(np.square(places[:, None] - self.control_points[near]).sum(2))
        weights = falling_weights(distance)
        corners, shares = place[surface.corners[self._chosen]], surface.shares[self._chosen]
        # How far the faces carry each control point: ``weight`` [S, K] of the displacements ``of``.
        of = near[corners].reshape(count, -1)
        weight = (shares[..., None] * weights[corners]).reshape(count, -1)
        lag = displacements - _carried(weight, of, displacements)
        corrected = displacements + _least_squares(weight, of, lag)
        of_places: Array = np.einsum("nk,nkc->nc", weights, corrected[near])
        return of_places[place]


def _carried(weight: Array, of: Indices, values: Array) -> Array:
    """[S, C], the product of a sparse matrix with ``weight`` in the columns ``of`` [S, K]."""
    carried: Array = np.einsum("sk,skc->sc", weight, values[of])
    return carried


def _least_squares(weight: Array, of: Indices, right: Array) -> Array:
    """The ``x`` that minimises ``|A x - right|^2 + RIDGE |x|^2``, for the matrix of `_carried`.

    By conjugate gradients: the ridge makes the system so well conditioned that a few dozen steps
    do, in a fraction of the time of a dense solution.
    """
    flat = of.ravel()

    def transposed(values: Array) -> Array:
        return np.stack(
            [
                np.bincount(flat, (weight * column[:, None]).ravel(), len(right))
                for column in values.T
            ],
            1,
        )

    residual = transposed(right)
    x, direction = np.zeros_like(residual), residual.copy()
    before = first = float(np.square(residual).sum())
    for _ in range(MOST_SOLVER_STEPS):
        if before <= SOLVED**2 * first:
            break
        product = transposed(_carried(weight, of, direction)) + RIDGE * direction
        step = before / float((direction * product).sum())
        x += step * direction
        residual -= step * product
        now = float(np.square(residual).sum())
        direction = residual + now / before * direction
        before = now
    return x
