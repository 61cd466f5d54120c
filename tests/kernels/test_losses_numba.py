"""The compiled losses: values and gradients are those of the plain forms."""

from __future__ import annotations

import pytest
import torch

from tso_cli.kernels import dispatch as choice
from tso_cli.kernels.splat import splat
from tso_cli.silhouette import losses
from tso_cli.silhouette.losses import affinity, chamfer, silhouette_bce


def _clouds(seed: int, images: int, count: int, size: float, dtype: torch.dtype = torch.float32):
    generator = torch.Generator().manual_seed(seed)
    points = (torch.rand(images, count, 2, generator=generator, dtype=dtype) * 1.4 - 0.2) * size
    return points, torch.rand(images, count, generator=generator) > 0.1


def _masks(seed: int, images: int, height: int, width: int) -> torch.Tensor:
    """Blobs, of which the first is empty and the second everywhere."""
    noise = torch.rand(images, 1, 5, 6, generator=torch.Generator().manual_seed(seed))
    masks = (torch.nn.functional.interpolate(noise, (height, width), mode="bilinear") > 0.55).float().squeeze(1)
    masks[0], masks[1] = 0.0, 1.0
    return masks


LOSSES = {
    "cross-entropy": lambda s, m, k, p, v: silhouette_bce(s, m, p, v, 0.4, k),
    "cross-entropy, all known": lambda s, m, k, p, v: silhouette_bce(s, m, p, v, 0.4),
    "affinity of points": lambda s, m, k, p, v: affinity(s, m, p, v, "points"),
}


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("count", [3, 400])
def test_losses_and_their_gradients_are_those_of_the_plain_forms(monkeypatch, loss, soft, count):
    points, valid = _clouds(10, 6, count, 30.0, torch.float64)
    points[2] = points[2, 0]  # stacked
    points[3] = points[3] + 100.0  # all uncovered
    valid[4] = False
    masks = _masks(11, 6, 30, 33).double()
    if soft:
        masks = masks * torch.rand(masks.shape, generator=torch.Generator().manual_seed(12), dtype=torch.float64)
    known = torch.rand(masks.shape, generator=torch.Generator().manual_seed(13), dtype=torch.float64)
    known[known < 0.3] = 0.0
    if loss == "affinity of points":
        # Of equally near pixels either may pull; left of this edge one is nearest.
        masks[1:, :, :14] = 0.0
        masks[1:, :, 14:] = masks[1:, :, 14:].clamp(min=0.51)
    weight = torch.arange(1.0, 7.0, dtype=torch.float64)
    found = []
    for least in (1 << 60, 0):
        monkeypatch.setattr(choice, "POINTS_WORTH_COMPILING", least)
        leaf = points.clone().requires_grad_()
        sums = splat(leaf, valid, 30, 33, 0.4, "windowed")
        value = LOSSES[loss](sums, masks, known, leaf, valid)
        assert value.shape == (6,)
        (value * weight).sum().backward()
        # of stacked points any may be the nearest: what they get together counts
        leaf.grad[2] = leaf.grad[2].sum(0)
        found.append((value.detach(), leaf.grad))
    (plain, plain_gradient), (fast, fast_gradient) = found
    torch.testing.assert_close(fast, plain, rtol=1e-7, atol=1e-9)
    torch.testing.assert_close(fast_gradient, plain_gradient, rtol=1e-6, atol=1e-7 * plain_gradient.abs().max().item())


def test_a_stray_point_is_pulled_to_one_of_the_nearest_mask_pixels(monkeypatch):
    monkeypatch.setattr(choice, "POINTS_WORTH_COMPILING", 0)
    points, valid = _clouds(15, 5, 200, 33.0, torch.float64)
    inside = _masks(16, 5, 30, 33) > 0.5
    leaf = points.clone().requires_grad_()
    value = losses._stray_points(leaf, valid, inside)
    value.sum().backward()
    torch.testing.assert_close(value, leaf.grad.square().sum((1, 2)) / 4.0)
    pixel = points.round().long()
    seen = valid & (pixel >= 0).all(-1) & (pixel[..., 0] < 33) & (pixel[..., 1] < 30)
    for i, n in torch.cartesian_prod(torch.arange(5), torch.arange(200)).tolist():
        column, row = pixel[i, n].tolist()
        if i == 0 or not seen[i, n] or inside[i, row, column]:
            assert leaf.grad[i, n].abs().max() == 0.0
            continue
        goal = (points[i, n] - leaf.grad[i, n] / 2.0).round().long()
        assert inside[i, goal[1], goal[0]]
        rows, columns = torch.nonzero(inside[i], as_tuple=True)
        least = ((rows - row) ** 2 + (columns - column) ** 2).min()
        assert (goal - pixel[i, n]).square().sum() == least


@pytest.mark.parametrize("loss", ["cross-entropy", "affinity of points"])
def test_the_gradients_of_the_compiled_losses_are_those_of_finite_differences(monkeypatch, loss):
    monkeypatch.setattr(choice, "POINTS_WORTH_COMPILING", 0)
    points = torch.tensor([[[5.2, 5.1], [9.3, 2.2], [1.1, 8.7]]], dtype=torch.float64, requires_grad=True)
    valid = torch.ones(1, 3, dtype=torch.bool)
    mask = torch.zeros(1, 12, 12, dtype=torch.float64)
    mask[0, 3:7, 4:9] = 1.0
    mask[0, 8, 2] = 0.4

    def value(p):
        return LOSSES[loss](splat(p, valid, 12, 12, 0.4, "compiled"), mask, torch.ones_like(mask), p, valid)

    assert torch.autograd.gradcheck(value, (points,), eps=1e-6, atol=1e-3, rtol=1e-5)


def test_the_cross_entropy_is_that_of_the_plain_form_from_the_faintest_to_the_largest_sums():
    sums = torch.logspace(-30, 4, 500, dtype=torch.float64).view(1, 20, 25).requires_grad_()
    for mask in (torch.zeros(1, 20, 25), torch.ones(1, 20, 25), torch.full((1, 20, 25), 0.3)):
        found = []
        for compiled in (False, True):
            value = losses._cross_entropy(sums, losses.PixelWeights.of(mask.double()), compiled)
            found.append((value, torch.autograd.grad(value.sum(), sums)[0]))
        torch.testing.assert_close(*(value for value, _ in found), rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(*(gradient for _, gradient in found), rtol=1e-6, atol=1e-7)


def test_chamfer_of_a_batch_is_that_of_its_clouds_one_by_one(monkeypatch):
    generator = torch.Generator().manual_seed(14)
    a, b = torch.rand(4, 60, 3, generator=generator), torch.rand(4, 50, 3, generator=generator)
    single = [chamfer(x[None], y[None]) for x, y in zip(a, b, strict=True)]
    monkeypatch.setattr(choice, "POINTS_WORTH_COMPILING", 0)
    for batch, alone in zip(chamfer(a, b), zip(*single, strict=True), strict=True):
        torch.testing.assert_close(batch, torch.cat(alone))
