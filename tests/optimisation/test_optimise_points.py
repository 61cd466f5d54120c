"""The default preset: where its points end, the position prior, and unobserved parts."""

import numpy as np
import pytest

from tests.losses.common import assert_gradient
from tests.scenes import problem_of, seen
from tso_cli import RefineConfig, refine
from tso_cli.geometry.window import window_of
from tso_cli.optimisation.learned_start import Beginning
from tso_cli.optimisation.objective import PositionPrior
from tso_cli.optimisation.optimise import firmness_by, optimise_points
from tso_cli.render.viewpoints import look_at


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
    # Such a step moves every point out of the picture.
    found = optimise_points(problem, [1.0], 1, 1e3, begin=begun)
    assert found.losses[1] > found.losses[0]
    np.testing.assert_array_equal(found.best, begun.points if nearer else start)
    assert (found.best_loss < found.first_loss) == nearer
    assert found.best_step == 0


def test_a_start_that_is_right_stays(chair):
    problem = problem_of(chair.points, chair.view)
    start = problem.cloud.start
    for right in (False, True):
        found = optimise_points(problem, [1.0], 5, begin=Beginning(start, right))
        assert np.array_equal(found.best, start) == right
        assert (found.best_loss == found.first_loss) == right


def test_where_the_learned_prior_asks_for_little_points_are_held_firmer(chair):
    problem = problem_of(chair.points, chair.view)
    start = problem.cloud.start
    far = [
        np.square(optimise_points(problem, [1.0], 20, begin=begin).best - start).mean()
        for begin in (None, Beginning(start, asked=0.0))
    ]
    assert far[1] < 0.5 * far[0]
    firmness = [firmness_by(asked, masks_alone=True) for asked in (0.01, 0.05, 0.1, 0.3)]
    assert firmness == pytest.approx([10.0, 2.0, 1.0, 1.0])
    assert np.isfinite(firmness_by(0.0, masks_alone=True))


def test_what_the_learned_prior_does_not_see_may_move_farther():
    assert firmness_by(0.01, masks_alone=False) == firmness_by(0.035, masks_alone=True)


def test_the_position_prior_is_a_weighted_square_with_its_gradient(chair):
    """Its weight is stated for 1,024 points."""
    initial = chair.points[::40]
    prior = PositionPrior(initial, 7.0)
    moved = initial + np.random.default_rng(0).normal(size=initial.shape)
    squares = np.square(moved - initial).sum()
    assert prior(moved)[0] == pytest.approx(7.0 * 1024.0 / len(initial) * squares)
    assert_gradient(prior, moved)
    assert prior(initial)[0] == 0.0


def test_a_part_that_the_mask_could_have_lost_does_not_pull(chair):
    """A wire that is far thinner than a pixel, above a chair whose mask does not show it."""
    problem = problem_of(chair.points, chair.view)
    fine = problem.finely_around(problem.cloud.start)
    top = problem.cloud.start[problem.cloud.start[:, 1].argmax()]
    wire = top + np.linspace(0.1, 0.2, 40)[:, None] * [0.0, 1.0, 0.0]
    points = np.concatenate([problem.cloud.start, wire])
    targets = fine.targets([1.0])
    pull = np.abs(targets.loss(points)[1][-40:]).max()
    assert pull > 1.0
    assert np.abs(targets.resolving(points).loss(points)[1][-40:]).max() < 0.01 * pull


def test_points_are_compared_with_finer_cells_around_where_they_begin(chair):
    problem = problem_of(chair.points, chair.view)
    (coarse,) = problem.given
    begun = 0.5 * problem.cloud.start
    (fine,) = problem.finely_around(begun).given
    assert (coarse.resampled.camera.width, fine.resampled.camera.width) == (64, 128)
    assert fine.resampled.box == window_of(chair.view, problem.cloud.denormalise(begun))
