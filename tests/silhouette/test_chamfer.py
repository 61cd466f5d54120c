"""Chamfer distance between clouds, and to initial clouds."""

from __future__ import annotations

import pytest
import torch

from tests import oracles
from tso_cli.kernels import dispatch
from tso_cli.silhouette.chamfer import ChamferToInitial, chamfer


def test_chamfer_is_that_of_all_pairs_and_its_gradient_that_of_finite_differences():
    generator = torch.Generator().manual_seed(5)
    a = torch.rand(2, 30, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    b = torch.rand(2, 20, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    forward, backward = chamfer(a, b)
    for i in range(2):
        expected = oracles.chamfer(a[i], b[i])
        assert (forward[i].item(), backward[i].item()) == pytest.approx((expected[0].item(), expected[1].item()))
    assert torch.autograd.gradcheck(lambda x, y: sum(chamfer(x, y)), (a, b), eps=1e-7, atol=1e-6)


def test_the_regulariser_is_the_chamfer_distance_to_the_start():
    generator = torch.Generator().manual_seed(6)
    start = torch.rand(200, 3, generator=generator, dtype=torch.float64)
    for step in (0.0, 0.01, 0.2):
        moved = start + step * torch.randn(start.shape, generator=generator, dtype=torch.float64)
        assert ChamferToInitial(start[None])(moved[None]).item() == pytest.approx(
            sum(oracles.chamfer(moved, start)).item(), abs=1e-15
        )


def test_the_chamfer_of_a_batch_in_compiled_loops_is_that_of_each_cloud(monkeypatch):
    a, b = (torch.rand(4, count, 3, generator=torch.Generator().manual_seed(count)) for count in (60, 50))
    single = [torch.cat(parts) for parts in zip(*(chamfer(x[None], y[None]) for x, y in zip(a, b, strict=True)), strict=True)]
    monkeypatch.setattr(dispatch, "POINTS_WORTH_COMPILING", 0)
    torch.testing.assert_close(list(chamfer(a, b)), single)
