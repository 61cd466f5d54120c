"""The loss of the learned prior: what is left of a start's error."""

import numpy as np
import pytest
import torch

from tests.prior.common import pushing, some_weights
from tso_cli.prior.features import CELL, GRID, HALF
from tso_cli.train.prior.loss import _Frame, loss
from tso_cli.train.prior.masks import HALF_SIDE
from tso_cli.train.prior.starts import Batch

CELLS = 48


def batch_of(start, target, counterpart=None, radius=0.4):
    """Starts [B, M, 3] whose views, along z and along x, show a disc."""
    count = len(start)
    along_x = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]
    rotation = torch.tensor(np.array([[np.eye(3), along_x]] * count))
    centres = (torch.arange(CELLS, dtype=torch.float64) + 0.5) * 2.0 * HALF_SIDE / CELLS - HALF_SIDE
    x, y = torch.meshgrid(centres, centres, indexing="xy")
    distance = (torch.hypot(x, y) - radius).expand(count, 2, -1, -1).clone()
    unknown = torch.full_like(start, torch.nan)
    return Batch(
        start,
        target,
        unknown if counterpart is None else counterpart,
        rotation,
        torch.full((count, 2), 0.4, dtype=torch.float64),
        distance,
        torch.ones_like(distance),
    )


def tensors(weights):
    return {name: torch.from_numpy(array) for name, array in weights.items()}


def value(weights, batch, seed=0):
    return float(loss(tensors(weights), batch, torch.Generator().manual_seed(seed)))


NOTHING = pushing(0.0, 0.0, 0.0).weights


@pytest.fixture
def ball():
    """A cloud within .4 of the origin, normalised to longest side 1."""
    points = torch.randn(3, 512, 3, generator=torch.Generator().manual_seed(0)).double()
    points = points / points.norm(dim=2, keepdim=True)
    low, high = points.amin(1, keepdim=True), points.amax(1, keepdim=True)
    return (points - (low + high) / 2.0) / (high - low).amax(2, keepdim=True)


def test_a_network_that_moves_nothing_leaves_the_whole_error(ball):
    start = ball * torch.tensor([1.0, 0.5, 0.6])
    assert value(NOTHING, batch_of(start, ball)) == pytest.approx(1.0)


def test_a_start_that_arrives_at_its_counterparts_has_hardly_a_loss(ball):
    right = value(NOTHING, batch_of(ball, ball, ball))
    # What is left is three tenths of a Chamfer distance of 0.
    assert right < 1e-6
    away = value(NOTHING, batch_of(ball + torch.tensor([0.05, 0.0, 0.0]), ball, ball))
    assert away > 0.5


def test_a_step_toward_the_truth_lowers_the_loss_and_one_away_raises_it(ball):
    """The truth lies along y, which both views show as down. All is in the frame of the start."""
    truth = ball + torch.tensor([0.0, 0.1, 0.0])
    batch = batch_of(ball, truth)
    towards, nothing, away = (
        value(pushing(0.0, step, 0.0).weights, batch) for step in (0.05, 0.0, -0.05)
    )
    assert towards < 0.5 * nothing
    assert away > 1.5 * nothing


def test_what_is_not_known_of_single_points_does_not_count(ball):
    """Points that belong nowhere have no counterpart; the others are held to theirs."""
    counterpart = ball.clone()
    counterpart[:, :40] = torch.nan
    start = ball.clone()
    start[:, :40] = 0.3 * start[:, :40]
    assert value(NOTHING, batch_of(start, ball, counterpart)) < 0.4


def test_maps_are_sampled_anew_in_the_frame_of_the_start(ball):
    """The ball of radius .4 about the origin, for a start that is smaller and off to a side."""
    offset, scale = torch.tensor([0.04, -0.06, 0.05]), 0.9
    batch = batch_of(scale * ball + offset, ball)
    frame = _Frame.of(batch)
    torch.testing.assert_close(frame.centre, offset.expand(3, 3).double(), atol=0.02, rtol=0.0)
    torch.testing.assert_close(frame.scale, torch.full((3,), scale).double(), atol=0.02, rtol=0.0)
    for view, (across, depth) in enumerate((((0, 1), 2), ((2, 1), 0))):
        sign = 1.0 if view == 0 else -1.0
        far = 1.0 + 0.4 * sign * float(frame.centre[0, depth])
        closer = 0.4 * float(frame.scale[0]) / far
        assert float(frame.closeness[0, view]) == pytest.approx(closer, abs=1e-3)
        centres = (torch.arange(GRID, dtype=torch.float64) + 0.5) * CELL - HALF
        x, y = torch.meshgrid(centres, centres, indexing="xy")
        middle = frame.centre[0, list(across)]
        places = torch.stack([x, y], -1) * frame.scale[0] + middle
        expected = (places / far).norm(dim=-1) - 0.4
        found = frame.distance[0, view] * frame.scale[0] / far
        inner = expected.abs() < 0.3
        torch.testing.assert_close(found[inner], expected[inner], atol=0.01, rtol=0.0)


@pytest.mark.parametrize("known", [False, True])
def test_the_gradients_of_the_loss_are_those_of_finite_differences(ball, known):
    """Of a single start: none is first moved by the network, which has no gradient."""
    start, truth = (ball * torch.tensor([1.0, 0.6, 0.7]))[:1], ball[:1]
    batch = batch_of(start, truth, truth if known else None)
    weights = tensors(some_weights())

    def of(*changed):
        generator = torch.Generator().manual_seed(1)
        return loss({**weights, **dict(zip(names, changed, strict=True))}, batch, generator)

    names = ["moved.offset", "lattice.offset"]
    chosen = [weights[name].clone().requires_grad_() for name in names]
    # Small steps: nearest points change where the cloud moves.
    assert torch.autograd.gradcheck(of, chosen, eps=1e-7, atol=1e-5, rtol=1e-3, fast_mode=True)
