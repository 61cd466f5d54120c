"""Large clouds: 1,024 of their points move, and all others follow."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tso_cli import RefineConfig, refine
from tso_cli.cloud.subset import Subset
from tso_cli.evaluation.metrics import chamfer
from tso_cli.io.clouds import read_cloud
from tso_cli.optimisation.presets import FIELD_NODES
from tso_cli.scene.load import load_points_scene

CHAIR = Path(__file__).parents[2] / "examples" / "chair"


@pytest.fixture(scope="module")
def scene():
    return load_points_scene(CHAIR / "initial.ply", CHAIR / "mask.png")


def _denser(points, times=6):
    """Points between each one and its neighbours."""
    rng = np.random.default_rng(0)
    squared = np.square(points[:, None] - points).sum(2)
    near = np.argsort(squared, 1)[:, 1:times]
    between = [
        points + rng.uniform(0.2, 0.5, (len(points), 1)) * (points[column] - points)
        for column in near.T
    ]
    return np.concatenate([points, *between])


def test_of_a_large_cloud_1024_points_move_and_the_others_stay_beside_them(scene):
    dense = _denser(scene.points)
    result = refine(dense, scene.view)
    assert (result.moving, len(result.points)) == (FIELD_NODES, len(dense))
    target = read_cloud(CHAIR / "target.ply").points
    assert chamfer(result.points, target).chamfer < 0.7 * chamfer(dense, target).chamfer
    moved = result.points - dense
    near = np.square(dense[2000] - dense).sum(1).argsort()[1:4]
    assert np.linalg.norm(moved[near] - moved[2000], axis=1).max() < 0.02


def test_the_samples_move_as_told_others_between_them_and_outliers_not_at_all():
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (300, 3))
    kept = np.arange(300) != 7
    subset = Subset(points, kept, 100)
    displacements = np.random.default_rng(1).normal(size=(100, 3))
    of_all = subset.followed(displacements)
    np.testing.assert_array_equal(subset.at(of_all), displacements)
    assert not of_all[7].any()
    assert (of_all.min(0) >= displacements.min(0)).all()
    assert (of_all.max(0) <= displacements.max(0)).all()
    np.testing.assert_allclose(subset.followed(np.ones((100, 3)))[kept], 1.0)


def test_a_cloud_that_shows_the_mask_already_stays_though_fewer_points_would_leave_gaps(scene):
    dense = _denser(read_cloud(CHAIR / "target.ply").points)
    result = refine(dense, scene.view)
    assert result.stop_reason in ("not_improved", "nothing_to_do")
    np.testing.assert_array_equal(result.points, dense)


def test_with_the_preset_of_the_paper_every_point_moves_by_itself(scene):
    dense = _denser(scene.points)
    assert refine(dense, scene.view, config=RefineConfig(preset="paper", steps=2)).moving == len(
        dense
    )


def test_stray_points_of_a_large_cloud_stay(scene):
    dense = np.concatenate([_denser(scene.points), [[9.0, 9.0, 9.0]]])
    result = refine(dense, replace(scene.view))
    assert result.outliers.sum() == 1
    np.testing.assert_array_equal(result.points[-1], [9.0, 9.0, 9.0])
