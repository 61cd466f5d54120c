"""What an optimisation comes to: whether the displacement is taken, and why."""

from dataclasses import replace

import numpy as np
import pytest

from tests.losses.scenes import points_at
from tests.scenes import block, problem_of
from tso_cli import Camera, RefineConfig, TsoError, View, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.diagnosis.examine import Diagnosis, examine
from tso_cli.diagnosis.findings import Finding
from tso_cli.optimisation.learned_start import beginning
from tso_cli.optimisation.loop import Optimised
from tso_cli.optimisation.optimise import optimise, weigh
from tso_cli.optimisation.problem import prepare
from tso_cli.pose.move import unmoved
from tso_cli.prior import named_prior
from tso_cli.refinement.clock import Clock
from tso_cli.refinement.judge import judge
from tso_cli.refinement.run import run
from tso_cli.refinement.scene import as_scene


def _judged(points, view, displacements=0.0, settings=None, **parts):
    """The result of an optimisation that says it lowered the loss by these ``displacements``."""
    problem = problem_of(points, view)
    best = problem.cloud.start + displacements
    values = dict(best_step=1, losses=[2.0, 1.0], interrupted=False, first_loss=2.0, best_loss=1.0)
    optimised = Optimised(best, **(values | parts))
    settings = settings or RefineConfig(steps=4).settings()
    diagnosis = Diagnosis(placements=())
    weighed = weigh(problem, settings)
    return judge(weighed, optimised, [view], unmoved([view]), diagnosis, settings, {})


def _square(middle, step=1.0):
    """A square of points, 24 pixels wide, one every ``step`` pixels."""
    columns, rows = np.arange(middle - 12.0, middle + 11.1, step), np.arange(20.0, 43.1, step)
    pixels = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
    return points_at(pixels, Camera.canonical(64, 64), np.full(len(pixels), 2.0))


MASK = View(block(np.s_[20:44, 20:44]), Camera.canonical(64, 64), name="front")
FORTY = RefineConfig(steps=40).settings()
# One pixel to the right, in widths of the square.
RIGHT = np.array([1.0, 0.0, 0.0]) / 24.0


@pytest.mark.parametrize(
    ("middle", "step", "right", "stop_reason"),
    [
        (28.0, 1.0, 3.0, "max_steps"),
        (28.0, 1.0, -1.0, "not_improved"),
        # The IoU of a start that hardly touches its mask says nothing: its overlap is doubtful.
        (9.5, 1.0, -1.0, "doubtful"),
        (9.5, 1 / 3, -1.0, "doubtful"),
        (9.5, 1 / 3, 1.0, "doubtful"),
    ],
)
def test_where_the_iou_would_fall_the_start_is_returned(middle, step, right, stop_reason):
    points = _square(middle, step)
    result = _judged(points, MASK, right * RIGHT)
    assert result.fit.stop_reason == stop_reason
    if stop_reason == "max_steps":
        assert result.fit.outcome == "moved"
        assert result.fit.best_step == 1
        assert result.fit.loss_after == 1.0
        assert result.fit.moved_max == pytest.approx(abs(right) / 24.0)
    else:
        assert result.fit.outcome == "left"
        np.testing.assert_array_equal(result.points, points)
        assert result.fit.best_step == 0
        assert result.fit.iou_after == result.fit.iou_before
        assert result.fit.loss_after == result.fit.loss_before == 2.0
        assert result.fit.moved_max == 0.0
        assert result.fit.chamfer_to_initial == 0.0
        assert result.trust.verdict == ("doubtful" if stop_reason == "doubtful" else "left")


def test_an_iterate_after_the_loss_stopped_being_a_number_is_never_taken():
    result = _judged(_square(28.0), MASK, RIGHT, losses=[2.0, 1.0, np.nan])
    assert result.fit.stop_reason == "non_finite"
    assert result.fit.steps == 1
    assert result.fit.losses == [2.0, 1.0]


@pytest.mark.parametrize(
    ("losses", "message"),
    [([np.nan], "the loss of the start"), ([1.0, np.nan], "after the first step")],
)
def test_a_loss_that_is_never_a_number_is_an_error(losses, message):
    with pytest.raises(TsoError, match=message):
        _judged(_square(28.0), MASK, losses=losses)


