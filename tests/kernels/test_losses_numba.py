"""The compiled losses: values and gradients are those of the plain forms."""

from functools import partial

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tso_cli.kernels import losses_numba, tensors
from tso_cli.kernels.splat import splat
from tso_cli.kernels.tensors import called
from tso_cli.kernels.window import NEGLIGIBLE
from tso_cli.silhouette import bce
from tso_cli.silhouette.affinity import affinity
from tso_cli.silhouette.bce import silhouette_bce


def _clouds(seed: int, images: int, count: int, size: float, dtype: torch.dtype = torch.float64):
    generator = torch.Generator().manual_seed(seed)
    points = (torch.rand(images, count, 2, generator=generator, dtype=dtype) * 1.4 - 0.2) * size
    return points, torch.rand(images, count, generator=generator) > 0.1


def _masks(seed: int, images: int, height: int, width: int) -> torch.Tensor:
    """Blobs; the first is empty and the second fills the image."""
    noise = torch.rand(images, 1, 5, 6, generator=torch.Generator().manual_seed(seed))
    masks = (
        (torch.nn.functional.interpolate(noise, (height, width), mode="bilinear") > 0.55)
        .double()
        .squeeze(1)
    )
    masks[0], masks[1] = 0.0, 1.0
    return masks


def _value_and_gradient(loss, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Of the loss [M], weighted differently in each image."""
    leaf = points.detach().clone().requires_grad_()
    value = loss(leaf)
    (value * torch.arange(1, len(value) + 1)).sum().backward()
    return value.detach(), leaf.grad


def _affinity(
    sums: torch.Tensor, masks: torch.Tensor, valid: torch.Tensor, points: torch.Tensor
) -> torch.Tensor:
    return affinity(sums, masks, points, valid)


def _cross_entropy(points: torch.Tensor, masks: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    return silhouette_bce(splat(points, valid, *masks.shape[1:], 0.4), masks, points, valid, 0.4)


LOSSES = {
    "cross-entropy": lambda leaf, masks, valid: _cross_entropy(leaf, masks, valid),
    "affinity": lambda leaf, masks, valid: affinity(
        splat(leaf, valid, 30, 33, 0.4, "exact"), masks, leaf, valid
    ),
}


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("count", [3, 400])
def test_losses_of_many_images_and_their_gradients_are_those_of_the_plain_forms(
    both_forms, loss, count
):
    points, valid = _clouds(10, 6, count, 30.0)
    points[2] = points[2, 0]  # stacked
    points[3] = points[3] + 100.0  # all uncovered
    valid[4] = False
    # Of equally near pixels either may attract; left of this edge one is nearest.
    masks = _masks(11, 6, 30, 33)
    masks[1:, :, :14], masks[1:, :, 14:] = 0.0, masks[1:, :, 14:].clamp(min=0.51)
    plain, fast = both_forms(
        lambda: _value_and_gradient(lambda leaf: LOSSES[loss](leaf, masks, valid), points)
    )
    # of stacked points any may be the nearest: only their sum counts
    for _, gradient in (plain, fast):
        gradient[2] = gradient[2].sum(0)
    torch.testing.assert_close(fast[0], plain[0], rtol=1e-7, atol=1e-9)
    torch.testing.assert_close(
        fast[1], plain[1], rtol=1e-6, atol=1e-7 * plain[1].abs().max().item()
    )


def test_losses_do_not_depend_on_the_number_of_threads_by_one_bit(
    assert_same_on_threads, monkeypatch
):
    monkeypatch.setattr(tensors, "POINTS_WORTH_COMPILING", 0)
    for images in (1, 5):
        points, valid = _clouds(images, images, 3000, 64.0, torch.float32)
        mask = _masks(6, 5, 150, 64)[-images:].float()
        assert_same_on_threads(
            partial(_value_and_gradient, partial(_cross_entropy, masks=mask, valid=valid), points)
        )
        sums = splat(points, valid, 150, 64, 0.4)
        assert_same_on_threads(
            partial(_value_and_gradient, partial(_affinity, sums, mask, valid), points)
        )


def _all_pairs(pixels, weight, points, valid):
    """`pixels_to_points` by all pairs; of points equally near, the first."""
    rows, columns = torch.meshgrid(
        torch.arange(pixels.shape[1]), torch.arange(pixels.shape[2]), indexing="ij"
    )
    centres = torch.stack([columns, rows], -1).view(-1, 1, 2)
    squared = (centres - points[:, None]).square().sum(-1).masked_fill(~valid[:, None], torch.inf)
    least = squared.gather(2, squared.detach().argmin(2)[:, :, None])[:, :, 0]
    used = pixels.flatten(1) & valid.any(1)[:, None]
    return torch.where(used, torch.where(used, least, 0.0) * weight.flatten(1) * 0.7, 0.0).sum(1)


def _nearest_both_ways(pixels, points, valid):
    """Value and gradient of the loops, and by all pairs."""
    weight = torch.rand(
        pixels.shape, generator=torch.Generator().manual_seed(9), dtype=torch.float64
    )
    value, gradient = called(losses_numba.pixels_to_points, pixels, weight, points, valid, 0.7)
    expected = _value_and_gradient(lambda leaf: _all_pairs(pixels, weight, leaf, valid), points)
    return (value, torch.arange(1, len(value) + 1)[:, None, None] * gradient), expected


@pytest.mark.parametrize(
    ("count", "height", "width"),
    [(1, 9, 9), (40, 64, 64), (800, 40, 30), (900, 10, 12), (60, 1, 200)],
)
def test_pixels_attract_the_nearest_of_all_points_and_of_equally_near_ones_the_first(
    count, height, width
):
    points, valid = _clouds(7, 5, count, float(max(height, width)))
    valid[1:, 0], valid[0] = True, False
    points[2] = points[2, 0]  # stacked
    points[3] = points[3] * 3.0 - width  # most of them beyond the image
    points[4] = points[4].round()
    pixels = torch.rand(5, height, width, generator=torch.Generator().manual_seed(8)) < 0.7
    for found, expected in zip(*_nearest_both_ways(pixels, points, valid), strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.floats(-30, 40), st.floats(-30, 40)), min_size=1, max_size=12))
def test_pixels_attract_the_nearest_of_any_few_points(rows):
    points = torch.tensor([rows], dtype=torch.float64)
    pixels, valid = (
        torch.ones(1, 9, 13, dtype=torch.bool),
        torch.ones(1, len(rows), dtype=torch.bool),
    )
    # If two points are equally near up to rounding, either may be found; the value is the same.
    (value, _), (expected, _) = _nearest_both_ways(pixels, points, valid)
    torch.testing.assert_close(value, expected, rtol=1e-9, atol=1e-9)


def test_the_cross_entropy_is_that_of_the_plain_form_from_the_faintest_to_the_largest_sums():
    sums = torch.logspace(-30, 4, 500, dtype=torch.float64).view(1, 20, 25).requires_grad_()
    for level in (0.0, 0.3, 1.0):
        mask = torch.full((1, 20, 25), level, dtype=torch.float64)
        plain, waiting = bce._cross_entropy(sums, mask, 1.0 - mask)
        fast, gradient, fast_waiting = called(
            losses_numba.cross_entropy, sums, mask, 1.0 - mask, NEGLIGIBLE
        )
        torch.testing.assert_close(fast, plain.detach(), rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(
            gradient, torch.autograd.grad(plain.sum(), sums)[0], rtol=1e-6, atol=1e-7
        )
        assert torch.equal(waiting, fast_waiting)
