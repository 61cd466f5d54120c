"""Nearest neighbours are exact, whatever was proved without a search."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from tso_cli.kernels import nearest as nearest_module
from tso_cli.kernels import nearest_numba
from tso_cli.kernels.nearest import StaticNearest, nearest, nearest_both_ways, nearest_marked, nearest_points


def _distance(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return torch.cdist(a.double(), b.double(), compute_mode="donot_use_mm_for_euclid_dist").min(1).values


def _assert_nearest(queries: torch.Tensor, data: torch.Tensor, index: torch.Tensor) -> None:
    distance = (queries.double() - data[index].double()).norm(dim=1)
    torch.testing.assert_close(distance, _distance(queries, data), atol=1e-9, rtol=1e-6)


@pytest.fixture(params=["all pairs", "tree"])
def search(request, monkeypatch):
    """Clouds of any size searched in one way."""
    monkeypatch.setattr(nearest_module, "MULTIPLY_UP_TO", 1 << 30 if request.param == "all pairs" else 0)


@pytest.mark.usefixtures("search")
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("count", [1, 300, 3000])
def test_nearest_is_that_of_brute_force(dimension, count):
    generator = torch.Generator().manual_seed(0)
    queries = torch.randn(200, dimension, generator=generator)
    data = torch.randn(count, dimension, generator=generator)
    _assert_nearest(queries, data, nearest(queries, data))


@pytest.mark.parametrize("spread", [1.0, 1e-3, 1e-6, 1e-9])
def test_the_nearest_of_points_close_together_and_far_from_the_rest_is_exact(spread):
    generator = torch.Generator().manual_seed(2)
    places = torch.tensor([[3.0, -1.0, 2.0], [-5.0, 4.0, 0.5]], dtype=torch.float64)
    data, queries = (
        (places[:, None] + spread * torch.randn(2, n, 3, generator=generator, dtype=torch.float64)).flatten(0, 1)
        for n in (300, 40)
    )
    pairs = (queries[:, None] - data).square().sum(-1)
    index = nearest(queries, data)
    torch.testing.assert_close(pairs.gather(1, index[:, None])[:, 0], pairs.amin(1), atol=0.0, rtol=1e-7)


CLOUDS = {
    "random": lambda g: torch.rand(400, 3, generator=g),
    "clustered": lambda g: torch.randn(400, 3, generator=g) * 1e-3 + torch.randint(0, 3, (400, 1), generator=g),
    "duplicated": lambda g: torch.rand(40, 3, generator=g).repeat(10, 1),
}


@pytest.mark.usefixtures("search")
@pytest.mark.parametrize("cloud", CLOUDS)
@pytest.mark.parametrize("step", [0.0, 1e-2, 0.3])
def test_a_moved_copy_finds_its_neighbours_exactly(cloud, step):
    generator = torch.Generator().manual_seed(1)
    start = CLOUDS[cloud](generator)
    moved = start + step * torch.randn(start.shape, generator=generator)
    to_moved, to_start = StaticNearest(start)(moved)
    _assert_nearest(start, moved, to_moved)
    _assert_nearest(moved, start, to_start)


@pytest.mark.usefixtures("search")
@pytest.mark.parametrize("value", [torch.inf, -torch.inf, torch.nan])
def test_a_point_that_is_not_finite_makes_the_distance_so_and_raises_no_error(value):
    start = torch.rand(50, 3, generator=torch.Generator().manual_seed(4))
    nearest = StaticNearest(start)
    moved = start + 0.3
    moved[7, 1] = value
    to_moved, to_start = nearest(moved)
    assert not torch.isfinite((start - moved[to_moved]).square().sum() + (moved - start[to_start]).square().sum())
    torch.testing.assert_close(nearest(start), (nearest.identity, nearest.identity))


def _squared_distances(marked: torch.Tensor) -> torch.Tensor:
    """[M, H, W] to the nearest marked pixel; 0 where none is marked."""
    rows, columns = nearest_marked(marked)
    away = (rows - torch.arange(marked.shape[1]).unsqueeze(1)).square() + (columns - torch.arange(marked.shape[2])).square()
    return torch.where(rows >= 0, away, 0)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 40), (40, 1), (30, 47), (64, 64)])
@pytest.mark.parametrize("share", [0.003, 0.05, 0.6])
def test_the_nearest_marked_pixel_is_as_near_as_scipys(height, width, share):
    marked = torch.rand(4, height, width, generator=torch.Generator().manual_seed(height * width)) < share
    marked[0] = False
    for image, squared in zip(marked, _squared_distances(marked), strict=True):
        expected = distance_transform_edt(~image.numpy()) ** 2 if image.any() else np.zeros((height, width))
        np.testing.assert_allclose(squared, expected, atol=1e-9)


@pytest.mark.parametrize(("count", "height", "width"), [(1, 9, 9), (400, 32, 24), (60, 1, 200)])
def test_the_nearest_point_to_a_pixel_is_that_of_all_pairs(count, height, width):
    generator = torch.Generator().manual_seed(7)
    points = (torch.rand(3, count, 2, generator=generator, dtype=torch.float64) * 1.4 - 0.2) * max(height, width)
    valid = torch.rand(3, count, generator=generator) > 0.1
    valid[1:, 0], valid[0] = True, False
    pixels = torch.rand(3, height, width, generator=generator) < 0.7
    index = nearest_points(pixels, points, valid)
    assert torch.equal(index >= 0, pixels & valid.any(1)[:, None, None])
    for i in range(1, 3):
        rows, columns = torch.nonzero(pixels[i], as_tuple=True)
        centres = torch.stack([columns, rows], 1).double()
        pairs = (centres[:, None] - points[i][None]).square().sum(-1).masked_fill(~valid[i], torch.inf)
        torch.testing.assert_close(pairs.gather(1, index[i, rows, columns][:, None])[:, 0], pairs.min(1).values)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("first", "second"), [(1, 5), (300, 700), (257, 512)])
def test_neighbours_between_clouds_are_those_of_all_pairs(dtype, first, second):
    generator = torch.Generator().manual_seed(9)
    a, b = (torch.rand(3, n, 3, generator=generator, dtype=dtype) for n in (first, second))
    b[1] = b[1, 0]
    to_b, to_a = nearest_numba.nearest_both_ways(a, b)
    plain = nearest_both_ways(a, b)
    for x, y, *indices in ((a, b, to_b, plain[0]), (b, a, to_a, plain[1])):
        pairs = (x.double()[:, :, None] - y.double()[:, None]).square().sum(-1)
        least = pairs.min(-1).values
        for index in indices:
            torch.testing.assert_close(pairs.gather(2, index[:, :, None])[:, :, 0], least, atol=1e-12, rtol=1e-5)
    assert (to_b[1] == 0).all()


def test_neighbours_do_not_depend_on_the_number_of_threads(assert_same_on_threads):
    clouds = [torch.rand(9, count, 3, generator=torch.Generator().manual_seed(count)) for count in (42, 44)]
    assert_same_on_threads(lambda: nearest_numba.nearest_both_ways(*clouds))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-1, 1, width=32)] * 6), min_size=2, max_size=30), st.floats(0, 1))
def test_a_moved_copy_finds_its_neighbours_whatever_moved(rows, step):
    both = torch.tensor(rows)
    start, moved = both[:, :3], both[:, :3] + step * both[:, 3:]
    to_moved, to_start = StaticNearest(start)(moved)
    _assert_nearest(start, moved, to_moved)
    _assert_nearest(moved, start, to_start)


@pytest.mark.parametrize("pairs", [64, 8])
def test_queries_in_chunks_of_any_size_are_all_answered(pairs, monkeypatch):
    monkeypatch.setattr(nearest_module, "PAIRS_PER_PRODUCT", pairs)
    queries, data = torch.rand(2, 50, 3, generator=torch.Generator().manual_seed(3))
    _assert_nearest(queries, data, nearest(queries, data))
