"""Nearest neighbours of tensors are exact."""

import numpy as np
import pytest
import torch
from scipy.ndimage import distance_transform_edt

from tso_cli.kernels import tensors
from tso_cli.kernels.nearest import nearest_both_ways, nearest_marked


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 40), (40, 1), (30, 47), (64, 64)])
@pytest.mark.parametrize("share", [0.003, 0.05, 0.6])
def test_the_nearest_marked_pixel_is_as_near_as_scipys(height, width, share):
    marked = (
        torch.rand(4, height, width, generator=torch.Generator().manual_seed(height * width))
        < share
    )
    marked[0] = False
    for image, *nearest in zip(marked, *nearest_marked(marked), strict=True):
        distance = np.linalg.norm(np.stack(nearest) - np.mgrid[:height, :width], axis=0)
        if image.any():
            np.testing.assert_allclose(distance, distance_transform_edt(~image.numpy()), atol=1e-9)
        else:
            assert (nearest[0] < 0).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("first", "second"), [(1, 5), (300, 700), (257, 512)])
def test_neighbours_between_clouds_are_those_of_all_pairs(both_forms, dtype, first, second):
    generator = torch.Generator().manual_seed(9)
    a, b = (torch.rand(3, n, 3, generator=generator, dtype=dtype) for n in (first, second))
    b[1] = b[1, 0]
    for to_b, to_a in both_forms(lambda: nearest_both_ways(a, b)):
        for x, y, index in ((a, b, to_b), (b, a, to_a)):
            pairs = (x.double()[:, :, None] - y.double()[:, None]).square().sum(-1)
            chosen = pairs.gather(2, index[:, :, None])[:, :, 0]
            torch.testing.assert_close(chosen, pairs.min(-1).values, atol=1e-12, rtol=1e-5)
    assert (to_b[1] == 0).all()


def test_neighbours_do_not_depend_on_the_number_of_threads(assert_same_on_threads, monkeypatch):
    monkeypatch.setattr(tensors, "POINTS_WORTH_COMPILING", 0)
    clouds = [
        torch.rand(9, count, 3, generator=torch.Generator().manual_seed(count))
        for count in (42, 44)
    ]
    assert_same_on_threads(lambda: nearest_both_ways(*clouds))
