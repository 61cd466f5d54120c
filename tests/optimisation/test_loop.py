"""The optimisation loop: the best iterate, whatever ends it, and Eq. 7."""

import sys
from functools import partial

import numpy as np
import pytest
import torch

from tests import oracles
from tests.scenes import block
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.optimisation.loop import minimise, sum_of
from tso_cli.optimisation.objective import SilhouetteObjective
from tso_cli.optimisation.resampled_view import resample_view

START = np.random.default_rng(0).uniform(size=(5, 3))


class Iterates:
    """Parameters whose points are the start times these factors, one after another."""

    def __init__(self, *factors: float) -> None:
        self.iterates, self.number = [START * factor for factor in factors], 0

    def points(self) -> np.ndarray:
        return self.iterates[self.number]

    def step(self, gradient: np.ndarray) -> None:
        np.testing.assert_array_equal(gradient, 2.0 * self.points())
        self.number += 1


def _square(points: np.ndarray) -> tuple[float, np.ndarray]:
    return float(np.square(points).sum()), 2.0 * points


def test_the_best_iterate_is_kept_and_every_step_reported():
    reported, parameters = [], Iterates(1.0, 0.5, 0.1, 0.7)
    optimised = minimise(parameters, _square, 3, lambda *step: reported.append(step))
    losses = [_square(points)[0] for points in parameters.iterates]
    assert optimised.losses == losses
    assert optimised.best_step == 2
    assert optimised.steps == 3
    assert not optimised.interrupted
    assert optimised.first_loss == losses[0]
    assert optimised.best_loss == losses[2]
    np.testing.assert_array_equal(optimised.best, parameters.iterates[2])
    for number, (step, steps, loss, points) in enumerate(reported, 1):
        assert (step, steps, loss) == (number, 3, losses[number])
        np.testing.assert_array_equal(points, parameters.iterates[number])
    assert len(reported) == 3


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("where", ["points", "loss"])
def test_an_iterate_that_is_not_finite_ends_the_optimisation_and_is_never_the_best(where, bad):
    parameters = Iterates(1.0, 0.5, 0.1, 0.05)
    if where == "points":
        parameters.iterates[2][1, 2] = bad

    def objective(points: np.ndarray) -> tuple[float, np.ndarray]:
        assert np.isfinite(points).all()
        return (bad if points is parameters.iterates[2] else _square(points)[0]), 2.0 * points

    optimised = minimise(parameters, objective, 3)
    assert optimised.best_step == optimised.steps == 1
    assert not optimised.interrupted
    assert len(optimised.losses) == 3
    assert np.isnan(optimised.losses[2])
    np.testing.assert_array_equal(optimised.best, 0.5 * START)


def test_best_iterate_its_step_and_its_loss_agree_wherever_an_interrupt_falls():
    best_steps = []
    for stop in range(1, 60):
        lines = iter(range(1, 1000))

        def interrupt(frame, event, argument, lines=lines, stop=stop):
            if event == "line" and next(lines) == stop:
                raise KeyboardInterrupt
            return interrupt

        parameters = Iterates(1.0, 0.5, 0.7, 0.4)
        sys.settrace(
            lambda frame, event, argument: interrupt if frame.f_code is minimise.__code__ else None
        )  # noqa: B023
        try:
            optimised = minimise(parameters, _square, 3)
        except KeyboardInterrupt:
            continue
        finally:
            sys.settrace(None)
        best_steps += [optimised.best_step] * optimised.interrupted
        np.testing.assert_array_equal(optimised.best, parameters.iterates[optimised.best_step])
        assert optimised.best_loss == _square(optimised.best)[0]
        assert optimised.losses[0] == optimised.first_loss == _square(START)[0]
    assert set(best_steps) == {0, 1, 3}


def test_the_loop_ends_where_no_loss_is_left():
    optimised = minimise(Iterates(1.0, 0.0, 0.4), _square, 2)
    assert optimised.losses == [_square(START)[0], 0.0]
    assert optimised.best_step == 1


def test_an_interrupt_before_the_first_loss_is_raised():
    def interrupt(*arguments):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        minimise(Iterates(1.0), interrupt, 3)
    optimised = minimise(Iterates(1.0, 0.5, 0.4), _square, 3, interrupt)
    assert optimised.interrupted
    assert optimised.best_step == 1
    assert len(optimised.losses) == 2


def test_an_interrupt_in_machine_code_is_an_interrupt():
    def objective(points, error):
        if (points == START).all():
            return _square(points)
        raise error

    ctrl_c, other = SystemError("returned a result with an exception set"), SystemError("another")
    ctrl_c.__cause__ = SystemError("the same")
    ctrl_c.__cause__.__cause__ = KeyboardInterrupt()
    assert minimise(Iterates(1.0, 0.5), partial(objective, error=ctrl_c), 3).interrupted
    with pytest.raises(SystemError, match="another"):
        minimise(Iterates(1.0, 0.5), partial(objective, error=other), 3)


def test_a_sum_of_terms_adds_values_and_gradients():
    value, gradient = sum_of([_square, lambda points: (1.0, points), _square])(START)
    assert value == pytest.approx(2.0 * _square(START)[0] + 1.0)
    np.testing.assert_allclose(gradient, 5.0 * START)


MASK = block(np.s_[22:42, 25:40])


def test_the_loss_of_a_view_without_visible_points_is_infinite():
    view = resample_view(View(MASK, Camera.canonical(64, 64)), 0.4, np.zeros(3), 1.0)
    objective, points = SilhouetteObjective([view, view], [1.0, 0.5]), START - 0.5
    value, gradient = objective(points)
    assert np.isfinite(value)
    assert gradient.any()
    alone, single = SilhouetteObjective([view], [1.0])(points)
    assert value == pytest.approx(1.5 * alone)
    np.testing.assert_allclose(gradient, 1.5 * single, rtol=1e-9, atol=1e-9)
    points[1:] += [0.0, 0.0, 9.0]
    assert np.isfinite(objective(points)[0])
    points[0] += [0.0, 0.0, 9.0]
    value, gradient = objective(points)
    assert value == np.inf
    assert not gradient.any()


def test_the_paper_preset_is_adam_on_equation_7():
    """Eq. 7 by all pairs, in float64: the silhouette's cross-entropy and 1e6 Chamfer distances."""
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (90, 3))
    # The settings are stated for a centred cloud with longest side 1.
    points = (points - (points.min(0) + points.max(0)) / 2.0) / np.ptp(points, axis=0).max()
    mask, camera, initial = MASK, Camera.canonical(64, 64), torch.tensor(points)
    moved = initial.clone().requires_grad_()
    optimiser = torch.optim.Adam([moved], lr=5e-4)
    losses = []
    for step in range(26):
        pixels, _ = oracles.project(moved, camera)
        loss = oracles.bce(pixels, torch.tensor(mask).double(), 0.4) + 1e6 * sum(
            oracles.chamfer(moved, initial)
        )
        losses.append(loss.item())
        if step < 25:
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    result = refine(points, mask, camera, RefineConfig(preset="paper", steps=25))
    # Where sums are under 1e-8 only the nearest point attracts: half a thousandth of the loss here.
    np.testing.assert_allclose(result.fit.losses, losses, rtol=2e-3)
    assert result.fit.steps == 25
    assert result.fit.best_step == int(np.argmin(losses)) == 25
    # Adam normalises vanishing gradients to whole steps: single points differ, their mean does not.
    error, displacement = result.points - moved.detach().numpy(), moved.detach().numpy() - points
    assert np.square(error).mean() < 1e-3 * np.square(displacement).mean()
