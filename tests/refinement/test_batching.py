"""Batches of clouds: the results of each alone in any number of processes, errors, progress and interrupts."""

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

POINTS = np.random.default_rng(0).uniform(-0.3, 0.3, (40, 3))
VIEW = View(block(np.s_[21:32, 25:41]), Camera.canonical(64, 64))


def _same(result: RefineResult, alone: RefineResult) -> bool:
    measures = (
        "losses",
        "best_step",
        "view_ious",
        "view_weights",
        "symmetry",
        "chamfer_to_initial",
        "stop_reason",
    )
    same = all(getattr(result, name) == getattr(alone, name) for name in measures)
    return same and np.array_equal(result.points, alone.points)


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
        assert all(map(_same, in_form(form, refine_batch, scenes, config), expected))


def test_one_failing_cloud_of_a_batch_leaves_the_others_unaffected():
    behind = replace(VIEW, camera=replace(VIEW.camera, t=VIEW.camera.t - [0.0, 0.0, 9.0]))
    scenes = [(POINTS, VIEW), (POINTS, behind), (POINTS * np.nan, VIEW), (POINTS, VIEW)]
    good, invisible, not_finite, other = refine_batch(scenes, RefineConfig(steps=3))
    assert _same(good, other)
    assert good.steps == 3
    assert isinstance(invisible, InputError)
    assert "behind the camera" in str(invisible)
    assert "points of scene 2" in str(not_finite)


def test_a_scene_that_is_no_pair_is_an_error_of_its_own():
    good, *bad = refine_batch([(POINTS, VIEW), (POINTS,), None, POINTS, {}], RefineConfig(steps=1))
    assert good.steps == 1
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
        first.loss_after,
        (first.loss_after + second.loss_after) / 2.0,
    ]
    assert {"prepare", "optimise", "judge"} <= set(first.seconds)


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
    assert [getattr(result, "stop_reason", "error") for result in results] == [
        "max_steps",
        *["interrupted"] * 3,
        "error",
    ]
    assert results[1].steps < 300
    assert results[2].steps == results[3].steps == 0
    for waiting in results[2:4]:
        np.testing.assert_array_equal(waiting.points, POINTS)
        assert waiting.iou_after == refine(POINTS, VIEW, config=RefineConfig(steps=0)).iou_before
        assert waiting.warnings[0].startswith(
            "nothing moved: interrupted at step 0, before one lowered the loss"
        )


def test_a_cloud_at_work_has_its_best_iterate_after_an_interrupt(monkeypatch):
    """The first cloud is refined before processes begin, the third is done while the second is at its third step."""
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
    assert [result.stop_reason for result in (first, at_work, done)] == [
        "max_steps",
        "interrupted",
        "max_steps",
    ]
    assert 0 < at_work.best_step <= at_work.steps < 30
    assert at_work.loss_after < at_work.loss_before
    assert at_work.warnings == (
        f"interrupted at step {at_work.steps} of 30: the result is the best so far",
    )


def test_a_killed_process_ends_the_batch_with_one_line(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    here = os.getpid()

    def killed(self, points):
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return true_call(self, points)

    true_call = SilhouetteObjective.__call__
    monkeypatch.setattr(SilhouetteObjective, "__call__", killed)
    with pytest.raises(TsoError, match="a process of the batch was killed, expected enough memory"):
        refine_batch([(POINTS, VIEW)] * 4, RefineConfig(steps=2, preset="paper"))


def test_a_batch_inside_a_process_that_may_have_no_children_is_refined_there():
    scenes, config = [(POINTS, VIEW)] * 3, RefineConfig(steps=2)
    with multiprocessing.get_context("fork").Pool(1) as pool:
        results = pool.apply(refine_batch, (scenes, config))
    assert all(map(_same, results, refine_batch(scenes, config)))
