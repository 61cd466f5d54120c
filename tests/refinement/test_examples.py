"""Accuracy on the shipped examples, whose true clouds are known."""

import numpy as np
import pytest

from tests.scenes import example
from tso_cli.evaluation.metrics import chamfer
from tso_cli.refinement import RefineConfig, judge, refine, refine_batch

NAMES = pytest.mark.parametrize("name", ["chair", "airplane", "car"])


@pytest.mark.slow
@NAMES
def test_best_reduces_the_error_more_than_paper_and_still_more_with_a_mirror_plane(name):
    shown, configs = (
        example(name),
        (RefineConfig(preset="paper"), RefineConfig(symmetry="none"), RefineConfig()),
    )
    errors = np.array([shown.error(refine(*shown[:3], config).points) for config in configs])
    paper, alone, best = errors / shown.error(shown.points)
    assert best < alone - 0.05 < paper - 0.1
    assert best < 0.6


@NAMES
def test_a_right_start_stays_right(name):
    _, mask, camera, target = example(name)
    start, rest = target[::2], target[1::2]
    moved = refine(start, mask, camera).points
    assert chamfer(moved, rest).chamfer < 1.01 * chamfer(start, rest).chamfer
    # A right start hardly moves.
    assert np.square(moved - start).sum(1).mean() < chamfer(start, rest).chamfer


@pytest.mark.parametrize(
    ("ious", "reverted"), [((0.9, 0.8), True), ((0.9, 0.95), False), ((0.05, 0.04), False)]
)
def test_where_the_iou_would_fall_the_start_is_returned(chair, monkeypatch, ious, reverted):
    """Unless it hardly touched the mask. In a batch the other clouds are unaffected."""
    points, view = chair.points, chair.view

    def measured(initial, *others):
        return [ious if len(initial) == len(points) else (0.5, 0.6)]

    monkeypatch.setattr(judge, "view_ious", measured)
    result, smaller = refine_batch(
        [(points, view), (points[::2], view)], RefineConfig(steps=6, symmetry="none")
    )
    assert (
        (result.stop_reason == "not_improved")
        == ("agrees better" in str(result.warnings))
        == reverted
    )
    assert smaller.moved_mean > 0.01
    if reverted:
        np.testing.assert_array_equal(result.points, points)
        assert (result.best_step, result.iou_after, result.moved_max) == (0, result.iou_before, 0.0)
        assert (result.loss_after, result.chamfer_to_initial) == (result.loss_before, 0.0)
