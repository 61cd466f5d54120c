"""The default preset: its displacement field, the position prior, and unobserved parts."""

from dataclasses import replace

import numpy as np
import pytest

from tests.losses.common import assert_gradient
from tests.scenes import block, problem_of, seen
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.cloud.smooth_field import SmoothField
from tso_cli.optimisation.field_optimisation import optimise_field
from tso_cli.optimisation.learned_start import Beginning
from tso_cli.optimisation.objective import MaskChamferObjective, ViewTargets
from tso_cli.optimisation.position_prior import PositionPrior, position_prior
from tso_cli.optimisation.presets import BEST, BEST_POINTS
from tso_cli.render import look_at


def test_points_outside_every_image_hardly_move():
    """A long bar ends outside the left border of an image that shows the bar higher."""
    axes = np.linspace(-2.0, 0.4, 120), np.linspace(-0.1, 0.1, 5), np.linspace(-0.1, 0.1, 4)
    bar = np.stack(np.meshgrid(*axes), -1).reshape(-1, 3)
    camera = look_at(0.0, 0.0, 2.2, (64, 64))
    observed = camera.project(bar)[0][:, 0] > -0.5
    assert 0.3 < observed.mean() < 0.7
    higher = seen(bar + [0.0, 0.06, 0.0], camera)
    config = RefineConfig(symmetry="none", accept_doubtful=True)
    moved = refine(bar, higher, config=config).points[:, 1] - bar[:, 1]
    assert moved[observed].mean() > 0.02
    assert np.abs(moved[~observed]).mean() < 0.15 * moved[observed].mean()


@pytest.mark.parametrize("nearer", [True, False])
def test_the_result_is_where_the_optimisation_began_if_no_step_is_better(chair, nearer):
    """And the start, where the start agrees better with the views."""
    problem = problem_of(chair.points, chair.view)
    start = problem.cloud.start
    target = problem.cloud.normalise(chair.target)[: len(start)]
    begun = Beginning(target if nearer else start + [0.5, 0.0, 0.0])
    field = SmoothField(start)
    # Such a step moves every point out of the picture.
    found = optimise_field(problem, [1.0], field, BEST, 1e3, 1, begin=begun)
    assert found.losses[1] > found.losses[0]
    np.testing.assert_array_equal(found.best, begun.points if nearer else start)
    assert (found.best_loss < found.first_loss) == nearer
    assert found.best_step == 0


def test_as_an_observation_a_flipped_mask_counts_a_quarter_and_a_depth_map_as_a_mask(chair):
    def observations(views, symmetry="none", weights=(1.0, 1.0)):
        problem = problem_of(chair.points, *views, symmetry=symmetry)
        return problem.observations(weights[: len(views)])

    plain = View(chair.mask, chair.camera)
    deep = replace(plain, depth=np.where(chair.mask > 0.5, chair.camera.t[2], 0.0))
    assert observations([plain]) == 1.0
    assert observations([plain, plain]) == 2.0
    assert observations([plain], "x") == 1.25
    assert observations([deep]) == 2.0
    assert observations([plain, deep], "x") == 3.5
    weighted = observations([plain, deep], "x", (0.5, 0.1))
    assert weighted == pytest.approx(0.5 * 1.25 + 0.1 * 2.25)


