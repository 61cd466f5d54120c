"""Accuracy on the shipped examples, whose true clouds are known."""

from __future__ import annotations

import numpy as np
import pytest

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.view import View
from tso_cli.refinement import RefineConfig, refine, refine_batch

from ..scenes import example

NAMES = pytest.mark.parametrize("name", ["chair", "airplane", "car"])


@pytest.mark.slow
@NAMES
def test_best_reduces_the_error_more_than_paper_and_still_more_with_a_mirror_plane(name):
    points, mask, camera, target = example(name)
    before = chamfer(points, target).chamfer
    paper, alone, best = (
        chamfer(refine(points, mask, camera, config).points, target).chamfer / before
        for config in (RefineConfig(preset="paper"), RefineConfig(symmetry="none"), RefineConfig())
    )
    assert best < alone - 0.1 < paper - 0.15
    assert best < 0.6


@NAMES
def test_a_right_start_stays_right(name):
    _, mask, camera, target = example(name)
    start, rest = target[::2], target[1::2]
    moved = refine(start, mask, camera).points
    assert chamfer(moved, rest).chamfer < 1.01 * chamfer(start, rest).chamfer
    # A right start hardly moves.
    assert np.square(moved - start).sum(1).mean() < chamfer(start, rest).chamfer


def test_where_the_iou_would_fall_the_start_is_returned():
    _, mask, camera, target = example("chair")
    start, small, half = target[::2], mask[::2, ::2], camera.resized(128, 128)
    result = refine(start, small, half)
    assert result.stop_reason == "not_improved"
    assert "agrees better" in result.warnings[0]
    np.testing.assert_array_equal(result.points, start)
    assert (result.best_step, result.iou_after, result.moved_max) == (0, result.iou_before, 0.0)
    assert (result.loss_after, result.chamfer_to_initial) == (result.loss_before, 0.0)
    # In a batch the other clouds are unaffected.
    initial = example("chair")[0][: len(start)]
    unmoved, moved = refine_batch([(start, View(small, half)), (initial, View(small, half))])
    np.testing.assert_array_equal(unmoved.points, start)
    assert moved.moved_mean > 0.01
