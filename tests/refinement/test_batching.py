"""Batches of clouds: their bounds, progress and interrupts."""

from __future__ import annotations

import numpy as np
import pytest

from tso_cli.errors import InputError
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.view import View
from tso_cli.refinement import RefineConfig, api, refine, refine_batch, run
from tso_cli.refinement.cloud import Cloud
from tso_cli.refinement.problem import Problem

RANDOM = np.random.default_rng(0)
POINTS = RANDOM.uniform(-0.3, 0.3, (40, 3))


def _view(left: int = 25, side: int = 64) -> View:
    mask = np.zeros((side, side), np.float32)
    mask[side // 3 : side // 2, left : left + side // 4] = 1.0
    return View(mask, Camera.canonical(side, side))


def _problems(*sizes: int, views: int = 1) -> dict[int, Problem]:
    config = RefineConfig(symmetry="none").settings()
    return {
        number: Problem.of(Cloud(RANDOM.uniform(-0.3, 0.3, (size, 3)), "points"), (_view(),) * views, config)
        for number, size in enumerate(sizes)
    }


def test_batches_have_bounded_points_and_cloud_sizes_within_a_factor_of_two(monkeypatch):
    assert api.batches_of(_problems(20, 40, 19, 40)) == [[1, 3, 0], [2]]
    monkeypatch.setattr(api, "BATCH_POINTS", 100)
    # Every row is padded to the largest.
    assert api.batches_of(_problems(30, 40, 30, 40, 30)) == [[1, 3], [0, 2, 4]]
    # A cloud over the bound is a batch by itself.
    assert api.batches_of(_problems(200, 150)) == [[0], [1]]


def test_batches_have_bounded_cells_and_smooth_fields(monkeypatch):
    assert len(api.batches_of(_problems(*[100] * 10), staged=True)) == 1
    monkeypatch.setattr(api, "BATCH_FIELDS", 4)
    assert [len(batch) for batch in api.batches_of(_problems(*[100] * 10), staged=True)] == [4, 4, 2]
    assert len(api.batches_of(_problems(*[100] * 10))) == 1
    monkeypatch.setattr(api, "BATCH_CELLS", 5 * 64 * 64)
    assert [len(batch) for batch in api.batches_of(_problems(*[30] * 7))] == [5, 2]
    assert [len(batch) for batch in api.batches_of(_problems(*[30] * 5, views=2))] == [2, 2, 1]
    assert [len(batch) for batch in api.batches_of(_problems(30, 30, views=6))] == [1, 1]


def test_progress_counts_over_all_batches_and_seconds_are_per_cloud(monkeypatch):
    monkeypatch.setattr(api, "BATCH_POINTS", 80)
    ticks = iter(range(10_000))
    monkeypatch.setattr(run.time, "perf_counter", lambda: float(next(ticks)))
    reported = []
    results = refine_batch(
        [(POINTS, _view())] * 3, RefineConfig(steps=2), progress=lambda step, steps, loss: reported.append((step, steps))
    )
    assert reported == [(1, 4), (2, 4), (3, 4), (4, 4)]
    # A phase lasts one tick, "prepare" is entered twice, and two clouds share the first batch.
    assert [result.seconds["optimise"] for result in results] == [0.5, 0.5, 1.0]
    assert [result.seconds["prepare"] for result in results] == [1.0, 1.0, 2.0]


def test_after_an_interrupt_clouds_have_their_best_iterate_or_their_start(monkeypatch):
    monkeypatch.setattr(api, "BATCH_POINTS", 80)
    reported = []

    def interrupt(step, steps, loss):
        reported.append(step)
        if step == 13:
            raise KeyboardInterrupt

    config = RefineConfig(steps=10)
    results = refine_batch([(POINTS, _view())] * 5 + [(POINTS * np.nan, _view())], config, progress=interrupt)
    assert max(reported) == 13
    assert [getattr(result, "stop_reason", "error") for result in results] == [
        "max_steps", "max_steps", "interrupted", "interrupted", "interrupted", "error",
    ]  # fmt: skip
    assert [result.steps for result in results[:5]] == [10, 10, 3, 3, 0]
    assert results[2].loss_after < results[2].loss_before
    np.testing.assert_array_equal(results[4].points, POINTS)
    assert results[4].iou_after == refine(POINTS, _view(), config=RefineConfig(steps=0)).iou_before


def test_a_scene_that_is_no_pair_is_an_error_of_its_own():
    good, *bad = refine_batch([(POINTS, _view()), (POINTS,), None, POINTS], RefineConfig(steps=1))
    assert good.steps == 1
    for number, (error, scene) in enumerate(zip(bad, ("tuple of 1", "None", "ndarray of 40"), strict=True), 1):
        assert isinstance(error, InputError)
        assert str(error) == f"scene {number} is {scene}, expected (points, views)"
    with pytest.raises(InputError, match="scenes is None, expected a sequence"):
        refine_batch(None)
