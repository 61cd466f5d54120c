"""The mask Chamfer loss as torch differentiates it."""

import numpy as np
import pytest
import torch

from tso_cli import Camera, InputError, MaskLoss, View

RNG = np.random.default_rng(4)


@pytest.fixture(scope="module")
def views():
    mask = np.zeros((48, 64), np.float32)
    mask[12:40, 20:50] = 1.0
    front = Camera.canonical(64, 48)
    return [View(mask, front), View(mask[:, ::-1].copy(), front)]


@pytest.fixture
def cloud():
    return torch.from_numpy(RNG.uniform(-0.4, 0.4, (60, 3)))


def test_the_gradient_is_that_of_finite_differences(views, cloud):
    assert torch.autograd.gradcheck(MaskLoss(views), cloud.requires_grad_(), eps=1e-7, atol=1e-4)


def test_a_batch_is_its_clouds_one_by_one(views):
    loss = MaskLoss(views[0])
    clouds = torch.from_numpy(RNG.uniform(-0.4, 0.4, (3, 60, 3))).requires_grad_()
    values = loss(clouds)
    (values * torch.tensor([1.0, 2.0, 3.0])).sum().backward()
    for number, cloud in enumerate(clouds.detach()):
        value, gradient = loss.value_and_gradient(cloud)
        assert values[number].item() == value
        np.testing.assert_allclose(clouds.grad[number], (number + 1.0) * gradient)


def test_descent_brings_a_cloud_onto_the_mask(views):
    loss = MaskLoss(views[0])
    points = torch.from_numpy(RNG.uniform(-0.1, 0.1, (200, 3))).float().requires_grad_()
    optimiser = torch.optim.Adam([points], lr=0.01)
    before = loss(points).item()
    for _ in range(60):
        optimiser.zero_grad()
        loss(points).backward()
        optimiser.step()
    assert loss(points).item() < 0.3 * before
    assert points.dtype == torch.float32


def test_a_cloud_of_another_shape_is_refused(views):
    with pytest.raises(InputError, match=r"shape \[5, 2\], expected \[N, 3\] or \[B, N, 3\]"):
        MaskLoss(views)(torch.zeros(5, 2))
