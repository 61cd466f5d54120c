"""The loss of the learned prior: what is left of a start's error."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.prior.common import pushing, some_weights
from tso_cli.prior.features import CELL, GRID, HALF
from tso_cli.prior.network import TROUBLES
from tso_cli.train.prior.frame import StartFrame
from tso_cli.train.prior.loss import loss
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
    zero, one = torch.zeros(count, 2).double(), torch.ones(count, 2).double()
    troubles = torch.zeros(count, 2, len(TROUBLES)).double()
    # Without counterparts it is another shape.
    troubles[..., TROUBLES.index("shape")] = float(counterpart is None)
    return Batch(
        start,
        target,
        unknown if counterpart is None else counterpart,
        torch.zeros(start.shape[:2]).double(),
        rotation,
        closeness=0.4 * one,
        zoom=one,
        shift=torch.zeros(count, 2, 2).double(),
        distance=distance,
        known=torch.ones_like(distance),
        foreign=torch.zeros_like(distance),
        hidden=torch.zeros_like(distance),
        depth=torch.full_like(distance, torch.nan),
        metric=zero,
        size=100.0 * one,
        troubles=troubles,
    )


def tensors(weights):
    return {name: torch.from_numpy(array) for name, array in weights.items()}


def value(weights, batch, seed=0):
    """How much of the error is left."""
    return float(loss(tensors(weights), batch, torch.Generator().manual_seed(seed))[0])


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
    frame = StartFrame.of(batch)
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


def test_a_floor_in_the_cloud_is_to_stay_and_counts_for_nothing_else(ball):
    start = ball.clone()
    start[:, :100] = torch.tensor([0.3, 0.5, 0.3])
    floor = torch.zeros(start.shape[:2]).double()
    floor[:, :100] = 1.0
    batch = replace(batch_of(start, ball, start), foreign_points=floor)
    # What is left is three tenths of the Chamfer distance to a ball with fewer points.
    assert value(NOTHING, batch) < 0.3
    # A floor that goes along with the object costs more than the object alone.
    off = replace(batch_of(start + torch.tensor([0.0, 0.05, 0.0]), ball), foreign_points=floor)
    alone = batch_of(off.start[:, 100:], ball)
    toward = pushing(0.0, -0.05, 0.0).weights
    assert value(toward, off) > value(toward, alone) + 0.1


def wall(depth, **changed):
    """A ball before a depth map that is a wall at ``depth`` in both views."""
    start = torch.rand(1, 512, 3, generator=torch.Generator().manual_seed(1)).double() - 0.5
    batch = batch_of(start, start)
    maps = torch.full_like(batch.distance, depth)
    return StartFrame.of(replace(batch, depth=maps, **changed))


def test_a_depth_map_is_seen_in_the_frame_of_the_start():
    frame = wall(-0.2, metric=torch.ones(1, 2).double())
    assert frame.views["measured"].min() == 1.0
    expected = (-0.2 - frame.centre[0, 2]) / frame.scale[0]
    found = frame.views["depth"][0, 0]
    # The frame is turned a little, so that the middle of the start is on the axis.
    torch.testing.assert_close(found, expected.expand_as(found), atol=0.02, rtol=0.0)


def test_a_map_that_is_not_metric_is_fitted_to_the_front_of_the_start():
    centres = (torch.arange(CELLS, dtype=torch.float64) + 0.5) * 2.0 * HALF_SIDE / CELLS - HALF_SIDE
    x, y = torch.meshgrid(centres, centres, indexing="xy")
    radius = 0.45
    sphere = torch.randn(1, 512, 3, generator=torch.Generator().manual_seed(0)).double()
    sphere = radius * sphere / sphere.norm(dim=2, keepdim=True)
    batch = batch_of(sphere, sphere)
    front = -(radius**2 - (x**2 + y**2)).clamp_min(0.0).sqrt()
    maps = torch.where(x.hypot(y) < 0.4, 7.0 + 3.0 * front, torch.nan).expand(1, 2, -1, -1).clone()
    frame = StartFrame.of(replace(batch, closeness=0.0 * batch.closeness, depth=maps))
    found, measured = frame.views["depth"][0, 0], frame.views["measured"][0, 0] > 0.0
    assert measured.sum() > 100
    expected = -((0.25 - (0.9 * radius * 0.0) ** 2) ** 0.5)
    assert float(found[measured].min()) == pytest.approx(expected, abs=0.06)
    upside_down = StartFrame.of(replace(batch, closeness=0.0 * batch.closeness, depth=-maps))
    assert not upside_down.views["measured"].any()


def test_what_is_said_of_cells_and_troubles_is_compared_with_what_is_the_case(ball):
    batch = batch_of(ball, ball, ball)
    foreign = (batch.distance < 0.0).double()
    troubles = batch.troubles.clone()
    troubles[..., TROUBLES.index("foreign")] = 1.0
    batch = replace(batch, foreign=foreign, troubles=troubles)

    def parts(foreign_cells, foreign_trouble):
        weights = {name: array.copy() for name, array in NOTHING.items()}
        weights["cells2.offset"][:] = [foreign_cells] * 4 + [-8.0] * 4
        weights["troubles.offset"][:] = -8.0
        weights["troubles.offset"][TROUBLES.index("foreign")] = foreign_trouble
        return loss(tensors(weights), batch, torch.Generator().manual_seed(0))

    right, wrong = parts(0.0, 8.0), parts(-8.0, -8.0)
    assert (right[2:] < 0.7 * wrong[2:]).all()


@pytest.mark.parametrize("known", [False, True])
def test_the_gradients_of_the_loss_are_those_of_finite_differences(ball, known):
    """Of a single start: none is first moved by the network, which has no gradient."""
    start, truth = (ball * torch.tensor([1.0, 0.6, 0.7]))[:1], ball[:1]
    batch = batch_of(start, truth, truth if known else None)
    weights = tensors(some_weights())

    def of(*changed):
        generator = torch.Generator().manual_seed(1)
        parts = loss({**weights, **dict(zip(names, changed, strict=True))}, batch, generator)
        return parts[[0, 2, 3]].sum()

    names = ["moved.offset", "lattice.offset", "cells2.offset", "troubles.offset"]
    chosen = [weights[name].clone().requires_grad_() for name in names]
    # Variances are judged by displacements that they do not change.
    # Small steps: nearest points change where the cloud moves.
    assert torch.autograd.gradcheck(of, chosen, eps=1e-7, atol=1e-5, rtol=1e-3, fast_mode=True)


def test_a_variance_is_right_where_the_likelihood_is_highest(ball):
    """A start that is off by .02 along each axis has a deviation of .02, whose logarithm is 0."""
    off = 0.02 * torch.randn(ball.shape, generator=torch.Generator().manual_seed(2)).double()
    batch = batch_of(ball, ball + off, ball + off)

    def variances(log_weight):
        weights = {name: array.copy() for name, array in NOTHING.items()}
        weights["moved.offset"][3:] = log_weight
        return float(loss(tensors(weights), batch, torch.Generator().manual_seed(0))[1])

    assert variances(0.0) < min(variances(-0.7), variances(0.7))
