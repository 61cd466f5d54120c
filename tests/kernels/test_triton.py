"""The GPU's kernels against the exact product and all pairs.

Without a GPU they run in Triton's interpreter.
"""

import importlib.util
import math
import os

import pytest
import torch

from tso_cli.kernels import nearest as nearest_module
from tso_cli.kernels import splat as splat_module
from tso_cli.kernels.nearest import nearest_both_ways, nearest_in_rows
from tso_cli.kernels.splat import splat
from tso_cli.silhouette.bce import silhouette_bce
from tso_cli.silhouette.chamfer import chamfer

ON_GPU = torch.cuda.is_available()
DEVICE = "cuda" if ON_GPU else "cpu"
WITHOUT = (
    "triton is not installed"
    + ("" if ON_GPU else " and no GPU is here")
    + ": its kernels were not run"
)
needs_triton = pytest.mark.skipif(importlib.util.find_spec("triton") is None, reason=WITHOUT)
if not ON_GPU:
    # Read when triton is imported, which parts of torch do: before any test runs.
    os.environ["TRITON_INTERPRET"] = "1"


@pytest.fixture
def triton_kernels(monkeypatch):
    """The Triton kernels for tensors on DEVICE, which are interpreted where that is the CPU."""
    for module in (splat_module, nearest_module):
        monkeypatch.setattr(module, "triton_runs", lambda points: points.dtype == torch.float32)


@pytest.fixture(params=["torch", pytest.param("triton", marks=needs_triton)])
def in_rows(request, monkeypatch):
    """Both ways to compare all pairs of a batch."""
    if request.param == "triton":
        request.getfixturevalue("triton_kernels")
    else:
        monkeypatch.setattr(nearest_module, "triton_runs", lambda points: False)
        monkeypatch.setattr(nearest_module, "PAIRS_PER_CHUNK", 4000)


def _random(seed: int, *shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed)).to(DEVICE)


def _sums_and_gradient(
    points: torch.Tensor, valid: torch.Tensor, height: int, width: int, sigma_sq: float, kernel: str
):
    """In float64 by the exact product, else in float32."""
    leaf = (points.double() if kernel == "exact" else points).clone().requires_grad_()
    sums = splat(leaf, valid, height, width, sigma_sq, kernel)
    weight = _random(1, len(points), height, width).to(sums) - 0.5
    (torch.tanh(sums) * weight).sum().backward()
    assert leaf.grad is not None
    return sums.detach().double(), leaf.grad.double()


@needs_triton
@pytest.mark.parametrize(
    ("count", "height", "width", "sigma_sq"),
    [
        (300, 40, 56, 0.4),
        (70, 24, 33, 0.05),
        (100, 30, 20, 6.4),
        (20, 9, 140, 160.0),
        (1, 1, 1, 0.4),
        (9, 1, 7, 0.01),
    ],
)
def test_sums_and_gradients_are_those_of_the_exact_product(
    count, height, width, sigma_sq, triton_kernels
):
    size = torch.tensor([width, height], device=DEVICE)
    points = (_random(0, 3, count, 2) * 1.6 - 0.3) * size
    points[:, 0] = torch.tensor([[0.5, 0.5], [0.0, 0.0], [1.5, 0.0]], device=DEVICE)
    valid = _random(2, 3, count) < 0.9
    exact, exact_gradient = _sums_and_gradient(points, valid, height, width, sigma_sq, "exact")
    sums, gradient = _sums_and_gradient(points, valid, height, width, sigma_sq, "triton")
    assert (exact - sums).abs().max() <= 1e-5 * exact.abs().max()
    assert (exact_gradient - gradient).abs().max() <= 1e-5 * exact_gradient.abs().max() + 1e-7
    assert (gradient[~valid] == 0.0).all()