def _truncated(view: View) -> View:
    """The view without its upper half: the border truncates the object."""
    lower = view.mask[view.mask.shape[0] // 2 :]
    height, width = lower.shape
    return View(
        lower,
        view.camera.cropped((-0.5, height - 0.5, width - 0.5, 2 * height - 0.5), width, height),
    )


@pytest.mark.parametrize("truncated", [(True, True), (True, False), (False, False)])
def test_views_that_all_truncate_the_object_are_no_more_observations_than_one(chair, truncated):
    views = [chair.view, seen(chair.points, look_at(90.0, 10.0, 3.0, (64, 64)))]
    views = [_truncated(view) if cut else view for view, cut in zip(views, truncated, strict=True)]
    problem = problem_of(chair.points, *views)
    field = SmoothField(problem.cloud.start)

    def optimised(observations):
        # Observations lower the least prior weight.
        recipe, rate = replace(BEST, least_prior_weight=1e4), BEST_POINTS.learning_rate
        return optimise_field(
            problem, [1.0, 1.0], field, recipe, rate, 12, observations=observations
        )

    one, two = optimised(1.0), optimised(2.0)
    assert np.array_equal(one.best, two.best) == all(truncated)


def test_an_object_that_every_view_truncates_is_held_three_times_as_much(chair):
    for view, factor in ((_truncated(chair.view), 3.0), (chair.view, 1.0)):
        held, loose = (
            _prior(chair.points, view, truncated_prior=prior)[0].weight for prior in (3.0, 1.0)
        )
        assert held == pytest.approx(factor * loose)


def _prior(
    points: np.ndarray,
    view: View,
    observations: float = 1.0,
    rightness: float = 0.0,
    **settings: object,
) -> tuple[PositionPrior, ViewTargets]:
    problem = problem_of(points, view)
    start, targets, recipe = problem.cloud.start, problem.targets([1.0]), replace(BEST, **settings)
    return position_prior(start, targets, recipe, observations, rightness), targets


def test_the_position_prior_is_a_weighted_square_with_its_gradient(chair):
    prior, _ = _prior(chair.points[::40], chair.view)
    moved = prior.initial + np.random.default_rng(0).normal(size=prior.initial.shape)
    squares = np.square(moved - prior.initial).sum()
    assert prior(moved)[0] == pytest.approx(prior.weight * squares)
    assert_gradient(prior, moved)
    assert prior(prior.initial)[0] == 0.0


def test_a_worse_start_is_held_less_and_more_observations_lower_the_least_weight(chair):
    points = chair.points
    # Stated for 1,024 points. e is the mean loss per mask pixel at the robust scale 4.
    prior, targets = _prior(points, chair.view, least_prior_weight=0.0)
    e = MaskChamferObjective(targets, 4.0)(prior.initial)[0] / targets.pixels
    assert prior.weight == pytest.approx(350.0 / e * 1024.0 / len(points))
    half = _prior(points, chair.view, least_prior_weight=0.0, prior_decay=0.5)[0]
    assert half.weight == pytest.approx(350.0 / np.sqrt(e) * 1024.0 / len(points))
    for count in (1.0, 2.0):
        least = _prior(points, chair.view, count, least_prior_weight=1e6)[0]
        assert least.weight == pytest.approx(1e6 / count**2 * 1024.0 / len(points))
    # Even a perfect start is held no more than where e = 0.1.
    square = np.stack(np.meshgrid(np.arange(26, 38, 0.5), np.arange(26, 38, 0.5)), -1).reshape(
        -1, 2
    )
    flat = np.concatenate([(square - 31.5) / 60.0 * [1.0, -1.0], np.zeros((len(square), 1))], 1)
    exact = _prior(flat, View(block(np.s_[26:38, 26:38]), Camera.canonical(64, 64)))[0]
    assert exact.weight == pytest.approx(350.0 / 0.1 * 1024.0 / len(flat))


def test_a_start_that_is_right_is_held_firmly_unless_it_fits_badly(chair):
    """Far from its mask, most pixels cost nearly the most that they can."""
    near, far = chair.points + [0.01, 0.0, 0.0], chair.points + [0.6, 0.0, 0.0]
    view = seen(chair.points, chair.view.camera)
    for points, factor in ((near, 16.0), (far, 1.0)):
        loose, half, firm = (
            _prior(points, view, rightness=right, least_prior_weight=0.0)[0].weight
            for right in (0.0, 0.5, 1.0)
        )
        assert firm == pytest.approx(factor * loose)
        assert half == pytest.approx(np.sqrt(factor) * loose)


def test_parts_that_the_pixels_do_not_resolve_have_no_resolvability():
    """A post of two cells, with an aerial on top, much thinner than a cell."""
    post = np.random.default_rng(0).uniform([-0.1, -0.3, -0.1], [0.1, 0.1, 0.1], (400, 3))
    aerial = np.stack([np.zeros(60), np.linspace(0.12, 0.5, 60), np.zeros(60)], 1)
    points = np.concatenate([post, aerial])
    view = View(block(np.s_[4:60, 20:44]), Camera.canonical(64, 64))
    problem = problem_of(points, view)
    start = problem.cloud.start
    (resolved,) = problem.targets([1.0]).resolvability(start, SmoothField(start))
    assert resolved[:400].mean() > 0.9
    assert resolved[-50:].max() < 0.1
