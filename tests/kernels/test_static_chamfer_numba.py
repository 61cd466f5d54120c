"""The compiled Chamfer distance to initial clouds: values and gradients are exact, whatever moved how far."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import oracles
from tso_cli.kernels.static_chamfer_numba import StaticTrees

CLOUDS = {
    "random": lambda g: torch.rand(3, 400, 3, generator=g),
    "of one leaf": lambda g: torch.rand(3, 5, 3, generator=g),
    "of one point": lambda g: torch.rand(3, 1, 3, generator=g),
    "clustered": lambda g: torch.randn(3, 400, 3, generator=g) * 1e-3 + torch.randint(0, 3, (3, 400, 1), generator=g),
    "duplicated": lambda g: torch.rand(3, 40, 3, generator=g).repeat(1, 10, 1),
    "all in one place": lambda g: torch.rand(3, 1, 3, generator=g).expand(-1, 300, -1).contiguous(),
}


def _trees(start: torch.Tensor) -> StaticTrees:
    return StaticTrees(start, torch.full((len(start),), start.shape[1]))


def _iterates(start: torch.Tensor, step: float, generator: torch.Generator) -> list[torch.Tensor]:
    """The cloud on its way: each search starts from the neighbours of the previous one."""
    drift, noise = (torch.randn(start.shape, generator=generator, dtype=start.dtype) for _ in range(2))
    return [start + step * (factor * drift + 0.3 * noise) for factor in (0.0, 0.5, 1.0, -1.0)]


def _assert_exact(trees: StaticTrees, start: torch.Tensor, moved: torch.Tensor) -> None:
    expected = torch.stack([sum(oracles.chamfer(a, b)) for a, b in zip(moved, start, strict=True)])
    torch.testing.assert_close(trees.chamfer(moved), expected, atol=1e-30, rtol=1e-12)


@pytest.mark.parametrize("cloud", CLOUDS)
@pytest.mark.parametrize("step", [0.0, 1e-2, 0.3])
def test_the_distance_is_that_of_all_pairs_at_every_step(cloud, step):
    generator = torch.Generator().manual_seed(1)
    start = CLOUDS[cloud](generator).double()
    trees = _trees(start)
    for moved in _iterates(start, step, generator):
        _assert_exact(trees, start, moved)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-1, 1, width=32)] * 6), min_size=1, max_size=40), st.floats(0, 1))
def test_the_distance_is_that_of_all_pairs_whatever_moved(rows, step):
    both = torch.tensor([rows], dtype=torch.float64)
    start, moved = both[..., :3].contiguous(), both[..., :3] + step * both[..., 3:]
    _assert_exact(_trees(start), start, moved)


@pytest.mark.parametrize("cloud", CLOUDS)
def test_the_gradient_is_that_of_finite_differences(cloud):
    generator = torch.Generator().manual_seed(2)
    start = CLOUDS[cloud](generator).double()[:, :12]
    moved = start + 0.02 * torch.rand(start.shape, generator=generator, dtype=torch.float64)
    assert torch.autograd.gradcheck(_trees(start).chamfer, moved.requires_grad_(True), eps=1e-7, atol=1e-6)


def test_clouds_of_different_sizes_in_one_batch_are_those_alone():
    generator = torch.Generator().manual_seed(3)
    start = torch.rand(4, 100, 3, generator=generator)
    moved = (start + 0.05 * torch.randn(start.shape, generator=generator)).requires_grad_(True)
    counts = torch.tensor([100, 1, 37, 64])
    together = StaticTrees(start, counts).chamfer(moved)
    (gradient,) = torch.autograd.grad(together.sum(), moved)
    for i, count in enumerate(counts.tolist()):
        single = moved[i : i + 1, :count].detach().requires_grad_(True)
        alone = _trees(start[i : i + 1, :count].contiguous()).chamfer(single)
        assert alone.item() == together[i].item()
        assert torch.equal(gradient[i, :count], torch.autograd.grad(alone.sum(), single)[0][0])
        assert not gradient[i, count:].any()


def test_nothing_depends_on_the_number_of_threads(assert_same_on_threads):
    generator = torch.Generator().manual_seed(4)
    start = torch.rand(2, 2000, 3, generator=generator)
    moved = (start + 0.01 * torch.randn(start.shape, generator=generator)).requires_grad_(True)

    def value_and_gradient():
        value = _trees(start).chamfer(moved)
        return value.detach(), torch.autograd.grad(value.sum(), moved)[0]

    assert_same_on_threads(value_and_gradient)


def test_a_point_that_is_nan_makes_the_distance_nan():
    start = torch.rand(1, 50, 3, generator=torch.Generator().manual_seed(5))
    moved = start.clone()
    moved[0, 7] = float("nan")
    assert _trees(start).chamfer(moved).isnan().all()
