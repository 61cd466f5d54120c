"""Points far from the rest: held, reported, and of no influence on the rest."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.scenes import example
from tso_cli import Camera, View
from tso_cli.cloud.cloud import Cloud, outliers
from tso_cli.io.clouds import read_cloud
from tso_cli.io.shipped import examples_folder
from tso_cli.refinement import RefineConfig, refine

NAMES = pytest.mark.parametrize("name", ["airplane", "car", "chair"])
CONFIG = RefineConfig(steps=6)


@NAMES
@pytest.mark.parametrize("sizes", [2.0, 10.0, 1000.0])
def test_a_stray_point_at_any_distance_changes_no_bit_of_the_others(name, sizes):
    scene = example(name)
    stray = scene.points.mean(0) + sizes * np.ptp(scene.points, axis=0).max() * np.array(
        [0.6, 0.64, 0.48]
    )
    place = len(scene.points) // 2
    alone = refine(scene.points, scene.view, config=CONFIG)
    beside = refine(np.insert(scene.points, place, stray, axis=0), scene.view, config=CONFIG)
    np.testing.assert_array_equal(np.delete(beside.points, place, axis=0), alone.points)
    np.testing.assert_array_equal(beside.points[place], stray)
    np.testing.assert_array_equal(beside.judged, [scene.points, alone.points])
    assert (beside.iou_before, beside.iou_after, beside.moved_mean) == (
        alone.iou_before,
        alone.iou_after,
        alone.moved_mean,
    )
    assert (beside.outliers.sum(), alone.outliers.sum()) == (1, 0)
    assert (
        "1 point lies far from the rest: left where found, and out of all measures"
        in beside.warnings
    )


@NAMES
def test_a_fifth_of_outliers_far_and_wide_changes_the_others_by_under_two_percent(name):
    scene, rng = example(name), np.random.default_rng(0)
    size, count = np.ptp(scene.points, axis=0).max(), len(scene.points)
    noise = scene.points.mean(0) + size * rng.uniform(-2.5, 2.5, (count // 5, 3))
    alone, beside = (
        refine(points, scene.view) for points in (scene.points, np.vstack([scene.points, noise]))
    )
    assert beside.outliers.sum() > 0.95 * len(noise)
    held = np.linalg.norm(beside.points[count:] - noise, axis=1) == 0.0
    np.testing.assert_array_equal(held, beside.outliers[count:])
    assert np.linalg.norm(beside.points[:count] - alone.points, axis=1).mean() < 0.02 * size


def test_no_point_of_the_examples_is_an_outlier():
    for path in Path(examples_folder()).glob("*/*.ply"):
        assert not outliers(np.asarray(read_cloud(path).points, dtype=np.float64)).any()


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-1.0, 1.0, width=32)] * 3), min_size=1, max_size=60),
    st.floats(0.01, 100.0),
)
def test_outliers_depend_on_neither_unit_nor_origin_and_are_a_minority(rows, scale):
    points = np.array(rows)
    found = outliers(points)
    np.testing.assert_array_equal(outliers(np.exp2(np.round(np.log2(scale))) * points), found)
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


def test_more_than_a_quarter_of_a_cloud_are_no_outliers():
    core, rest = (np.random.default_rng(0).normal(size=(count, 3)) for count in (600, 240))
    assert not outliers(np.vstack([1e-3 * core, rest])).any()


@NAMES
@pytest.mark.parametrize("count", [20, 200])
@pytest.mark.parametrize("sizes", [4.0, 10.0])
def test_a_far_clump_of_strays_changes_no_bit_of_the_others(name, count, sizes):
    scene, rng = example(name), np.random.default_rng(0)
    size = np.ptp(scene.points, axis=0).max()
    clump = scene.points.mean(0) + size * (
        sizes * np.array([0.6, 0.64, 0.48]) + 0.02 * rng.normal(size=(count, 3))
    )
    alone = refine(scene.points, scene.view, config=CONFIG)
    beside = refine(np.vstack([scene.points, clump]), scene.view, config=CONFIG)
    assert beside.outliers.sum() == count
    np.testing.assert_array_equal(beside.points, np.vstack([alone.points, clump]))


def test_a_far_group_that_the_mask_shows_is_a_part_of_the_object():
    """A floor lamp: shade and foot, whose pole the scan has missed."""
    rng = np.random.default_rng(0)
    shade, foot = (
        rng.normal(size=(count, 3)) * [0.1, 0.04, 0.1] + [0, y, 3.0]
        for count, y in ((800, -0.7), (180, 0.7))
    )
    lamp = np.vstack([shade, foot])
    K = np.array([[60.0, 0, 63.5], [0, 60.0, 63.5], [0, 0, 1]])
    camera = Camera(K, np.eye(3), np.zeros(3), 128, 128)
    rows, columns = np.indices((128, 128))
    mask = (np.hypot((columns - 63.5) / 6.0, (rows - 49.5) / 3.0) < 1) | (
        np.hypot((columns - 63.5) / 6.0, (rows - 77.5) / 3.0) < 1
    )
    assert outliers(lamp).sum() == len(foot)
    assert not refine(lamp, View(np.float32(mask), camera), config=CONFIG).outliers.any()
    without = np.where(rows > 63, False, mask)
    assert refine(lamp, View(np.float32(without), camera), config=CONFIG).outliers.sum() == len(
        foot
    )
