"""Outliers, points far from the rest: they stay, are reported, and change nothing else."""

from pathlib import Path

import hypothesis
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.scenes import example
from tso_cli import Camera, View
from tso_cli.cloud.cloud import Cloud
from tso_cli.cloud.outliers import are_part_of_object, find_outliers
from tso_cli.diagnosis.findings import Finding
from tso_cli.io.clouds import read_cloud
from tso_cli.io.shipped import examples_folder
from tso_cli.refinement import RefineConfig, refine

NAMES = pytest.mark.parametrize("name", ["airplane", "car", "chair"])
CONFIG = RefineConfig(steps=6)


@NAMES
@pytest.mark.parametrize("sizes", [2.0, 10.0, 1000.0])
def test_an_outlier_at_any_distance_changes_no_bit_of_the_other_points(name, sizes):
    scene = example(name)
    outlier = scene.points.mean(0) + sizes * np.ptp(scene.points, axis=0).max() * np.array(
        [0.6, 0.64, 0.48]
    )
    place = len(scene.points) // 2
    alone = refine(scene.points, scene.view, config=CONFIG)
    with_outlier = refine(
        np.insert(scene.points, place, outlier, axis=0), scene.view, config=CONFIG
    )
    np.testing.assert_array_equal(np.delete(with_outlier.points, place, axis=0), alone.points)
    np.testing.assert_array_equal(with_outlier.points[place], outlier)
    np.testing.assert_array_equal(with_outlier.measured, [scene.points, alone.points])
    assert with_outlier.fit == alone.fit
    assert with_outlier.outliers.sum() == 1
    assert not alone.outliers.any()
    assert with_outlier.findings[-1] == Finding("outliers", values={"count": 1})


@NAMES
def test_a_fifth_of_outliers_changes_the_other_points_by_under_three_percent(name):
    scene, rng = example(name), np.random.default_rng(0)
    size, count = np.ptp(scene.points, axis=0).max(), len(scene.points)
    noise = scene.points.mean(0) + size * rng.uniform(-2.5, 2.5, (count // 5, 3))
    alone, with_outlier = (
        refine(points, scene.view) for points in (scene.points, np.vstack([scene.points, noise]))
    )
    assert with_outlier.outliers.sum() > 0.95 * len(noise)
    held = np.linalg.norm(with_outlier.points[count:] - noise, axis=1) == 0.0
    np.testing.assert_array_equal(held, with_outlier.outliers[count:])
    assert np.linalg.norm(with_outlier.points[:count] - alone.points, axis=1).mean() < 0.03 * size


def test_no_point_of_the_examples_is_an_outlier():
    for path in Path(examples_folder()).glob("*/*.ply"):
        assert not find_outliers(np.asarray(read_cloud(path).points, dtype=np.float64)).any()


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-1.0, 1.0, width=32)] * 3), min_size=1, max_size=60),
    st.floats(0.01, 100.0),
)
@hypothesis.example([(0, 0, 1), (0, 0, -1), (0, 1, 0.25), (0, -1, 0), (1, 0, 0)], 1.0)
def test_outliers_do_not_depend_on_the_unit_and_are_a_quarter_at_most(rows, scale):
    points = np.array(rows)
    found = find_outliers(points)
    np.testing.assert_array_equal(find_outliers(np.exp2(np.round(np.log2(scale))) * points), found)
    assert 4 * found.sum() <= len(points)


def test_control_points_keep_their_colours_and_outliers_have_none():
    points = np.vstack([np.random.default_rng(0).random((100, 3)), [[50.0, 0.0, 0.0]]])
    colours = np.linspace(0.0, 1.0, 303).reshape(101, 3)
    cloud = Cloud(points, "points", colours).controlled()
    assert cloud.outliers.tolist() == [False] * 100 + [True]
    np.testing.assert_allclose(cloud.colours, colours[:100], atol=1e-6)


def test_points_in_one_place_far_away_are_outliers():
    invalid = np.tile([[3.0, 0.0, 0.0]], (40, 1))
    assert find_outliers(np.vstack([example("chair").points, invalid])).sum() == 40


def test_more_than_a_quarter_of_a_cloud_is_never_outliers():
    core, rest = (np.random.default_rng(0).normal(size=(count, 3)) for count in (600, 240))
    assert not find_outliers(np.vstack([1e-3 * core, rest])).any()


@NAMES
@pytest.mark.parametrize("count", [20, 200])
@pytest.mark.parametrize("sizes", [4.0, 10.0])
def test_a_distant_group_of_outliers_changes_no_bit_of_the_other_points(name, count, sizes):
    scene, rng = example(name), np.random.default_rng(0)
    size = np.ptp(scene.points, axis=0).max()
    clump = scene.points.mean(0) + size * (
        sizes * np.array([0.6, 0.64, 0.48]) + 0.02 * rng.normal(size=(count, 3))
    )
    alone = refine(scene.points, scene.view, config=CONFIG)
    with_outlier = refine(np.vstack([scene.points, clump]), scene.view, config=CONFIG)
    assert with_outlier.outliers.sum() == count
    np.testing.assert_array_equal(with_outlier.points, np.vstack([alone.points, clump]))


def test_a_distant_group_that_the_mask_shows_is_a_part_of_the_object():
    """A floor lamp: shade and foot, without the pole, which the scan has missed."""
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
    shown = View(np.float32(mask), camera)
    shade_alone = View(np.float32(np.where(rows > 63, False, mask)), camera)
    cloud = Cloud(lamp, "points")
    assert cloud.outliers.sum() == len(foot)
    assert not cloud.controlled(views=[shown]).outliers.any()
    assert cloud.controlled(views=[shade_alone]).outliers.sum() == len(foot)
    assert are_part_of_object(foot, len(lamp), [shown])
    assert not are_part_of_object(foot, len(lamp), [shown, shade_alone])
    # Under a twentieth of the points: a mask would hardly show them.
    assert not are_part_of_object(foot[:40], len(lamp), [shown])
