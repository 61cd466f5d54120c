"""Batches of clouds: each has the result that it has alone. Errors, progress and interrupts."""

import os
import signal
import sys
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest

from tests.corruption import assert_refused
from tests.scenes import block, example
from tso_cli import (
    Camera,
    InputError,
    Interrupted,
    RefineConfig,
    RefineResult,
    TsoError,
    View,
    refine,
    refine_batch,
    refine_each,
)
from tso_cli.refinement import PRESETS, batch
from tso_cli.workers import WorkerPool

POINTS = np.random.default_rng(0).uniform(-0.3, 0.3, (40, 3))
VIEW = View(block(np.s_[21:32, 25:41]), Camera.canonical(64, 64))


def _assert_same(result: RefineResult, alone: RefineResult) -> None:
    np.testing.assert_array_equal(result.points, alone.points)
    assert result.fit == alone.fit
    assert result.symmetry.coefficients == alone.symmetry.coefficients
    assert result.trust == alone.trust
    for view, other in zip(result.views, alone.views, strict=True):
        assert vars(replace(view, camera=None)) == vars(replace(other, camera=None))


@pytest.mark.parametrize("preset", PRESETS)
def test_in_any_number_of_processes_results_have_the_bits_of_each_alone(chair, monkeypatch, preset):
    points, view, camera = chair.points[::3], chair.view, chair.camera
    small = View(chair.mask[::4, ::4], camera.resized(64, 64))
    far = replace(camera, t=camera.t - camera.R @ np.full(3, 100.0))
    known = np.arange(256)[:, None] + np.zeros((256, 256)) < 200
    scenes = [
        (points, view),
        (points[::2], [view, small]),
        (points + 100.0, replace(view, camera=far)),
    ]
    scenes.append((points[::2] * 0.9, replace(view, known=known)))
    config = RefineConfig(steps=3, preset=preset)
    expected = [refine(cloud, views, config=config) for cloud, views in scenes]
    monkeypatch.setattr(batch, "SCENES_TO_START", 1)
    for processes in ("1", "2"):
        monkeypatch.setenv("OMP_NUM_THREADS", processes)
        results = refine_batch(scenes, config)
        for result, alone in zip(results, expected, strict=True):
            _assert_same(result, alone)


def test_in_a_batch_a_mask_without_a_camera_is_as_unsure_as_alone():
    scene = example("airplane")
    alone = refine(scene.points, scene.mask)
    (result,) = refine_batch([(scene.points, scene.mask)])
    for one in (alone, result):
        assert [finding.name for finding in one.findings] == ["assumed-camera"]
        assert one.trust.reason == "assumed-camera"


def test_one_failing_cloud_of_a_batch_leaves_the_others_unaffected():
    behind = replace(VIEW, camera=replace(VIEW.camera, t=VIEW.camera.t - [0.0, 0.0, 9.0]))
    scenes = [(POINTS, VIEW), (POINTS, behind), (POINTS * np.nan, VIEW), (POINTS, VIEW)]
    good, invisible, not_finite, other = refine_batch(scenes, RefineConfig(steps=3))
    _assert_same(good, other)
    assert good.fit.steps == 3
    assert isinstance(invisible, InputError)
    assert "behind the camera" in str(invisible)
    assert "points of scene 2" in str(not_finite)


def test_a_scene_that_is_no_pair_is_an_error_of_its_own():
    good, *bad = refine_batch([(POINTS, VIEW), (POINTS,), None, POINTS, {}], RefineConfig(steps=1))
    assert good.fit.steps == 1
    shown = "tuple of 1", "None", "ndarray of 40", "dict of 0"
    for number, (error, scene) in enumerate(zip(bad, shown, strict=True), 1):
        assert isinstance(error, InputError)
        assert str(error) == f"scene {number} is {scene}, expected (points, views)"
    assert refine_batch([]) == []


@pytest.mark.parametrize("function", [refine_batch, refine_each])
@pytest.mark.parametrize(
    ("scenes", "settings", "message"),
    [
        (None, {}, "^scenes is None, expected a sequence"),
        (3, {}, "^scenes is 3, expected a sequence"),
        ([], {"config": RefineConfig(mode="latent")}, "for a batch"),
        ([], {"config": [3]}, "^config is of type list, expected a RefineConfig"),
        ([], {"executor": 3}, "^executor is 3, expected one of concurrent.futures"),
        ([], {"executor": 0}, "^executor is 0, expected one of concurrent.futures"),
    ],
    ids=str,
)
def test_an_argument_of_another_kind_is_refused_when_it_is_given(
    function, scenes, settings, message
):
    assert_refused(message, function, scenes, **settings)


