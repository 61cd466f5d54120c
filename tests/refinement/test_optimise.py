"""The optimisation loop: the best iterate, and Eq. 7."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests import oracles
from tso_cli.errors import TsoError
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.view import View
from tso_cli.network.model import build_network
from tso_cli.refinement import RefineConfig, optimise, refine
from tso_cli.refinement.adam import Adam
from tso_cli.refinement.objective import SilhouetteObjective
from tso_cli.refinement.optimise import descend
from tso_cli.refinement.resampled_view import resample_view


def _clouds(count: int = 2) -> torch.Tensor:
    return torch.rand(count, 5, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()


def _square(side: int = 64) -> np.ndarray:
    mask = np.zeros((side, side), np.float32)
    mask[22:42, 25:40] = 1.0
    return mask


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_an_iterate_that_is_not_finite_is_never_the_best(bad):
    start = torch.ones(2, 5, 3)
    iterates = iter([start, start, 0.5 * start, torch.full_like(start, 0.25)])
    leaf = torch.zeros(1, requires_grad=True)

    def forward():
        moved = next(iterates).clone()
        if moved[0, 0, 0] == 0.25:
            moved[1, 2, 1] = bad
        return moved + 0.0 * leaf

    def objective(moved):
        return torch.where(torch.isfinite(moved), moved, 0.0).sum((1, 2))

    descent = descend(forward, objective, Adam([leaf], 0.1), 2)
    assert descent.best_step.tolist() == [2, 1]
    assert torch.isfinite(descent.best).all()
    assert np.isnan(descent.losses[2]).tolist() == [False, True]


def test_the_best_iterate_and_its_step_agree_wherever_an_interrupt_falls(monkeypatch):
    start, true_where = _clouds().detach(), torch.where
    best_steps = []
    for stop in range(1, 16):
        leaf, calls = start.clone().requires_grad_(), iter(range(1, 100))

        def interrupted(*arguments, calls=calls, stop=stop, **more):
            if next(calls) == stop:
                raise KeyboardInterrupt
            return true_where(*arguments, **more)

        with monkeypatch.context() as patched:
            patched.setattr(torch, "where", interrupted)
            iterates = []

            def forward(leaf=leaf, iterates=iterates):
                iterates.append(leaf.detach().clone())
                return leaf

            try:
                descent = descend(forward, lambda moved: moved.square().sum((1, 2)), Adam([leaf], 0.01), 5)
            except KeyboardInterrupt:
                continue
        assert descent.interrupted
        best_steps.append(int(descent.best_step[0]))
        # The first iterate is computed twice.
        torch.testing.assert_close(descent.best, iterates[best_steps[-1] + 1], rtol=0.0, atol=0.0)
    assert len(set(best_steps)) > 1


def test_a_network_whose_first_step_diverges_is_an_error():
    network = build_network(points=64)
    image = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0))
    config = RefineConfig("encoder", steps=5, learning_rate=1e4)
    with pytest.raises(TsoError, match="a smaller learning rate"):
        refine(None, _square(), config=config, network=network, image=image)


@pytest.mark.parametrize("where", ["behind the camera", "nowhere"])
def test_the_loss_of_a_view_without_visible_points_is_infinite(where):
    view = resample_view(View(_square(), Camera.canonical(64, 64)), 0.4, np.zeros(3), 1.0)
    points = _clouds(3).detach() - 0.5
    points[1] = points[1] + torch.tensor([0.0, 0.0, 9.0]) if where == "behind the camera" else torch.nan
    # Of the third cloud one point is visible.
    points[2, 1:] += torch.tensor([0.0, 0.0, 9.0])
    leaf = points.requires_grad_()
    loss = SilhouetteObjective([[view]] * 3, torch.tensor([5, 5, 5]), leaf)(leaf)
    assert torch.isfinite(loss).tolist() == [True, False, True]
    (slope,) = torch.autograd.grad(loss.sum(), leaf)
    assert torch.isfinite(slope[[0, 2]]).all()
    assert slope[0].abs().max() > 0.0


def test_the_paper_preset_is_adam_on_equation_7():
    """Eq. 7 by all pairs and in float64: cross-entropy of the silhouette and 1e6 times the Chamfer distance to the start."""
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (90, 3))
    # The settings are stated for a centred cloud with longest side 1.
    points = (points - (points.min(0) + points.max(0)) / 2.0) / np.ptp(points, axis=0).max()
    mask, camera = _square(), Camera.canonical(64, 64)
    initial = torch.tensor(points)
    moved = initial.clone().requires_grad_()
    optimiser = torch.optim.Adam([moved], lr=5e-4)
    K, R, t = (torch.tensor(part) for part in (camera.K, camera.R, camera.t))
    losses = []
    for step in range(51):
        plane = (moved @ R.T + t) @ K.T
        loss = oracles.bce(plane[:, :2] / plane[:, 2:], torch.tensor(mask).double(), 0.4)
        loss = loss + 1e6 * sum(oracles.chamfer(moved, initial))
        losses.append(loss.item())
        if step < 50:
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    result = refine(points, mask, camera, RefineConfig(preset="paper"))
    # The kernel ends at 1e-8, where only the nearest point attracts: half a thousandth of the loss here.
    np.testing.assert_allclose(result.losses, losses, rtol=2e-3)
    assert (result.steps, result.best_step) == (50, int(np.argmin(losses))) == (50, 50)
    # Adam normalises rounding errors of vanishing gradients to whole steps: single points differ, their mean does not.
    error, displacement = result.points - moved.detach().numpy(), moved.detach().numpy() - points
    assert np.square(error).mean() < 1e-3 * np.square(displacement).mean()


def test_reading_the_losses_rarely_as_on_a_gpu_changes_no_result(chair, monkeypatch):
    expected = refine(chair.points, chair.mask, chair.camera)
    monkeypatch.setattr(optimise, "whole_batches", lambda tensor: True)
    rarely = refine(chair.points, chair.mask, chair.camera)
    np.testing.assert_array_equal(rarely.points, expected.points)
    assert rarely.losses == expected.losses
