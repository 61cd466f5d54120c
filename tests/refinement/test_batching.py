"""Batches of clouds: each has the result that it has alone. Errors, progress and interrupts."""

import multiprocessing
import os
import signal
import threading
from dataclasses import replace

import numpy as np
import pytest

from tests.corruption import assert_refused
from tests.losses.common import FORMS, in_form
from tests.scenes import block
from tso_cli import (
    Camera,
    InputError,
    RefineConfig,
    RefineResult,
    TsoError,
    View,
    refine,
    refine_batch,
)
from tso_cli.optimisation.objective import SilhouetteObjective
from tso_cli.refinement import PRESETS
from tso_cli.refinement.batch import Batch
from tso_cli.refinement.workers import processes_for, spread, stop_flag

POINTS = np.random.default_rng(0).uniform(-0.3, 0.3, (40, 3))
VIEW = View(block(np.s_[21:32, 25:41]), Camera.canonical(64, 64))


def _assert_same(result: RefineResult, alone: RefineResult) -> None:
    np.testing.assert_array_equal(result.points, alone.points)
    assert result.fit == alone.fit
    assert result.symmetry.coefficients == alone.symmetry.coefficients
    assert result.trust == alone.trust
    for view, other in zip(result.views, alone.views, strict=True):
        assert vars(replace(view, camera=None)) == vars(replace(other, camera=None))


@FORMS
@pytest.mark.parametrize("preset", PRESETS)
def test_in_any_number_of_processes_results_have_the_bits_of_each_alone(
    chair, monkeypatch, form, preset
):
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
    expected = in_form(
        form, lambda: [refine(cloud, views, config=config) for cloud, views in scenes]
    )
    for processes in ("1", "2", "3"):
        monkeypatch.setenv("OMP_NUM_THREADS", processes)
        results = in_form(form, refine_batch, scenes, config)
        for result, alone in zip(results, expected, strict=True):
            _assert_same(result, alone)


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
    for scenes, config, words in (
        (None, None, "scenes is None, expected a sequence"),
        ([], RefineConfig("latent"), "for a batch"),
    ):
        assert_refused(words, refine_batch, scenes, config)
    assert refine_batch([]) == []


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


@pytest.mark.parametrize("how", ["Ctrl-C", "an exception of the caller's progress"])
def test_after_an_interrupt_clouds_have_their_best_iterate_or_their_start(monkeypatch, how):
    """In one process: the first cloud is done, the second is about to begin, the rest waits."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")

    def interrupt(done, clouds, loss):
        if done == 1 and how == "Ctrl-C":
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        elif done == 1:
            raise KeyboardInterrupt

    config = RefineConfig(steps=300, symmetry="none")
    results = refine_batch(
        [(POINTS, VIEW)] * 4 + [(POINTS * np.nan, VIEW)], config, progress=interrupt
    )
    first, second, *waiting, error = results
    assert first.fit.stop_reason == "max_steps"
    assert second.fit.stop_reason == "interrupted"
    assert second.fit.steps < 300
    assert isinstance(error, InputError)
    unmoved = refine(POINTS, VIEW, config=RefineConfig(steps=0))
    for result in waiting:
        assert result.fit.stop_reason == "interrupted"
        assert result.fit.steps == 0
        assert result.fit.iou_after == unmoved.fit.iou_before
        np.testing.assert_array_equal(result.points, POINTS)


class _InterruptedOnce:
    """Points that Ctrl-C interrupts when they are read for the first time."""

    def __init__(self):
        self.read = 0

    def __array__(self, dtype=None, copy=None):
        self.read += 1
        if self.read == 1:
            raise KeyboardInterrupt
        return np.array(POINTS, dtype)


def test_an_interrupt_while_a_cloud_is_read_leaves_it_and_later_clouds_as_they_were():
    flag = stop_flag(1)
    batch = Batch([(_InterruptedOnce(), VIEW), (POINTS, VIEW)], RefineConfig(steps=3), flag)
    for number in (0, 1):
        result = batch.refine(number)
        assert result.fit.stop_reason == "interrupted"
        np.testing.assert_array_equal(result.points, POINTS)
    assert flag.is_set()


def test_a_cloud_at_work_has_its_best_iterate_after_an_interrupt(monkeypatch):
    """Ctrl-C comes when the third cloud is done, and the second is at its third step."""
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    events = multiprocessing.get_context("fork")
    started, interrupted, true_call, calls = (
        events.Event(),
        events.Event(),
        SilhouetteObjective.__call__,
        [],
    )

    def waiting(self, points):
        if len(points) == 20:
            calls.append(points)
            if len(calls) == 3:
                started.set()
                assert interrupted.wait(60)
        elif len(points) == 30:
            assert started.wait(60)
        return true_call(self, points)

    def interrupt(done, clouds, loss):
        if done == 2:
            threading.Timer(0.5, interrupted.set).start()
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(SilhouetteObjective, "__call__", waiting)
    config = RefineConfig(steps=30, preset="paper")
    scenes = [(POINTS, VIEW), (POINTS[:20], VIEW), (POINTS[:30], VIEW)]
    first, at_work, done = refine_batch(scenes, config, progress=interrupt)
    assert [result.fit.stop_reason for result in (first, at_work, done)] == [
        "max_steps",
        "interrupted",
        "max_steps",
    ]
    assert 0 < at_work.fit.best_step <= at_work.fit.steps < 30
    assert at_work.fit.loss_after < at_work.fit.loss_before


def test_a_killed_process_is_one_error_of_one_line():
    here = os.getpid()

    def killed(number):
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    with pytest.raises(TsoError, match="a process of the batch was killed, expected enough memory"):
        spread(killed, 4, 2, stop_flag(2), lambda result: None)


@pytest.mark.parametrize("processes", [1, 2])
def test_work_spread_over_processes_is_returned_in_order(processes):
    done = []
    results = spread(lambda number: number**2, 5, processes, stop_flag(processes), done.append)
    assert results == [0, 1, 4, 9, 16]
    assert sorted(done) == results


@pytest.mark.parametrize(
    ("threads", "count", "processes"), [("4", 9, 4), ("4", 3, 2), ("1", 9, 1), ("4", 1, 1)]
)
def test_a_batch_has_as_many_processes_as_threads_are_allowed(
    monkeypatch, threads, count, processes
):
    """The first cloud is refined before processes begin."""
    monkeypatch.setenv("OMP_NUM_THREADS", threads)
    assert processes_for(count) == processes


def test_a_batch_inside_a_process_that_may_have_no_children_is_refined_there():
    scenes, config = [(POINTS, VIEW)] * 3, RefineConfig(steps=2)
    with multiprocessing.get_context("fork").Pool(1) as pool:
        results = pool.apply(refine_batch, (scenes, config))
    for result, alone in zip(results, refine_batch(scenes, config), strict=True):
        _assert_same(result, alone)
