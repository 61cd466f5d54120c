"""Nearest neighbours and evenly spread subsets, in every form."""

import numpy as np
import pytest

from tso_cli.losses import nearest as nearest_module
from tso_cli.losses.nearest import nearest, nearest_few


@pytest.fixture(params=["at once", "in parts", "tree"])
def search(request, monkeypatch):
    """Runs a search in one of its forms."""
    if request.param == "in parts":
        monkeypatch.setattr(nearest_module, "PAIRS_AT_ONCE", 1000)
    if request.param == "tree":
        monkeypatch.setattr(nearest_module, "MOST_PAIRS", 0)
    return lambda function, *arguments: function(*arguments)


def _pairs(queries: np.ndarray, data: np.ndarray) -> np.ndarray:
    return np.square(queries[:, None] - data).sum(2)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("count", [1, 5, 700])
def test_neighbours_are_those_of_all_pairs_by_increasing_distance(search, dimension, count):
    rng = np.random.default_rng(0)
    queries, data = (
        rng.normal(size=(150, dimension)) + 100.0,
        rng.normal(size=(count, dimension)) + 100.0,
    )
    pairs = _pairs(queries, data)
    few = search(nearest_few, queries, data, min(count, 7))
    for index, expected in ((search(nearest, queries, data)[:, None], 1), (few, min(count, 7))):
        chosen = np.take_along_axis(pairs, index, 1)
        np.testing.assert_allclose(chosen, np.sort(pairs, 1)[:, :expected], atol=1e-9)
        assert all(len(set(row)) == expected for row in index.tolist())


def test_of_points_equally_near_the_first_is_chosen():
    data = np.random.default_rng(1).normal(size=(40, 3)).repeat(3, 0)
    assert nearest(data, data).tolist() == (np.arange(120) // 3 * 3).tolist()
    assert nearest(np.empty((0, 3)), data).shape == (0,)


@pytest.mark.parametrize("spread", [1.0, 1e-3, 1e-6])
def test_neighbours_close_together_and_far_from_the_rest_are_exact(search, spread):
    rng = np.random.default_rng(2)
    places = np.array([[3.0, -1.0, 2.0], [-5.0, 4.0, 0.5]])
    data, queries = (
        (places[:, None] + spread * rng.normal(size=(2, n, 3))).reshape(-1, 3) for n in (300, 40)
    )
    pairs = _pairs(queries, data)
    chosen = pairs[np.arange(80), search(nearest, queries, data)]
    # The matrix product loses digits of distances that are tiny relative to the cloud.
    np.testing.assert_allclose(chosen, pairs.min(1), atol=1e-13, rtol=1e-9)
