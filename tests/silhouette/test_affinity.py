"""The affinity loss in both forms, and the Chamfer distance between clouds."""

import numpy as np
import pytest
import torch

from tests import oracles
from tests.losses.common import by_autograd
from tests.scenes import block
from tso_cli.kernels.splat import splat
from tso_cli.silhouette.affinity import affinity
from tso_cli.silhouette.chamfer import chamfer

SIGMA_SQ = 0.4


def disc(size: int, radius: float) -> torch.Tensor:
    axis = torch.arange(size, dtype=torch.float64) - (size - 1) / 2.0
    return ((axis[:, None] ** 2 + axis[None] ** 2) < radius**2).double()


def _affinity(points: torch.Tensor, mask: torch.Tensor, form: str) -> torch.Tensor:
    valid = torch.ones(1, len(points), dtype=torch.bool)
    return affinity(
        splat(points[None], valid, *mask.shape, SIGMA_SQ), mask[None], points[None], valid, form
    )[0]


def test_points_outside_the_image_are_not_background():
    points = torch.tensor([[31.0, 31.0], [-20.0, 30.0]], dtype=torch.float64)
    with_outside, without = (
        _affinity(some, disc(64, 12.0), "points").item() for some in (points, points[:1])
    )
    assert with_outside == pytest.approx(without)


def test_the_printed_affinity_of_a_batch_is_that_of_each_image():
    generator = torch.Generator().manual_seed(17)
    points = torch.rand(4, 60, 2, generator=generator, dtype=torch.float64) * 18
    points[3] += 100.0  # no silhouette
    masks = (torch.rand(4, 18, 20, generator=generator) > 0.8).double()
    valid = torch.ones(4, 60, dtype=torch.bool)
    sums = splat(points, valid, 18, 20, SIGMA_SQ)
    values = affinity(sums, masks, points, valid, "paper")
    for i in range(3):
        assert values[i].item() == pytest.approx(
            oracles.affinity_paper(torch.tanh(sums[i]), masks[i]).item(), rel=1e-9
        )
    assert values[3].item() == pytest.approx(0.0, abs=1e-9)


def test_over_all_nonzero_pixels_the_printed_loss_of_an_uncovered_mask_would_nearly_vanish():
    """The rim of a Gaussian is not 0 and holds the least product, so only values over 0.5 count."""
    mask = torch.tensor(block(np.s_[20, 30], (40, 40))).double()
    point = torch.tensor([[[8.0, 20.0]]], dtype=torch.float64)
    silhouette = torch.tanh(splat(point, torch.ones(1, 1, dtype=torch.bool), 40, 40, SIGMA_SQ))[0]
    rows, columns = torch.nonzero(silhouette, as_tuple=True)
    products = ((rows - 20) ** 2 + (columns - 30) ** 2) * silhouette[rows, columns]
    assert oracles.affinity_paper(silhouette, mask) > 300.0 * (4096.0 / 1600.0) ** 2
    assert products.min() < 1e-3


def test_a_point_outside_the_mask_is_attracted_by_the_mask_and_a_covered_mask_costs_nothing():
    mask = disc(32, 6.0)
    covering = np.argwhere(mask.numpy())[:, ::-1].astype(float)
    value, gradient = by_autograd(lambda p: _affinity(p, mask, "points"), covering)
    assert value == 0.0
    assert not gradient.any()
    with_one = np.concatenate([covering, [[3.0, 16.0]]])
    _, gradient = by_autograd(lambda p: _affinity(p, mask, "points"), with_one)
    assert gradient[-1, 0] < 0.0
    assert not gradient[:-1].any()


@pytest.mark.parametrize("form", ["paper", "points"])
def test_the_gradient_of_the_affinity_loss_is_that_of_finite_differences(form):
    points = torch.tensor(
        [[5.2, 5.1], [9.3, 2.2], [1.1, 8.7]], dtype=torch.float64, requires_grad=True
    )
    mask = disc(12, 3.0)
    assert torch.autograd.gradcheck(
        lambda p: _affinity(p, mask, form), (points,), eps=1e-6, atol=1e-3, rtol=1e-4
    )


def test_chamfer_is_that_of_all_pairs_and_its_gradient_that_of_finite_differences():
    generator = torch.Generator().manual_seed(5)
    a, b = (
        torch.rand(2, n, 3, generator=generator, dtype=torch.float64, requires_grad=True)
        for n in (30, 20)
    )
    expected = [torch.stack(oracles.chamfer(*pair)) for pair in zip(a, b, strict=True)]
    torch.testing.assert_close(torch.stack(chamfer(a, b), 1), torch.stack(expected))
    assert torch.autograd.gradcheck(lambda x, y: sum(chamfer(x, y)), (a, b), eps=1e-7, atol=1e-6)