@pytest.mark.parametrize(
    ("parts", "reason"),
    [
        (dict(interrupted=True), "interrupted"),
        # Half of the steps are too few, even if they are many.
        (dict(settings=FORTY, losses=[1.0] * 20, interrupted=True), "interrupted"),
        (dict(settings=FORTY, losses=[*[1.0] * 20, np.nan]), "steps"),
        (dict(), "steps"),
    ],
)
def test_a_result_without_a_confidence_has_a_reason(parts, reason):
    trust = _judged(_square(28.0), MASK, RIGHT, **parts).trust
    assert trust.reason == reason
    assert trust.verdict is None
    assert trust.confidence is None
    assert trust.moves
    assert trust.says


def test_of_fewer_than_16_points_there_is_no_confidence(chair):
    points, config = chair.points, RefineConfig(symmetry="none")
    few, enough = (refine(some, chair.view, config=config) for some in (points[:15], points[:16]))
    assert few.trust.reason == "points"
    assert few.trust.confidence is None
    assert enough.trust.reason != "points"


@pytest.fixture(scope="module")
def optimised(chair):
    """The chair after its optimisation: what `judge` is given."""
    settings = RefineConfig(symmetry="none").settings()
    cloud = Cloud(chair.points, "points").controlled()
    diagnosis = examine(cloud, [chair.view], [chair.view])
    weighed = weigh(prepare(cloud, [chair.view], settings), settings)
    prior = named_prior(settings.prior)
    begin = beginning(weighed.problem, weighed.weights, prior)
    return weighed, settings, diagnosis, optimise(weighed, settings, settings.steps, begin=begin)


def _of(optimised, view, accept_doubtful=False, **changed):
    weighed, settings, diagnosis, found = optimised
    settings = replace(settings, accept_doubtful=accept_doubtful)
    diagnosis = replace(diagnosis, **changed)
    return judge(weighed, found, [view], unmoved([view]), diagnosis, settings, {})


@pytest.mark.parametrize(("accepted", "outcome"), [(False, "left"), (True, "moved")])
def test_a_doubtful_displacement_is_taken_or_left(chair, optimised, accepted, outcome):
    whole = _of(optimised, chair.view)
    assert whole.trust.verdict == "fits better"
    result = _of(optimised, chair.view, accepted, of_views=(Finding("opengl"),))
    assert result.fit.outcome == outcome
    assert result.moved is accepted
    assert result.trust.verdict == "doubtful"
    assert not result.trust.moves
    np.testing.assert_array_equal(result.points, whole.points if accepted else chair.points)
    assert (result.fit.stop_reason == "doubtful") == (outcome == "left")
    assert result.findings == (Finding("opengl"),)


def test_a_view_that_the_others_contradict_is_a_finding(chair, optimised):
    weighed, *others = optimised
    contradicted = replace(weighed, weights=[0.3])
    result = _of((contradicted, *others), chair.view)
    assert result.findings == (Finding("contradicted", (0,), values={"weight": 0.3}),)
    assert result.views[0].inlier_weight == 0.3
    tolerated = replace(weighed, weights=[0.5])
    assert _of((tolerated, *others), chair.view).findings == ()


def test_a_cloud_that_covers_its_mask_fits():
    # Nearly to the edges of its outermost pixels.
    along = np.linspace(19.7, 43.3, 72)
    pixels = np.stack(np.meshgrid(along, along), -1).reshape(-1, 2)
    points = points_at(pixels, Camera.canonical(64, 64), np.full(len(pixels), 2.0))
    result = refine(points, MASK, config=RefineConfig(steps=3, symmetry="none"))
    assert result.fit.stop_reason == "fits"
    assert result.fit.outcome == "left"
    assert result.fit.best_step == 0
    assert result.fit.moved_mean == 0.0
    np.testing.assert_array_equal(result.points, points)


@pytest.mark.parametrize("preset", ["best", "paper"])
def test_ctrl_c_before_the_optimisation_leaves_the_cloud_as_it_was(chair, preset):
    settings = RefineConfig(preset=preset, move="camera").settings()
    result = run(as_scene(chair.points, chair.view), settings, Clock(interrupted=True))
    assert result.fit.stop_reason == "interrupted"
    assert result.fit.steps == 0
    assert result.cameras == (chair.view.camera,)
    np.testing.assert_array_equal(result.points, chair.points)
    assert set(result.cost.seconds) == {"prepare", "optimise", "judge"}
