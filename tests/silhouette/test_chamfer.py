"""Chamfer distance between clouds."""

import pytest
import torch

from tests import oracles
from tso_cli.silhouette.chamfer import chamfer


def test_chamfer_is_that_of_all_pairs_and_its_gradient_that_of_finite_differences():
    generator = torch.Generator().manual_seed(5)
    a = torch.rand(2, 30, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    b = torch.rand(2, 20, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    forward, backward = chamfer(a, b)
    for i in range(2):
        expected = oracles.chamfer(a[i], b[i])
        assert (forward[i].item(), backward[i].item()) == pytest.approx((expected[0].item(), expected[1].item()))
    assert torch.autograd.gradcheck(lambda x, y: sum(chamfer(x, y)), (a, b), eps=1e-7, atol=1e-6)
