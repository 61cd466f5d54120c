"""The compiled Chamfer distance to clouds that stay: neighbours, values and gradients are exact, whatever moved how far."""

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
    "on a line": lambda g: torch.linspace(0, 1, 400)[None, :, None] * torch.eye(3)[:, None],
    "all in one place": lambda g: torch.rand(3, 1, 3, generator=g).expand(-1, 300, -1).contiguous(),
}


def _assert_nearest(queries: torch.Tensor, data: torch.Tensor, index: torch.Tensor) -> None:
    """In double precision, to the last bits: the same distances as brute force."""
    squared = (queries.double()[:, None] - data.double()[None]).square().sum(-1)
    torch.testing.assert_close(squared.gather(1, index[:, None])[:, 0], squared.min(1).values, atol=0.0, rtol=1e-14)


def _moves(start: torch.Tensor, step: float, generator: torch.Generator) -> list[torch.Tensor]:
    """The cloud on its way: each call of the trees begins with what the one before it found."""
    drift = torch.randn(start.shape, generator=generator, dtype=start.dtype)
    return [
        start + step * (share * drift + 0.3 * torch.randn(start.shape, generator=generator)) for share in (0.0, 0.5, 1.0, -1.0)
    ]


@pytest.mark.parametrize("cloud", CLOUDS)
@pytest.mark.parametrize("step", [0.0, 1e-4, 1e-2, 0.3])
def test_moved_copies_find_their_neighbours_exactly_at_every_step(cloud, step):
    generator = torch.Generator().manual_seed(1)
    start = CLOUDS[cloud](generator)
    trees = StaticTrees(start)
    for moved in _moves(start, step, generator):
        to_moved, to_start = trees.nearest(moved)
        for i in range(len(start)):
            _assert_nearest(start[i], moved[i], to_moved[i])
            _assert_nearest(moved[i], start[i], to_start[i])


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-1, 1, width=32)] * 6), min_size=1, max_size=40), st.floats(0, 1))
def test_a_moved_copy_finds_its_neighbours_whatever_moved(rows, step):
    both = torch.tensor(rows)
    start, moved = both[:, :3], both[:, :3] + step * both[:, 3:]
    to_moved, to_start = StaticTrees(start[None]).nearest(moved[None])
    _assert_nearest(start, moved, to_moved[0])
    _assert_nearest(moved, start, to_start[0])


@pytest.mark.parametrize("cloud", CLOUDS)
def test_the_distance_is_that_of_all_pairs_and_its_gradient_that_of_finite_differences(cloud):
    generator = torch.Generator().manual_seed(2)
    start = CLOUDS[cloud](generator).double()[:, :30]
    trees = StaticTrees(start)
    for moved in _moves(start, 0.02, generator):
        expected = torch.stack([sum(oracles.chamfer(a, b)) for a, b in zip(moved, start, strict=True)])
        torch.testing.assert_close(trees.chamfer(moved), expected, atol=1e-15, rtol=1e-12)
    moved = start + 0.02 * torch.rand(start.shape, generator=generator, dtype=torch.float64)
    assert torch.autograd.gradcheck(trees.chamfer, moved.requires_grad_(True), eps=1e-7, atol=1e-6)


def test_clouds_of_different_sizes_in_one_batch_are_those_alone():
    generator = torch.Generator().manual_seed(3)
    start = torch.rand(4, 100, 3, generator=generator)
    moved = (start + 0.05 * torch.randn(start.shape, generator=generator)).requires_grad_(True)
    counts = torch.tensor([100, 1, 37, 64])
    together = StaticTrees(start, counts).chamfer(moved)
    (slope,) = torch.autograd.grad(together.sum(), moved)
    for i, count in enumerate(counts.tolist()):
        own = moved[i : i + 1, :count].detach().requires_grad_(True)
        alone = StaticTrees(start[i : i + 1, :count].contiguous()).chamfer(own)
        assert alone.item() == together[i].item()
        torch.testing.assert_close(slope[i, :count], torch.autograd.grad(alone.sum(), own)[0][0], atol=0.0, rtol=0.0)
        assert not slope[i, count:].any()


def test_nothing_depends_on_the_number_of_threads():
    generator = torch.Generator().manual_seed(4)
    start = torch.rand(2, 9000, 3, generator=generator)
    moved = (start + 0.01 * torch.randn(start.shape, generator=generator)).requires_grad_(True)
    threads, found = torch.get_num_threads(), []
    for count in (1, 3):
        torch.set_num_threads(count)
        try:
            value = StaticTrees(start).chamfer(moved)
            found.append((value.detach(), torch.autograd.grad(value.sum(), moved)[0]))
        finally:
            torch.set_num_threads(threads)
    for one, other in zip(*found, strict=True):
        assert torch.equal(one, other)


def test_points_that_are_no_numbers_make_a_distance_that_is_none():
    start = torch.rand(1, 50, 3, generator=torch.Generator().manual_seed(5))
    moved = start.clone()
    moved[0, 7] = float("nan")
    assert StaticTrees(start).chamfer(moved).isnan().all()
