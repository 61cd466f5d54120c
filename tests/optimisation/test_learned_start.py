"""Where the optimisation begins: the start, moved by the learned prior where the masks agree."""

import numpy as np
import pytest

from tests.prior.common import pushing
from tests.scenes import problem_of, seen
from tso_cli.optimisation.learned_start import PASSES, RIGHT, beginning
from tso_cli.render.viewpoints import look_at

CAMERA = look_at(0.0, 0.0, 2.2, (64, 64))


@pytest.fixture
def begin(chair):
    """Begin from the chair, whose mask shows it ``apart`` to the right of where it is."""

    def run(prior, apart=0.1, weights=(1.0,)):
        right = CAMERA.R[0] * apart
        views = [
            seen(chair.points + right, CAMERA),
            seen(chair.points, look_at(90.0, 0.0, 2.2, (64, 64))),
        ]
        problem = problem_of(chair.points, *views[: len(weights)])
        start = problem.cloud.start
        found = beginning(problem, weights, prior)
        return found, (found.points - start) @ CAMERA.R.T

    return run


def test_a_cloud_moves_to_its_mask_in_passes(begin):
    """Each pass asks for half of the way."""
    found, moved = begin(pushing(0.05, 0.0, 0.0))
    assert PASSES == 2
    np.testing.assert_allclose(moved, np.broadcast_to([0.1, 0.0, 0.0], moved.shape), atol=1e-3)
    assert not found.right


def test_a_step_that_the_mask_contradicts_is_not_taken(begin):
    found, moved = begin(pushing(-0.05, 0.0, 0.0))
    assert not moved.any()
    # It asked for a long step: the start is not right all the same.
    assert not found.right


def test_a_second_step_that_goes_too_far_is_not_taken(begin):
    _, moved = begin(pushing(0.095, 0.0, 0.0), apart=0.085)
    np.testing.assert_allclose(moved[:, 0], 0.095, atol=1e-3)


def test_a_short_step_says_that_the_start_is_right_and_moves_nothing(begin):
    found, moved = begin(pushing(0.9 * RIGHT, 0.0, 0.0))
    assert not moved.any()
    assert found.right


def test_a_start_that_fits_its_mask_moves_half_as_far(begin):
    """0.004 to the side is far less than a pixel; 0.1 is five pixels."""
    fits, moved = begin(pushing(0.008, 0.0, 0.0), apart=0.004)
    assert not fits.right
    np.testing.assert_allclose(moved[:, 0], PASSES * 0.004, atol=1e-4)
    _, moved = begin(pushing(0.008, 0.0, 0.0), apart=0.1)
    np.testing.assert_allclose(moved[:, 0], PASSES * 0.008, atol=1e-4)


def test_a_view_without_weight_is_not_asked(begin):
    """The second view, from the side, would ask for a motion in depth of the first."""
    _, moved = begin(pushing(0.05, 0.0, 0.0), weights=(1.0, 0.0))
    np.testing.assert_allclose(moved[:, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(moved[:, 0], 0.1, atol=1e-3)


def test_an_answer_that_is_not_finite_moves_nothing(begin):
    found, moved = begin(pushing(np.nan, 0.0, 0.0))
    assert not moved.any()
    assert not found.right