def test_a_window_or_progress_of_another_kind_is_refused():
    for window in (0, -1, "two"):
        assert_refused(
            "^window is .*, expected a whole number from 1", refine_each, [], window=window
        )
    assert_refused("^progress is 3, expected a function", refine_batch, [], progress=3)


def test_progress_counts_clouds_and_reports_the_mean_loss_of_results(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    reported = []
    scenes = [(POINTS * np.nan, VIEW), (POINTS, VIEW), (POINTS[:20], VIEW)]
    _, first, second = refine_batch(
        scenes, RefineConfig(steps=2), progress=lambda *report: reported.append(report)
    )
    assert [report[:2] for report in reported] == [(1, 3), (2, 3), (3, 3)]
    assert np.isnan(reported[0][2])
    assert [report[2] for report in reported[1:]] == [
        first.fit.loss_after,
        (first.fit.loss_after + second.fit.loss_after) / 2.0,
    ]
    assert {"prepare", "optimise", "judge"} <= set(first.cost.seconds)


@pytest.mark.parametrize("processes", ["1", "2"])
def test_an_error_of_the_callers_progress_ends_the_batch(monkeypatch, processes):
    monkeypatch.setenv("OMP_NUM_THREADS", processes)
    reported = []

    def fail(done, clouds, loss):
        reported.append(done)
        raise ValueError("no more")

    with pytest.raises(ValueError, match="no more"):
        refine_batch([(POINTS, VIEW)] * 30, RefineConfig(steps=30), progress=fail)
    assert len(reported) < 5


class _NotYet:
    """Points that Ctrl-C interrupts when they are read."""

    def __array__(self, dtype=None, copy=None):
        raise KeyboardInterrupt


@pytest.mark.parametrize("how", ["Ctrl-C", "an exception of the caller's progress"])
def test_after_an_interrupt_clouds_have_their_best_iterate_or_none(monkeypatch, how):
    """In the caller's process: one cloud is done, the next is about to begin, the rest waits."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")

    def interrupt(done, clouds, loss):
        if done == 1 and how == "Ctrl-C":
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        elif done == 1:
            raise KeyboardInterrupt

    config = RefineConfig(steps=300, symmetry="none", accept_doubtful=True)
    first, *waiting = refine_batch([(POINTS, VIEW)] * 15, config, progress=interrupt)
    assert first.fit.stop_reason == "max_steps"
    assert all(isinstance(one, Interrupted) for one in waiting)
    assert str(waiting[-1]) == "scene 14: interrupted before it began"


def test_a_cloud_that_is_interrupted_while_it_is_read_has_not_begun(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    results = refine_batch([(_NotYet(), VIEW), (POINTS, VIEW)], RefineConfig(steps=3))
    assert [type(result) for result in results] == [Interrupted, Interrupted]


class _Signals:
    """Points that, when they are read in another process, interrupt the parent."""

    def __init__(self, parent):
        self.parent = parent

    def __array__(self, dtype=None, copy=None):
        if os.getpid() != self.parent:
            os.kill(self.parent, signal.SIGINT)
        return np.array(POINTS, dtype)


def test_clouds_at_work_in_processes_have_their_best_iterate_after_an_interrupt(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.setattr(batch, "SCENES_TO_START", 1)
    config = RefineConfig(steps=100_000, preset="paper")
    results = refine_batch([(POINTS, VIEW), (_Signals(os.getpid()), VIEW)] * 200, config)
    begun = [result for result in results if isinstance(result, RefineResult)]
    assert 1 <= len(begun) <= 4
    assert {result.fit.stop_reason for result in begun} == {"interrupted"}
    assert all(isinstance(one, (RefineResult, Interrupted)) for one in results)


class _Killed:
    """Points whose reading kills the process that reads them."""

    def __init__(self, parent):
        self.parent = parent

    def __array__(self, dtype=None, copy=None):
        if os.getpid() != self.parent:
            os.kill(os.getpid(), signal.SIGKILL)
        return np.array(POINTS, dtype)


kills = pytest.mark.skipif(sys.platform != "linux", reason="kills by signals")


def _assert_only_scene_3_was_killed(results):
    poison = results.pop(3)
    assert isinstance(poison, TsoError)
    assert str(poison) == (
        "scene 3: its process was killed by SIGKILL, perhaps for lack of memory, 3 times"
    )
    for result in results:
        _assert_same(result, results[0])


@kills
@pytest.mark.parametrize("processes", ["1", "2"])
@pytest.mark.parametrize("known", [True, False], ids=["a list", "a generator"])
def test_a_scene_that_kills_its_process_is_an_error_of_its_own(monkeypatch, processes, known):
    monkeypatch.setenv("OMP_NUM_THREADS", processes)
    # A generator may make any number of scenes; of a list, this many are worth a process.
    scenes = [(POINTS, VIEW)] * (16 if known else 5)
    scenes[3] = (_Killed(os.getpid()), VIEW)
    config = RefineConfig(steps=3)
    found = refine_batch(scenes, config) if known else dict(refine_each(iter(scenes), config))
    _assert_only_scene_3_was_killed([found[number] for number in range(len(scenes))])


@kills
def test_a_scene_that_breaks_the_executor_of_the_caller_loses_no_other():
    scenes = [(POINTS, VIEW)] * 12
    scenes[3] = (_Killed(os.getpid()), VIEW)
    with (
        ProcessPoolExecutor(2, get_context("fork")) as executor,
        pytest.warns(UserWarning, match="executor broke, so processes of tso refine") as caught,
    ):
        results = refine_batch(scenes, RefineConfig(steps=3), executor=executor)
    # Python itself warns of processes that are forked from threads.
    assert sum(one.category is UserWarning for one in caught) == 1
    _assert_only_scene_3_was_killed(results)


class _OutOfMemory:
    def __array__(self, dtype=None, copy=None):
        raise MemoryError("no more")


@pytest.mark.parametrize("processes", ["1", "2"])
def test_no_error_of_one_scene_loses_the_results_of_others(monkeypatch, processes):
    monkeypatch.setenv("OMP_NUM_THREADS", processes)
    monkeypatch.setattr(batch, "SCENES_TO_START", 1)
    ragged, text, large = [[1, 2, 3], [1, 2]], "cloud", POINTS * 1e308
    bad = [ragged, text, {}, large, _OutOfMemory()]
    scenes = [(POINTS, VIEW), *((points, VIEW) for points in bad), (POINTS, VIEW)]
    first, *errors, last = refine_batch(scenes, RefineConfig(steps=2))
    _assert_same(first, last)
    assert all(isinstance(error, TsoError) for error in errors)
    assert str(errors[-1]) == "scene 5: no more"


def test_scenes_may_be_made_while_others_are_refined():
    made = []

    def scenes():
        for number in range(9):
            made.append(number)
            yield POINTS + 0.001 * number, VIEW

    found = refine_each(scenes(), RefineConfig(steps=2), executor=ThreadPoolExecutor(1), window=2)
    number, result = next(found)
    assert len(made) <= 3
    rest = dict(found)
    assert sorted([number, *rest]) == list(range(9))
    assert isinstance(result, RefineResult)
    _assert_same(rest[8], refine(POINTS + 0.008, VIEW, config=RefineConfig(steps=2)))


def test_a_consumer_who_stops_leaves_no_process(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    pools = []
    monkeypatch.setattr(batch, "WorkerPool", lambda n: pools.append(WorkerPool(n)) or pools[-1])
    for _ in refine_each(((POINTS, VIEW) for _ in range(99)), RefineConfig(steps=2)):
        break
    (pool,) = pools
    with pytest.raises(RuntimeError, match="shut down"):
        pool.submit(print)


def test_few_scenes_are_refined_without_other_processes(monkeypatch):
    """Starting a process takes as long as refining a few."""
    monkeypatch.setenv("OMP_NUM_THREADS", "4")
    monkeypatch.setattr(batch, "WorkerPool", None)
    results = refine_batch([(POINTS, VIEW)] * 15, RefineConfig(steps=1))
    assert {result.fit.steps for result in results} == {1}
