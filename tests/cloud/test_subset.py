"""Large clouds: 1,024 control points move by themselves, and all other points follow."""

import numpy as np

from tso_cli import RefineConfig, refine
from tso_cli.cloud.control_points import CONTROL_POINTS
from tso_cli.cloud.subset import Subset


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


def test_of_a_large_cloud_1024_points_move_and_the_others_follow_their_neighbours(chair):
    dense = _denser(chair.points)
    result = refine(dense, chair.view)
    assert result.control_points == CONTROL_POINTS
    assert len(result.points) == len(dense)
    assert chair.error(result.points) < 0.7 * chair.error(dense)
    moved = result.points - dense
    near = np.square(dense[2000] - dense).sum(1).argsort()[1:4]
    assert np.linalg.norm(moved[near] - moved[2000], axis=1).max() < 0.02


def test_control_points_move_as_given_and_others_between_them_and_outliers_not_at_all():
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (300, 3))
    kept = np.arange(300) != 7
    subset = Subset(points, kept, 100)
    displacements = np.random.default_rng(1).normal(size=(100, 3))
    of_all = subset.follow(displacements)
    np.testing.assert_array_equal(subset.at_control_points(of_all), displacements)
    assert not of_all[7].any()
    assert (of_all.min(0) >= displacements.min(0)).all()
    assert (of_all.max(0) <= displacements.max(0)).all()
    np.testing.assert_allclose(subset.follow(np.ones((100, 3)))[kept], 1.0)


def test_a_large_cloud_that_fits_its_mask_stays_although_its_control_points_leave_gaps(chair):
    dense = _denser(chair.target)
    result = refine(dense, chair.view)
    assert result.fit.stop_reason in ("fits", "not_improved")
    np.testing.assert_array_equal(result.points, dense)


def test_with_the_preset_paper_every_point_moves_by_itself(chair):
    dense = _denser(chair.points)
    result = refine(dense, chair.view, config=RefineConfig(preset="paper", steps=2))
    assert result.control_points == len(dense)


def test_an_outlier_of_a_large_cloud_stays(chair):
    dense = np.concatenate([_denser(chair.points), [[9.0, 9.0, 9.0]]])
    result = refine(dense, chair.view)
    assert result.outliers.sum() == 1
    np.testing.assert_array_equal(result.points[-1], [9.0, 9.0, 9.0])
