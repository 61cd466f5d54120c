"""Polygons of meshes are the same surface in triangles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tso_cli.geometry.polygons import triangulated
from tso_cli.geometry.rotations import from_vectors

L = [
    (0.5, -0.3, 0),
    (-0.3, -0.3, 0),
    (-0.3, 0.5, 0),
    (-0.5, 0.5, 0),
    (-0.5, -0.5, 0),
    (0.5, -0.5, 0),
]


def area(points, triangles):
    a, b, c = np.asarray(points)[triangles].transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def star(radii):
    """A polygon whose corners are seen from the origin one after another."""
    angles = 2 * np.pi * np.arange(len(radii)) / len(radii)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles), 0 * angles], 1)


@settings(deadline=None)
@given(
    st.lists(st.floats(0.2, 1.0), min_size=5, max_size=12),
    st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3),
    st.booleans(),
)
def test_the_triangles_of_a_concave_polygon_cover_it_once_and_look_the_same_way(
    radii, turn, backward
):
    points = star(np.array(radii)) @ from_vectors(np.array([turn]))[0].T
    points = points[::-1] if backward else points
    count = len(points)
    triangles = triangulated(points, np.arange(count), np.array([count]))
    x, y = star(np.array(radii))[:, :2].T
    exact = abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
    assert area(points, triangles) == pytest.approx(exact)
    a, b, c = points[triangles].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    assert (normals @ normals.sum(0) > -1e-12).all()


def test_convex_polygons_are_fans_and_keep_their_order():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    points = np.concatenate([square, np.array(L), square[:3] + 2.0])
    places = triangulated(points, np.arange(13), np.array([4, 6, 3]))
    assert places[:2].tolist() == [[0, 1, 2], [0, 2, 3]]
    assert places[-1].tolist() == [10, 11, 12]
    assert area(points, places[2:6]) == pytest.approx(0.36)
