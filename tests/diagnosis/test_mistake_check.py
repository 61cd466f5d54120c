"""A mistake that the silhouettes alone only hint at is named where a short descent agrees."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.scenes import example
from tso_cli import InputError, RefineConfig, View, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.diagnosis import mistake_check
from tso_cli.diagnosis.agreement import Agreement, Hint
from tso_cli.diagnosis.hypotheses import ASSUMPTIONS, AssumedView, Suspect
from tso_cli.optimisation.problem import Problem

CHAIR = example("chair")
MISTAKES = ("mask-flipped", "mask-upside-down", "R-transposed")


def _options(view: View, **settings) -> list[str]:
    return [
        suspect.option
        for suspect in refine(CHAIR.points, view, config=RefineConfig(**settings)).suspects
    ]


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_that_silhouettes_only_hint_at_is_named(name):
    view = ASSUMPTIONS[name].of_view(CHAIR.view)
    agreement = Agreement.of(CHAIR.points, [view])
    assert agreement.suspects == ()
    assert agreement.hint.suspect.option == f"--assume {name}"
    assert _options(view) == [f"--assume {name}"]


def test_a_hint_that_no_descent_confirms_is_not_said(monkeypatch):
    """Right scenes with whatever hint stay as they are."""
    plain = refine(CHAIR.points, CHAIR.view)
    for name in MISTAKES:
        hint = Hint(Suspect("", f"--assume {name}", 1.0), ASSUMPTIONS[name])
        agreement = replace(Agreement.of(CHAIR.points, [CHAIR.view]), hint=hint)
        monkeypatch.setattr(Agreement, "of", lambda *_, agreement=agreement: agreement)
        result = refine(CHAIR.points, CHAIR.view)
        assert "check mistake" in result.seconds
        assert result.suspects == ()
        assert result.verdict == "improved"
        np.testing.assert_array_equal(result.points, plain.points)


def test_nothing_more_is_hinted_at_where_something_was_assumed():
    assumed = (replace(ASSUMPTIONS["mask-upside-down"], option="--assume mask-upside-down"),)
    view = ASSUMPTIONS["mask-flipped"].of_view(CHAIR.view)
    view = AssumedView(view.mask, view.camera, given=assumed, camera_read=view.camera)
    assert Agreement.of(CHAIR.points, [assumed[0].of_view(view)]).hint is None


def test_a_depth_map_which_is_not_flipped_with_its_mask_leaves_a_hint_unchecked():
    view = ASSUMPTIONS["mask-flipped"].of_view(CHAIR.view)
    depth = np.where(view.mask > 0.5, np.median(CHAIR.camera.project(CHAIR.target)[1]), np.nan)
    assert _options(replace(view, depth=depth)) == []


@pytest.mark.parametrize("budget", [1e-3, 1e-9])
def test_without_time_a_hint_is_not_checked(budget):
    assert _options(ASSUMPTIONS["mask-flipped"].of_view(CHAIR.view), budget=budget) == []


def test_ctrl_c_during_the_check_leaves_the_cloud_as_it_was(monkeypatch):
    stopped = SimpleNamespace(
        run=lambda *_, **__: (SimpleNamespace(interrupted=True, out_of_time=False), None)
    )
    monkeypatch.setattr(mistake_check, "probe", lambda *_: stopped)
    result = refine(CHAIR.points, ASSUMPTIONS["mask-flipped"].of_view(CHAIR.view))
    assert result.stop_reason == "interrupted"
    np.testing.assert_array_equal(result.points, result.initial)


def test_a_mistake_that_a_descent_alone_tells_of_is_doubtful_and_keeps_no_point_where_it_is(
    monkeypatch,
):
    """The start may be a shape that looks like its mirror image from there."""
    monkeypatch.setattr("tso_cli.diagnosis.confidence._judged", lambda signs: (0.2, "camera"))
    result = refine(CHAIR.points, ASSUMPTIONS["mask-flipped"].of_view(CHAIR.view))
    assert (result.verdict, result.step_taken) == ("doubtful", 1.0)
    assert "mask is flipped" in result.reason


def test_an_assumption_under_which_the_views_cannot_be_is_not_confirmed():
    def impossible(camera):
        raise InputError("no camera")

    settings = RefineConfig().settings(1)
    problem = Problem.of(Cloud(CHAIR.points, "cloud"), (CHAIR.view,), settings)
    hint = Hint(Suspect("", "", 1.0), replace(ASSUMPTIONS["R-transposed"], camera=impossible))
    problem = replace(problem, agreement=replace(problem.agreement, hint=hint))
    assert mistake_check.checked_hint(problem, settings) == (problem, False)
