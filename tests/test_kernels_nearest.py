"""Nearest neighbours are exact, whatever was proved without a search."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tso_cli.kernels.nearest import StaticNearest, nearest


def _distance(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return torch.cdist(a.double(), b.double(), compute_mode="donot_use_mm_for_euclid_dist").min(1).values


def _assert_nearest(queries: torch.Tensor, data: torch.Tensor, index: torch.Tensor) -> None:
    found = (queries.double() - data[index].double()).norm(dim=1)
    torch.testing.assert_close(found, _distance(queries, data), atol=1e-9, rtol=1e-6)


@pytest.mark.parametrize("dimension", [2, 3])
def test_nearest_is_that_of_brute_force(dimension):
    generator = torch.Generator().manual_seed(0)
    queries = torch.randn(200, dimension, generator=generator)
    data = torch.randn(300, dimension, generator=generator)
    _assert_nearest(queries, data, nearest(queries, data))


CLOUDS = {
    "random": lambda g: torch.rand(400, 3, generator=g),
    "clustered": lambda g: torch.randn(400, 3, generator=g) * 1e-3 + torch.randint(0, 3, (400, 1), generator=g),
    "duplicated": lambda g: torch.rand(40, 3, generator=g).repeat(10, 1),
    "on a line": lambda g: torch.linspace(0, 1, 400)[:, None] * torch.tensor([[1.0, 0.0, 0.0]]),
}


@pytest.mark.parametrize("cloud", CLOUDS)
@pytest.mark.parametrize("step", [0.0, 1e-4, 1e-2, 0.3])
def test_a_moved_copy_finds_its_neighbours_exactly(cloud, step):
    generator = torch.Generator().manual_seed(1)
    start = CLOUDS[cloud](generator)
    moved = start + step * torch.randn(start.shape, generator=generator)
    to_moved, to_start = StaticNearest(start)(moved)
    _assert_nearest(start, moved, to_moved)
    _assert_nearest(moved, start, to_start)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-1, 1, width=32)] * 6), min_size=2, max_size=30), st.floats(0, 1))
def test_a_moved_copy_finds_its_neighbours_whatever_moved(rows, step):
    both = torch.tensor(rows)
    start, moved = both[:, :3], both[:, :3] + step * both[:, 3:]
    to_moved, to_start = StaticNearest(start)(moved)
    _assert_nearest(start, moved, to_moved)
    _assert_nearest(moved, start, to_start)
