"""The shipped examples, judged by the truth: each is of a type that its start is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.view import View
from tso_cli.io.cameras import read_camera
from tso_cli.io.clouds import read_cloud
from tso_cli.io.images import read_mask
from tso_cli.refinement import RefineConfig, refine, refine_batch

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = pytest.mark.parametrize("name", ["chair", "airplane", "car"])


def _example(name: str):
    folder = EXAMPLES / name
    mask = read_mask(folder / "mask.png")
    camera = read_camera(folder / "camera.json", mask.shape[1], mask.shape[0])
    return read_cloud(folder / "initial.ply").points, mask, camera, read_cloud(folder / "target.ply").points


@NAMES
def test_the_default_takes_more_off_the_error_than_the_paper_and_its_mirror_plane_more_still(name):
    points, mask, camera, target = _example(name)
    before = chamfer(points, target).chamfer
    paper, alone, best = (
        chamfer(refine(points, mask, camera, config).points, target).chamfer / before
        for config in (RefineConfig(preset="paper"), RefineConfig(symmetry="none"), RefineConfig())
    )
    assert best < alone - 0.1 < paper - 0.15
    assert best < 0.6


@NAMES
def test_every_other_point_of_the_truth_comes_no_further_from_the_rest(name):
    _, mask, camera, target = _example(name)
    start, rest = target[::2], target[1::2]
    moved = refine(start, mask, camera).points
    assert chamfer(moved, rest).chamfer < 1.01 * chamfer(start, rest).chamfer
    # and where the start is right, little is asked of it
    assert np.square(moved - start).sum(1).mean() < chamfer(start, rest).chamfer


def test_a_start_whose_silhouette_would_agree_less_with_the_mask_is_returned_as_it_was():
    _, mask, camera, target = _example("chair")
    start, small, half = target[::2], mask[::2, ::2], camera.resized(128, 128)
    result = refine(start, small, half)
    assert result.stop_reason == "not_improved"
    assert "agrees better" in result.warnings[0]
    np.testing.assert_array_equal(result.points, start)
    assert (result.best_step, result.iou_after, result.moved_max) == (0, result.iou_before, 0.0)
    assert (result.loss_after, result.chamfer_to_initial) == (result.loss_before, 0.0)
    # and in a batch nothing of that reaches its neighbours
    initial = _example("chair")[0][: len(start)]
    alone, other = refine_batch([(start, View(small, half)), (initial, View(small, half))])
    np.testing.assert_array_equal(alone.points, start)
    assert other.moved_mean > 0.01
