"""Nearest neighbours of tensors are exact."""

import numpy as np
import pytest
import torch
from scipy.ndimage import distance_transform_edt

from tso_cli.kernels import nearest
from tso_cli.kernels.nearest import nearest_both_ways


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 40), (40, 1), (30, 47), (64, 64)])
@pytest.mark.parametrize("share", [0.003, 0.05, 0.6])
@pytest.mark.parametrize("form", ["nearest_marked", "_nearest_marked"])
def test_the_nearest_marked_pixel_is_as_near_as_scipys(height, width, share, form):
    marked = (
        torch.rand(4, height, width, generator=torch.Generator().manual_seed(height * width))
        < share
    )
    marked[0] = False
    for image, *place in zip(marked, *getattr(nearest, form)(marked), strict=True):
        distance = np.linalg.norm(np.stack(place) - np.mgrid[:height, :width], axis=0)
        if image.any():
            np.testing.assert_allclose(distance, distance_transform_edt(~image.numpy()), atol=1e-9)
        else:
            assert (place[0] < 0).all()


@pytest.fixture(params=["_by_trees", "_by_all_pairs"])
def form(request, monkeypatch):
    """As on the CPU, and as on a GPU without Triton."""
    monkeypatch.setattr(nearest, "_by_trees", getattr(nearest, request.param))


@pytest.mark.usefixtures("form")
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("first", "second"), [(1, 5), (300, 700), (257, 512)])
def test_neighbours_between_clouds_are_those_of_all_pairs(dtype, first, second):
    generator = torch.Generator().manual_seed(9)
    a, b = (torch.rand(3, n, 3, generator=generator, dtype=dtype) for n in (first, second))
    b[1] = b[1, 0]
    to_b, to_a = nearest_both_ways(a, b)
    for x, y, index in ((a, b, to_b), (b, a, to_a)):
        pairs = (x.double()[:, :, None] - y.double()[:, None]).square().sum(-1)
        chosen = pairs.gather(2, index[:, :, None])[:, :, 0]
        torch.testing.assert_close(chosen, pairs.min(-1).values, atol=1e-12, rtol=1e-5)


@pytest.mark.usefixtures("form")
def test_what_is_not_valid_not_active_or_not_finite_has_no_neighbour():
    queries = torch.tensor([[[0.0, 0.0], [2.0, 0.0], [torch.nan, 0.0]]] * 2)
    data = torch.tensor([[[torch.nan, 0.0], [1.9, 0.0], [0.5, 0.0]]] * 2)
    valid = torch.tensor([[True, False, True], [False, False, False]])
    active = torch.tensor([[True, True, True], [True, False, True]])
    index = nearest.nearest_in_rows(queries, data, valid, active)
    assert index.tolist() == [[2, 2, -1], [-1, -1, -1]]
    assert nearest.nearest_in_rows(queries, data).tolist() == [[2, 1, -1]] * 2
    alone = nearest.nearest_in_rows(queries, data, active=active)
    assert alone.tolist() == [[2, 1, -1], [2, -1, -1]]
