"""Many clouds at once: which are worked on together, what is told meanwhile, and what an interrupt leaves."""

from __future__ import annotations

import numpy as np
import pytest

from tso_cli.errors import InputError
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.view import View
from tso_cli.refinement import RefineConfig, batching, refine, refine_batch, run
from tso_cli.refinement.cloud import Cloud
from tso_cli.refinement.problem import Problem

RANDOM = np.random.default_rng(0)
POINTS = RANDOM.uniform(-0.3, 0.3, (40, 3))


def _view(left: int = 25, side: int = 64) -> View:
    mask = np.zeros((side, side), np.float32)
    mask[side // 3 : side // 2, left : left + side // 4] = 1.0
    return View(mask, Camera.canonical(side, side))


def _items(*sizes: int, views: int = 1) -> dict[int, Problem]:
    config = RefineConfig(symmetry="none").settings()
    return {
        number: Problem.of(Cloud(RANDOM.uniform(-0.3, 0.3, (size, 3)), "points"), (_view(),) * views, config)
        for number, size in enumerate(sizes)
    }


def test_a_batch_holds_no_more_points_than_its_bound_and_sizes_within_a_factor_of_two(monkeypatch):
    assert batching.batches_of(_items(20, 40, 19, 40)) == [[1, 3, 0], [2]]
    monkeypatch.setattr(batching, "BATCH_POINTS", 100)
    # every row takes the room of the largest
    assert batching.batches_of(_items(30, 40, 30, 40, 30)) == [[1, 3], [0, 2, 4]]
    # one that is too large by itself is worked on all the same
    assert batching.batches_of(_items(200, 150)) == [[0], [1]]


def test_a_batch_holds_no_more_pixels_than_its_bound_over_all_views(monkeypatch):
    assert len(batching.batches_of(_items(*[100] * 10), staged=True)) == 1
    monkeypatch.setattr(batching, "BATCH_FIELDS", 4)
    assert [len(batch) for batch in batching.batches_of(_items(*[100] * 10), staged=True)] == [4, 4, 2]
    assert len(batching.batches_of(_items(*[100] * 10))) == 1
    monkeypatch.setattr(batching, "BATCH_CELLS", 5 * 64 * 64)
    assert [len(batch) for batch in batching.batches_of(_items(*[30] * 7))] == [5, 2]
    assert [len(batch) for batch in batching.batches_of(_items(*[30] * 5, views=2))] == [2, 2, 1]
    assert [len(batch) for batch in batching.batches_of(_items(30, 30, views=6))] == [1, 1]


def test_progress_counts_through_all_batches_and_seconds_are_those_of_one_cloud(monkeypatch):
    monkeypatch.setattr(batching, "BATCH_POINTS", 80)
    ticks = iter(range(10_000))
    monkeypatch.setattr(run.time, "perf_counter", lambda: float(next(ticks)))
    told = []
    results = refine_batch(
        [(POINTS, _view())] * 3, RefineConfig(steps=2), progress=lambda step, steps, loss: told.append((step, steps))
    )
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    # each phase lasts one tick of the clock, "prepare" is entered twice; two clouds share the first batch
    assert [result.seconds["optimise"] for result in results] == [0.5, 0.5, 1.0]
    assert [result.seconds["prepare"] for result in results] == [1.0, 1.0, 2.0]


def test_an_interrupt_keeps_what_was_reached_and_leaves_the_rest_at_its_start(monkeypatch):
    monkeypatch.setattr(batching, "BATCH_POINTS", 80)
    steps_told = []

    def interrupt(step, steps, loss):
        steps_told.append(step)
        if step == 13:
            raise KeyboardInterrupt

    config = RefineConfig(steps=10)
    results = refine_batch([(POINTS, _view())] * 5 + [(POINTS * np.nan, _view())], config, progress=interrupt)
    assert max(steps_told) == 13
    assert [getattr(result, "stop_reason", "error") for result in results] == [
        "max_steps", "max_steps", "interrupted", "interrupted", "interrupted", "error",
    ]  # fmt: skip
    assert [result.steps for result in results[:5]] == [10, 10, 3, 3, 0]
    assert results[2].loss_after < results[2].loss_before
    np.testing.assert_array_equal(results[4].points, POINTS)
    assert results[4].iou_after == refine(POINTS, _view(), config=RefineConfig(steps=0)).iou_before


def test_a_scene_that_is_no_pair_is_named_and_stops_no_other():
    good, *bad = refine_batch([(POINTS, _view()), (POINTS,), None, POINTS], RefineConfig(steps=1))
    assert good.steps == 1
    for number, (error, found) in enumerate(zip(bad, ("tuple of 1", "None", "ndarray of 40"), strict=True), 1):
        assert isinstance(error, InputError)
        assert str(error) == f"scene {number} is {found}, expected (points, views)"
    with pytest.raises(InputError, match="scenes is None, expected a sequence"):
        refine_batch(None)
