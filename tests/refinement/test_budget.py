"""What a refinement spends on its scene: as much as is known to help, all that might, or some seconds."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest

from tests.losses.scenes import points_at
from tests.scenes import block, seen, turned
from tso_cli import Camera, InputError, RefineConfig, View, refine
from tso_cli.optimisation.presets import BEST, FULL_STEPS


def _decided(result) -> dict[str, tuple[str, float]]:
    return {decision.what: (decision.choice, decision.saving) for decision in result.budget}


def test_when_the_seconds_are_over_the_best_so_far_is_kept(chair):
    points, mask, camera, _ = chair
    result = refine(points, mask, camera, RefineConfig(budget=1e-6))
    # One step of each stage, and no check of the mirror plane.
    assert (result.steps, result.stop_reason, result.symmetry_outcome) == (
        3,
        "out_of_time",
        "unchecked",
    )
    assert result.loss_after < result.loss_before
    assert (result.verdict, result.confidence) == (None, None)
    assert "the budget ended after 3 of 48 steps: the result is not judged" in result.warnings
    assert _decided(result)["steps"] == ("3", pytest.approx(1.0 - 3 / (FULL_STEPS * 48)))


def test_the_result_is_there_by_the_end_of_the_seconds(chair):
    points, mask, camera, _ = chair
    for seconds in (1e-6, 1.0):  # at first the compiled loops are imported
        started = time.perf_counter()
        result = refine(points, mask, camera, RefineConfig(budget=seconds, steps=100_000))
    assert result.stop_reason == "out_of_time"
    assert 3 < result.steps < 100_000
    # A busy machine judges the result more slowly.
    assert time.perf_counter() - started < 10.0


def test_with_few_seconds_fewer_points_move_but_for_those_asked_for():
    assert (
        RefineConfig(budget=0.1).settings().points
        == RefineConfig(budget=0.5).settings(2).points
        == 512
    )
    assert (
        RefineConfig(budget=0.5).settings().points
        == RefineConfig(budget="0.1", points=1024).settings().points
        == 1024
    )


def test_a_result_whose_mirror_plane_was_not_checked_is_not_judged(chair, monkeypatch):
    points, mask, camera, _ = chair
    monkeypatch.setattr("tso_cli.optimisation.probe._in_time", lambda probe, end: False)
    result = refine(points, mask, camera, RefineConfig(budget=1e6))
    assert (result.steps, result.symmetry_outcome, result.verdict, result.confidence) == (
        48,
        "unchecked",
        None,
        None,
    )
    assert (
        "the budget left no time for the symmetry check: the result is not judged"
        in result.warnings
    )


def test_ctrl_c_while_the_symmetry_check_is_timed_ends_the_refinement(chair, monkeypatch):
    def interrupted(probe, end):
        raise KeyboardInterrupt

    points, mask, camera, _ = chair
    monkeypatch.setattr("tso_cli.optimisation.probe._in_time", interrupted)
    result = refine(points, mask, camera, RefineConfig(budget=1e6))
    assert (result.stop_reason, result.steps) == ("interrupted", 0)
    np.testing.assert_array_equal(result.points, points)


def test_a_loss_that_is_no_number_is_the_reason_that_the_steps_end(chair):
    points, mask, camera, _ = chair
    result = refine(points, mask, camera, RefineConfig(learning_rate=1e5))
    assert result.stop_reason == "non_finite"
    (steps,) = (decision for decision in result.budget if decision.what == "steps")
    assert (steps.choice, steps.reason) == (f"{result.steps}", "the loss was no number after them")


@pytest.mark.parametrize("seconds", [1e6, "1e6"])
def test_with_more_seconds_than_it_needs_a_result_is_that_without(chair, seconds):
    points, mask, camera, _ = chair
    limited, free = (
        refine(points, mask, camera, RefineConfig(budget=budget)) for budget in (seconds, "auto")
    )
    np.testing.assert_array_equal(limited.points, free.points)
    assert limited.stop_reason == free.stop_reason == "max_steps"


def test_seconds_end_the_paper_s_preset_and_the_correction_of_cameras_too(chair):
    points, mask, camera, _ = chair
    result = refine(
        points, mask, camera, RefineConfig(budget=1e-6, preset="paper", refine_camera=True)
    )
    assert (result.steps, result.stop_reason, result.budget) == (1, "out_of_time", ())


def test_the_full_budget_takes_more_steps_and_the_finest_grid_from_the_first(chair):
    points, mask, camera, _ = chair
    auto, full = (
        refine(points, mask, camera, RefineConfig(budget=budget)) for budget in ("auto", "full")
    )
    assert (auto.steps, full.steps) == (48, 2 * 48)
    assert _decided(full)["steps"] == ("96", 0.0)
    settings = RefineConfig(budget="full").settings()
    assert all(stage.fine_grid for stage in settings.coarse_to_fine.stages)
    with pytest.raises(InputError, match="a coarse_to_fine of its own"):
        RefineConfig(budget="full", coarse_to_fine=replace(BEST, local_prior=False))


def test_several_large_masks_that_the_start_fits_badly_take_twice_the_steps(chair):
    def steps(sides, points=chair.points, **settings):
        cameras = [
            turned(chair.camera.resized(side, side), 50.0 * number)
            for number, side in enumerate(sides)
        ]
        views = [seen(chair.target, camera) for camera in cameras]
        result = refine(points, views, config=RefineConfig(**settings))
        (decision,) = (decision for decision in result.budget if decision.what == "steps")
        return result.steps, decision.reason

    more = (2 * 96, "the start fits 2 large masks badly")
    assert steps([256, 256]) == more
    assert steps([256, 256], symmetry="none") == more
    enough = (96, "96 are enough for 2 masks")
    assert steps([256, 64]) == enough
    assert steps([256, 256], 1.02 * chair.target) == enough
    # So few points cannot follow the finest grid.
    assert steps([256, 256], chair.points[:400]) == enough
    assert steps([256])[0] == 48
    assert steps([256, 256], steps=96) == (96, "so many were asked for")
    assert steps([256, 256], budget="full") == (2 * 96, "the budget is full")


def test_as_many_points_move_by_themselves_as_are_asked_for(chair):
    points, mask, camera, _ = chair
    result = refine(points, mask, camera, RefineConfig(points=200))
    assert result.moving == 200
    assert result.iou_after > result.iou_before
    assert _decided(result)["points"] == ("200 of 1024", pytest.approx(1.0 - 200 / 1024))
    dense = np.concatenate([points, points + 1e-3])
    assert refine(dense, mask, camera, RefineConfig(points=2000, steps=3)).moving == 2000
    # The box of a mesh, whose surface has as many samples.
    corners = np.stack(np.meshgrid(*[[-0.2, 0.2]] * 3, indexing="ij"), -1).reshape(-1, 3)
    faces = [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
    ]
    box = refine(corners, mask, camera, RefineConfig(points=300, steps=3), faces=faces)
    assert box.moving == 300


def test_a_cloud_that_fits_costs_no_step():
    pixels = np.stack(np.meshgrid(*[np.arange(20.0, 29.1, 1 / 3)] * 2), -1).reshape(-1, 2)
    camera = Camera.canonical(64, 64)
    points = points_at(pixels, camera, np.full(len(pixels), 2.0))
    result = refine(
        points,
        View(block(np.s_[20:30, 20:30]), camera),
        config=RefineConfig(budget="full", symmetry="none"),
    )
    assert (result.steps, result.stop_reason) == (0, "nothing_to_do")
    assert _decided(result)["steps"] == ("0", 1.0)


def test_every_decision_has_a_reason_and_a_share_that_it_saved(chair):
    points, mask, camera, _ = chair
    result = refine(points, mask, camera)
    assert [decision.what for decision in result.budget] == [
        "window",
        "cells",
        "points",
        "steps",
        "mirror plane",
    ]
    assert all(decision.reason and 0.0 <= decision.saving <= 1.0 for decision in result.budget)
    assert _decided(result)["mirror plane"] == ("checked, used", 0.0)
    assert (
        0.0
        < _decided(refine(points, mask, camera, RefineConfig(symmetry="none")))["mirror plane"][1]
        < 1.0
    )


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"budget": "most"}, "budget is 'most', expected auto, full or seconds"),
        ({"budget": 0.0}, "budget is 0.0"),
        ({"budget": math.nan}, "budget is nan"),
        ({"budget": True}, "budget is True"),
        ({"budget": "full", "preset": "paper"}, "budget full is for mode points with preset best"),
        ({"points": 100, "mode": "latent"}, "points is for mode points with preset best"),
        ({"points": 3}, "points is 3, expected a whole number from 16 to 16,384"),
        ({"points": True}, "points is True"),
    ],
)
def test_a_budget_that_means_nothing_is_refused(settings, named):
    with pytest.raises(InputError, match=named):
        RefineConfig(**settings)