@needs_triton
def test_points_that_are_not_finite_or_far_away_add_nothing_and_get_no_gradient(triton_kernels):
    lost = [
        [math.nan, 3.0],
        [3.0, math.nan],
        [math.inf, 2.0],
        [1e30, 3.0],
        [-1e12, 4.0],
        [3.0, 3e9],
        [3.0, -4e9],
        [-9.0, 3.0],
    ]
    points = torch.tensor([[*lost, [2.2, 2.1]]], device=DEVICE)
    valid = torch.ones(points.shape[:2], dtype=torch.bool, device=DEVICE)
    sums, gradient = _sums_and_gradient(points, valid, 6, 7, 0.4, "triton")
    torch.testing.assert_close(
        sums,
        splat(points[:, -1:].double(), valid[:, -1:], 6, 7, 0.4, "exact"),
        atol=1e-6,
        rtol=1e-5,
    )
    assert (gradient[:, :-1] == 0.0).all()
    assert gradient[0, -1].abs().min() > 0.0


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize(("queries", "data"), [(1, 1), (5, 200), (150, 64), (65, 129)])
def test_the_nearest_point_of_each_row_is_that_of_all_pairs(queries, data, dimensions, in_rows):
    queried, points = _random(3, 4, queries, dimensions), _random(4, 4, data, dimensions)
    valid, active = _random(5, 4, data) < 0.7, _random(6, 4, queries) < 0.6
    valid[:, 0] = True
    valid[1], active[2] = False, False
    points[3] = points[3, 0]
    index = nearest_in_rows(queried, points, valid, active)
    pairs = (
        (queried.double()[:, :, None] - points.double()[:, None])
        .square()
        .sum(-1)
        .masked_fill(~valid[:, None], math.inf)
    )
    assert torch.equal(index >= 0, active & valid.any(1)[:, None])
    squared = pairs.gather(2, index.clamp_min(0)[:, :, None])[:, :, 0]
    torch.testing.assert_close(
        squared[index >= 0], pairs.min(2).values[index >= 0], atol=1e-12, rtol=1e-5
    )
    assert (index[3][index[3] >= 0] == 0).all()


def test_nan_and_infinite_points_are_no_neighbours_and_have_none(in_rows):
    data = torch.tensor(
        [[[math.nan, 0.0], [math.inf, 0.0], [5.0, 5.0]], [[math.nan] * 2] * 3], device=DEVICE
    )
    queries = torch.tensor([[0.0, 0.0], [math.nan, 1.0]], device=DEVICE).expand(2, 2, 2)
    assert nearest_in_rows(queries, data).tolist() == [[2, -1], [-1, -1]]
    for index in nearest_both_ways(data, queries):
        assert index.min() >= 0


def test_losses_of_whole_batches_are_those_of_single_clouds(in_rows, monkeypatch):
    clouds = _random(12, 3, 60, 3), _random(13, 3, 40, 3), _random(14, 3, 50, 2) * 16 + 3
    others = (
        _random(15, 3, 50) < 0.9,
        _random(16, 3, 24, 24),
        torch.tensor([1.0, 2.0, 3.0], device=DEVICE),
    )
    whole = _losses_and_gradients(*clouds, *others)
    monkeypatch.undo()
    cpu = (tensor.detach().cpu() for tensor in (*clouds, *others))
    for mine, theirs in zip(whole, _losses_and_gradients(*cpu), strict=True):
        torch.testing.assert_close(
            mine.cpu(), theirs, atol=1e-5 * theirs.abs().max().item(), rtol=1e-5
        )


def _losses_and_gradients(cloud, target, points, valid, mask, weight):
    """Chamfer distance, cross-entropy of the mask, and gradients of their weighted sum."""
    cloud, points = cloud.requires_grad_(), points.requires_grad_()
    sums = splat(points, valid, *mask.shape[1:], 0.4)
    values = sum(chamfer(cloud, target)), silhouette_bce(sums, mask, points, valid, 0.4)
    return *(value.detach() for value in values), *torch.autograd.grad(
        (sum(values) * weight).sum(), [cloud, points]
    )
