"""Sparse points hide no mirror plane, and few of them are control points. They still take part."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.scenes import example
from tso_cli.cloud.outliers import (
    LARGEST_SPARSE_SHARE,
    _to_fourth,
    find_sparse,
    spread_over_surfaces,
)
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.points import sample_surface, spread_subset
from tso_cli.io.clouds import read_cloud
from tso_cli.io.meshes import read_mesh
from tso_cli.io.shipped import example_meshes, examples_folder
from tso_cli.optimisation.symmetry import find_mirror_plane
from tso_cli.refinement import refine

NAMES = pytest.mark.parametrize("name", ["airplane", "car", "chair"])
MESHES = pytest.mark.parametrize("path", example_meshes()[::4], ids=lambda path: path.stem)


def in_cube(points, share, rng):
    middle, side = (points.min(0) + points.max(0)) / 2.0, np.ptp(points, axis=0).max()
    return middle + side * rng.uniform(-0.5, 0.5, (int(share * len(points)), 3))


def in_box(points, share, rng):
    return rng.uniform(points.min(0), points.max(0), (int(share * len(points)), 3))


def with_noise(points, share, seed=0, noise=in_cube):
    return np.vstack([points, noise(points, share, np.random.default_rng(seed))])


def surface(path, count, seed=0):
    mesh = read_mesh(path)
    return sample_surface(mesh.vertices, mesh.faces, count, np.random.default_rng(seed))


def merged(points, density, noise, seed=0):
    """Two scans, of which one is sparse: the points, and which are of the sparse one."""
    rng = np.random.default_rng(seed)
    sparse = points[:, 0] > np.median(points[:, 0])
    kept = ~sparse | (rng.random(len(points)) < density)
    side = np.ptp(points, axis=0).max()
    return points[kept] + noise * side * rng.normal(size=(kept.sum(), 3)), sparse[kept]


@NAMES
@pytest.mark.parametrize(
    ("noise", "share"),
    [(in_cube, 0.02), (in_cube, 0.05), (in_cube, 0.2), (in_box, 0.02), (in_box, 0.05)],
)
def test_sparse_points_hide_no_mirror_plane(name, share, noise):
    points = example(name).points
    assert find_mirror_plane(points).symmetric
    found = [find_mirror_plane(with_noise(points, share, seed, noise)) for seed in range(5)]
    assert sum(plane.symmetric for plane in found) >= 4


@pytest.mark.parametrize("name", ["car", "chair"])
def test_a_cloud_with_sparse_points_comes_about_as_near_to_the_truth(name):
    scene, count = example(name), len(example(name).points)
    given_points = with_noise(scene.points, 0.05)
    alone, with_sparse = (
        refine(points, scene.view).points[:count] for points in (scene.points, given_points)
    )
    assert chamfer(with_sparse, scene.target).chamfer < 1.25 * chamfer(alone, scene.target).chamfer


@MESHES
def test_few_sparse_points_are_control_points_of_a_large_cloud(path):
    """Farthest-point sampling alone would choose them first."""
    points = surface(path, 8192)
    for share in (0.05, 0.2):
        chosen = spread_over_surfaces(with_noise(points, share), 1024)
        assert len(set(chosen)) == 1024
        sparse = (chosen >= len(points)).mean()
        of_even = (spread_subset(with_noise(points, share), 1024) >= len(points)).mean()
        assert sparse < max(LARGEST_SPARSE_SHARE, 1.3 * share) < of_even


@MESHES
@pytest.mark.parametrize("noise", [0.0, 0.005, 0.01])
def test_a_sparse_scan_next_to_a_dense_one_has_many_control_points(path, noise):
    """It might be noise, so it has fewer control points than an even spread would give it."""
    points, sparse = merged(surface(path, 16_384), 0.05, noise)
    even = sparse[spread_subset(points, 1024)].mean()
    assert sparse[spread_over_surfaces(points, 1024)].mean() > min(2.0 * sparse.mean(), 0.8 * even)


def test_evenly_spread_points_lie_nowhere_apart():
    for path in examples_folder().glob("*/*.ply"):
        assert not find_sparse(np.asarray(read_cloud(path).points, dtype=np.float64)).any()


@NAMES
def test_of_an_even_cloud_the_samples_are_those_of_farthest_point_sampling(name):
    points = example(name).points
    np.testing.assert_array_equal(spread_over_surfaces(points, 512), spread_subset(points, 512))


@MESHES
@pytest.mark.parametrize("width", [256, 1024])
def test_sparse_points_of_a_scan_kept_row_by_row_are_found(path, width):
    """Points at equal steps would all be of a few columns."""
    points = surface(path, 48 * width)
    rows = points[np.lexsort((points[:, 0], np.arange(len(points)) // width))]
    rng = np.random.default_rng(0)
    column = rng.permutation(width)[: width // 20]
    noise = (np.arange(48)[:, None] * width + column).ravel()
    rows[noise] = in_cube(points, 1.0, rng)[: len(noise)]
    found = find_sparse(rows)
    assert found[noise].mean() > 0.6
    assert np.delete(found, noise).mean() < 0.1


def test_which_points_are_sparse_depends_on_neither_order_nor_repetition():
    points = with_noise(example("chair").points, 0.05)
    order = np.random.default_rng(0).permutation(len(points))
    found = find_sparse(points)
    assert found.any()
    np.testing.assert_array_equal(find_sparse(points[order]), found[order])
    np.testing.assert_array_equal(find_sparse(np.repeat(points, 3, axis=0)), np.repeat(found, 3))


def test_two_sparse_points_are_too_few():
    points = example("chair").points
    assert not find_sparse(with_noise(points, 2.5 / len(points))).any()


def test_a_point_is_not_its_own_neighbour():
    places = np.arange(10.0)[:, None] * np.array([1.0, 0.0, 0.0])
    queries = np.array([[3.0, 0.0, 0.0], [3.4, 0.0, 0.0]])
    np.testing.assert_allclose(_to_fourth(queries, places), [2.0, 1.6])


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-1.0, 1.0, width=32)] * 3), min_size=1, max_size=60),
    st.floats(0.01, 100.0),
)
def test_which_points_are_sparse_does_not_depend_on_the_unit_and_never_all_are(rows, scale):
    points, scale = np.array(rows), np.exp2(np.round(np.log2(scale)))
    found = find_sparse(points)
    np.testing.assert_array_equal(find_sparse(scale * points), found)
    assert not found.all()
