"""What a refinement decides from its scene: steps, points, window and mirror plane."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import problem_of
from tso_cli import RefineConfig, refine
from tso_cli.optimisation.loop import Optimised
from tso_cli.refinement.decisions import decisions


def _decided(problem, config=None, steps=32, done=None, **parts):
    """Each decision by its name; the optimisation took ``done`` steps and had ``parts``."""
    settings = (config or RefineConfig()).settings(len(problem.given))
    losses = [1.0] * (1 + (steps if done is None else done))
    optimised = Optimised(problem.cloud.start, 0, losses, False, 1.0, 1.0)
    decided = decisions(problem, replace(settings, steps=steps), replace(optimised, **parts))
    return {decision.what: decision for decision in decided}


def test_every_decision_has_a_reason_and_a_share_that_it_saved(chair):
    result = refine(*chair[:3])
    decided = {decision.what: decision for decision in result.cost.decisions}
    assert list(decided) == ["window", "points", "steps", "mirror plane"]
    for decision in decided.values():
        assert decision.reason
        assert 0.0 <= decision.saving <= 1.0
    assert decided["mirror plane"].choice == "used"
    assert decided["mirror plane"].saving == 0.0


def test_the_preset_paper_decides_nothing(chair):
    problem = problem_of(chair.points, chair.view)
    assert _decided(problem, RefineConfig(preset="paper")) == {}


@pytest.mark.parametrize(
    ("config", "steps", "done", "parts", "reason"),
    [
        (RefineConfig(), 2, 2, {}, "2 are enough for one mask"),
        (RefineConfig(steps=9), 9, 9, {}, "as asked for"),
        (RefineConfig(), 2, 0, {}, "no loss was left"),
        (RefineConfig(), 2, 1, {"interrupted": True}, "interrupted"),
        (
            RefineConfig(prior="none"),
            20,
            2,
            {"losses": [3.0, 2.0, 1.0, np.nan]},
            "the loss was not a number after them",
        ),
    ],
)
def test_why_the_steps_ended(chair, config, steps, done, parts, reason):
    decision = _decided(problem_of(chair.points, chair.view), config, steps, done, **parts)["steps"]
    assert decision.choice == str(done)
    assert decision.reason == reason
    assert decision.saving == pytest.approx(max(1.0 - done / steps, 0.0))


def test_as_many_points_move_by_themselves_as_are_asked_for(chair):
    result = refine(*chair[:3], RefineConfig(points=200))
    assert result.control_points == 200
    assert result.fit.iou_after > result.fit.iou_before
    points = result.cost.decisions[1]
    assert points.choice == "200 of 1024"
    assert points.reason == "as asked for"
    assert points.saving == pytest.approx(1.0 - 200 / 1024)


def test_the_points_of_a_large_cloud_that_move_are_decided(chair):
    dense = np.concatenate([chair.points, chair.points + 1e-3])
    decided = _decided(problem_of(dense, chair.view))["points"]
    assert decided.choice == "1024 of 2048"
    assert decided.saving == 0.5
    assert _decided(problem_of(chair.points, chair.view))["points"].saving == 0.0
    result = refine(dense, *chair[1:3], RefineConfig(points=2000, steps=3))
    assert result.control_points == 2000


def test_a_mesh_has_as_many_control_points_as_are_asked_for(chair):
    corners = np.stack(np.meshgrid(*[[-0.2, 0.2]] * 3, indexing="ij"), -1).reshape(-1, 3)
    sides = np.array(
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    )
    faces = np.concatenate([sides[:, [0, 1, 2]], sides[:, [0, 2, 3]]])
    box = refine(corners, *chair[1:3], RefineConfig(points=300, steps=3), faces=faces)
    assert box.control_points == 300


@pytest.mark.parametrize(
    ("symmetry", "choice", "saving"), [("none", "not used", 0.5), ("x", "used", 0.0)]
)
def test_flipped_views_double_the_work(chair, symmetry, choice, saving):
    decision = _decided(problem_of(chair.points, chair.view, symmetry=symmetry))["mirror plane"]
    assert decision.choice == choice
    assert decision.saving == saving


def test_the_window_saves_pixels(chair):
    problem = problem_of(chair.points, chair.view)
    decided = _decided(problem)
    left, top, right, bottom = problem.given[0].resampled.box
    share = (min(right, 255.5) - max(left, -0.5)) * (min(bottom, 255.5) - max(top, -0.5)) / 256**2
    assert decided["window"].saving == pytest.approx(1.0 - share)
    assert decided["window"].choice == f"{share:.0%} of the masks"
