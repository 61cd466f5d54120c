"""Points that belong to no surface: reported, and of no influence on the rest; those far away are held."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.scenes import example
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.points import sample_surface
from tso_cli.io.clouds import read_cloud
from tso_cli.io.meshes import read_mesh
from tso_cli.io.shipped import example_meshes, examples_folder
from tso_cli.refinement import RefineConfig, refine
from tso_cli.refinement import cloud as cloud_module
from tso_cli.refinement.cloud import Cloud
from tso_cli.refinement.outliers import _to_others, loose_points, outliers

NAMES = pytest.mark.parametrize("name", ["airplane", "car", "chair"])
CONFIG = RefineConfig(steps=6)


@NAMES
@pytest.mark.parametrize("sizes", [2.0, 10.0, 1000.0])
def test_a_stray_point_at_any_distance_changes_no_bit_of_the_others(name, sizes):
    scene = example(name)
    stray = scene.points.mean(0) + sizes * np.ptp(scene.points, axis=0).max() * np.array([0.6, 0.64, 0.48])
    place = len(scene.points) // 2
    alone = refine(scene.points, scene.view, config=CONFIG)
    beside = refine(np.insert(scene.points, place, stray, axis=0), scene.view, config=CONFIG)
    np.testing.assert_array_equal(np.delete(beside.points, place, axis=0), alone.points)
    np.testing.assert_array_equal(beside.points[place], stray)
    np.testing.assert_array_equal(beside.judged, [scene.points, alone.points])
    assert (beside.iou_before, beside.iou_after, beside.moved_mean) == (alone.iou_before, alone.iou_after, alone.moved_mean)
    assert (beside.outliers.sum(), alone.outliers.sum()) == (1, 0)
    assert "1 point lies far from all others: left where found, and out of all measures" in beside.warnings


@NAMES
def test_a_fifth_of_outliers_far_and_wide_changes_the_others_by_under_two_percent(name):
    scene, rng = example(name), np.random.default_rng(0)
    size, count = np.ptp(scene.points, axis=0).max(), len(scene.points)
    noise = scene.points.mean(0) + size * rng.uniform(-2.5, 2.5, (count // 5, 3))
    alone, beside = (refine(points, scene.view) for points in (scene.points, np.vstack([scene.points, noise])))
    assert beside.outliers.sum() > 0.95 * len(noise)
    held = np.linalg.norm(beside.points[count:] - noise, axis=1) == 0.0
    np.testing.assert_array_equal(held, beside.outliers[count:])
    assert np.linalg.norm(beside.points[:count] - alone.points, axis=1).mean() < 0.02 * size


def with_loose(points, share=0.05, seed=0):
    """The points [N, 3], and so many among them, anywhere in a cube as wide as their longest side."""
    rng = np.random.default_rng(seed)
    middle, side = (points.min(0) + points.max(0)) / 2.0, np.ptp(points, axis=0).max()
    return np.vstack([points, middle + side * rng.uniform(-0.5, 0.5, (int(share * len(points)), 3))])


@pytest.mark.parametrize("name", ["car", "chair"])
def test_loose_points_around_an_object_do_not_hide_its_mirror_plane(name, monkeypatch):
    scene, count = example(name), len(example(name).points)
    alone, beside = (refine(points, scene.view) for points in (scene.points, with_loose(scene.points)))
    assert alone.symmetry_outcome == beside.symmetry_outcome == "used"
    assert beside.loose[count:].mean() > 0.6 and beside.loose[:count].mean() < 0.05
    found = int(beside.loose.sum())
    assert f"{found} points lie off the surfaces of the others: only carried along, and out of all measures" in beside.warnings
    ratio = [chamfer(points[:count], scene.target).chamfer for points in (beside.points, alone.points)]
    assert ratio[0] < 1.1 * ratio[1]
    monkeypatch.setattr(cloud_module, "loose_points", lambda points: np.zeros(len(points), bool))
    assert refine(with_loose(scene.points), scene.view, config=CONFIG).symmetry_outcome == "none_found"


def test_loose_points_follow_and_no_measure_is_of_them():
    scene = example("chair")
    result = refine(with_loose(scene.points), scene.view, config=CONFIG)
    assert (result.points[result.loose] != result.initial[result.loose]).any(1).all()
    assert len(result.judged[0]) == len(result.points) - result.loose.sum()


def test_loose_points_are_not_most_of_the_points_that_move():
    """An evenly spread subset takes those first that lie apart."""
    scene = example("chair")
    dense = np.vstack([scene.points + 0.004 * np.random.default_rng(i).normal(size=scene.points.shape) for i in range(6)])
    given_points = with_loose(dense, 0.1)
    cloud = Cloud(given_points, "points")
    true = {tuple(point) for point in dense}
    assert np.mean([tuple(point) in true for point in cloud.initial]) > 0.9


def test_no_point_of_the_examples_is_an_outlier_or_loose():
    for path in Path(examples_folder()).glob("*/*.ply"):
        points = np.asarray(read_cloud(path).points, dtype=np.float64)
        assert not outliers(points).any() and not loose_points(points).any()


@NAMES
@pytest.mark.parametrize("times", [20.0, 100.0])
def test_points_of_the_sparse_end_of_an_unevenly_sampled_cloud_are_not_loose(name, times):
    """By their shares: few of them are as far from others as strays are."""
    points, rng = example(name).points, np.random.default_rng(0)
    density = times ** ((points[:, 0] - points[:, 0].min()) / np.ptp(points[:, 0]))
    drawn = points[rng.choice(len(points), len(points), p=density / density.sum())]
    assert not loose_points(drawn + 0.005 * rng.normal(size=points.shape)).any()


MESHES = pytest.mark.parametrize("path", example_meshes(), ids=lambda path: path.stem)


@MESHES
def test_the_sparse_half_of_two_merged_scans_is_a_surface(path):
    """By their dimension alone: a tenth as dense as the other half, its points are as far from their neighbours as strays."""
    mesh, rng = read_mesh(path), np.random.default_rng(0)
    points = sample_surface(mesh.vertices, mesh.faces, 8192, rng)
    sparse = points[:, 0] > np.quantile(points[:, 0], rng.uniform(0.3, 0.7))
    assert not loose_points(points[~sparse | (rng.random(len(points)) < 0.1)]).any()


@MESHES
def test_vertices_of_a_mesh_are_not_loose(path):
    assert not loose_points(np.asarray(read_mesh(path).vertices, dtype=np.float64)).any()


@NAMES
@pytest.mark.parametrize("share", [0.05, 0.2])
def test_most_strays_are_found_wherever_they_lie(name, share):
    points = example(name).points
    found = [loose_points(with_loose(points, share, seed)) for seed in range(10)]
    seen = [loose for loose in found if loose.any()]
    assert len(seen) >= 7
    assert np.mean([loose[len(points) :].mean() for loose in seen]) > 0.6
    assert np.mean([loose[: len(points)].mean() for loose in seen]) < 0.05


def test_which_points_are_loose_depends_on_no_order():
    points = with_loose(example("chair").points)
    order = np.random.default_rng(0).permutation(len(points))
    found = loose_points(points)
    assert found.any()
    np.testing.assert_array_equal(loose_points(points[order]), found[order])


def test_points_given_three_times_are_as_loose_as_once():
    points = with_loose(example("chair").points)
    found = loose_points(points)
    assert found.any()
    np.testing.assert_array_equal(loose_points(np.repeat(points, 3, axis=0)), np.repeat(found, 3))


def test_a_point_is_no_neighbour_of_its_own():
    places = np.arange(10.0)[:, None] * np.array([1.0, 0.0, 0.0])
    queries = np.array([[3.0, 0.0, 0.0], [3.4, 0.0, 0.0]])
    np.testing.assert_allclose(_to_others(queries, places, 3), [[1.0, 1.0, 2.0], [0.4, 0.6, 1.4]])


def test_two_of_many_hundred_points_beside_the_others_are_not_worth_a_word():
    points = example("chair").points
    assert not loose_points(with_loose(points, 2.5 / len(points))).any()


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-1.0, 1.0, width=32)] * 3), min_size=1, max_size=60), st.floats(0.01, 100.0))
def test_outliers_depend_on_no_unit_and_are_a_minority(rows, scale):
    points, scale = np.array(rows), np.exp2(np.round(np.log2(scale)))
    for find in (outliers, loose_points):
        found = find(points)
        np.testing.assert_array_equal(find(scale * points), found)
        assert 4 * found.sum() <= len(points)


def test_colours_follow_the_points_that_move():
    points = np.vstack([np.random.default_rng(0).random((100, 3)), [[50.0, 0.0, 0.0]]])
    colours = np.linspace(0.0, 1.0, 303).reshape(101, 3)
    cloud = Cloud(points, "points", colours)
    assert cloud.outliers.tolist() == [False] * 100 + [True]
    np.testing.assert_allclose(cloud.colours, colours[:100], atol=1e-6)


def test_points_in_one_place_far_away_are_outliers():
    invalid = np.tile([[3.0, 0.0, 0.0]], (40, 1))
    assert outliers(np.vstack([example("chair").points, invalid])).sum() == 40


def test_more_than_a_quarter_of_a_cloud_are_neither_outliers_nor_loose():
    core, rest = (np.random.default_rng(0).normal(size=(count, 3)) for count in (600, 240))
    assert not outliers(np.vstack([1e-3 * core, rest])).any()
    points = example("airplane").points
    assert loose_points(with_loose(points, 0.3)).any() and not loose_points(with_loose(points, 0.45)).any()
