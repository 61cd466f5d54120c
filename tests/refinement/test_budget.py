"""A budget of seconds: when it is over the best so far is kept, and few seconds move few points."""

import math
import time

import numpy as np
import pytest

from tests.scenes import problem_of
from tso_cli import InputError, RefineConfig, refine
from tso_cli.cloud.smooth_field import SmoothField
from tso_cli.commands.sentences import Words
from tso_cli.optimisation.comparison import final_losses


def test_when_the_seconds_are_over_the_best_so_far_is_kept(chair):
    result = refine(*chair[:3], RefineConfig(budget=1e-6))
    # One step, and no check of the mirror plane.
    assert result.fit.steps == 1
    assert result.fit.stop_reason == "out_of_time"
    assert result.symmetry.outcome == "unchecked"
    assert result.fit.loss_after < result.fit.loss_before
    assert result.trust.reason == "time"
    assert result.trust.verdict is None
    assert result.trust.confidence is None
    said = "the budget ended after 1 of 20 steps: there is no confidence in the result"
    assert Words(["mask"]).warnings(result) == [said]


def test_the_result_is_there_by_the_end_of_the_seconds(chair):
    started = time.perf_counter()
    config = RefineConfig(budget=2.0, steps=100_000, symmetry="none")
    result = refine(*chair[:3], config)
    # A busy machine evaluates the result more slowly.
    assert time.perf_counter() - started < 10.0
    assert result.fit.stop_reason == "out_of_time"
    assert 3 < result.fit.steps < 100_000


@pytest.mark.parametrize("seconds", [1e6, "1e6"])
def test_with_more_seconds_than_it_needs_a_result_is_that_without(chair, seconds):
    limited, free = (refine(*chair[:3], RefineConfig(budget=one)) for one in (seconds, "auto"))
    np.testing.assert_array_equal(limited.points, free.points)
    assert limited.fit == free.fit
    assert limited.fit.stop_reason == "max_steps"


def test_seconds_end_the_preset_paper_too(chair):
    config = RefineConfig(budget=1e-6, preset="paper")
    result = refine(*chair[:3], config)
    assert result.fit.steps == 1
    assert result.fit.stop_reason == "out_of_time"
    assert result.cost.decisions == ()


@pytest.mark.parametrize(
    ("config", "views", "points"),
    [
        (RefineConfig(budget=0.1), 1, 512),
        (RefineConfig(budget=0.5), 1, 1024),
        (RefineConfig(budget=0.5), 2, 512),
        (RefineConfig(budget="0.1", points=1024), 1, 1024),
        (RefineConfig(), 9, 1024),
        (RefineConfig(budget=0.1, preset="paper"), 1, None),
    ],
)
def test_with_few_seconds_a_view_fewer_points_move_unless_they_are_asked_for(config, views, points):
    assert config.settings(views).points == points


class _Interrupted(SmoothField):
    """A field that Ctrl-C interrupts when it is used for the time ``call``."""

    def __init__(self, points, call):
        super().__init__(points)
        self._left = call

    def spread(self, values):
        self._left -= 1
        if self._left == 0:
            raise KeyboardInterrupt
        return super().spread(values)


@pytest.mark.parametrize("until", [math.inf, 1e18], ids=["no limit", "timed"])
@pytest.mark.parametrize("call", [1, 6, 30])
def test_ctrl_c_during_a_comparison_ends_it(chair, until, call):
    """Before the first loss, in the first optimisation, and in the second or where it is timed."""
    problem = problem_of(chair.points[::3], chair.view)
    field = _Interrupted(problem.cloud.start, call)
    with pytest.raises(KeyboardInterrupt):
        final_losses((problem, problem), [1.0], field, until)


def test_a_comparison_without_time_has_no_losses(chair):
    problem = problem_of(chair.points[::3], chair.view)
    field = SmoothField(problem.cloud.start)
    assert final_losses((problem, problem), [1.0], field, time.perf_counter()) is None
    one, other = final_losses((problem, problem), [1.0], field)
    assert one == other > 0.0


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"budget": "most"}, "budget is 'most', expected auto or seconds"),
        ({"budget": 0.0}, "budget is 0.0"),
        ({"budget": math.nan}, "budget is nan"),
        ({"budget": True}, "budget is True"),
        ({"points": 100, "mode": "latent"}, "`points` is for mode points with preset best"),
        ({"points": 3}, "points is 3, expected a whole number from 16 to 16,384"),
        ({"points": True}, "points is True"),
    ],
)
def test_a_budget_that_means_nothing_is_refused(settings, named):
    with pytest.raises(InputError, match=named):
        RefineConfig(**settings)
