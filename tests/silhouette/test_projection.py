"""Eq. 1 to 3 in torch, batched over clouds and views."""

import numpy as np
import torch

from tests.losses.scenes import HEIGHT, WIDTH, camera_of
from tso_cli.geometry.camera import Camera
from tso_cli.losses import projection
from tso_cli.silhouette.projection import CameraBatch, project, silhouette_sums


def batch_of(*cameras: Camera) -> CameraBatch:
    K, R, t = (
        torch.tensor(np.stack([getattr(camera, name) for camera in cameras]))
        for name in ("K", "R", "t")
    )
    return CameraBatch(K, R, t, cameras[0].width, cameras[0].height)


def test_pixels_and_valid_points_are_those_of_numpy():
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (50, 3)) * [1.0, 1.0, 9.0]
    projected = project(torch.tensor(points)[None], batch_of(camera_of()))
    expected = projection.project_differentiably(points, camera_of())
    np.testing.assert_allclose(projected.points_px[0, 0].numpy(), expected.points_px, atol=1e-9)
    np.testing.assert_array_equal(projected.valid[0, 0].numpy(), expected.valid)
    assert not expected.valid.all()


def test_the_gradient_from_pixels_to_points_is_that_of_finite_differences():
    points = torch.tensor(
        np.random.default_rng(2).uniform(-0.4, 0.4, (2, 6, 3)), requires_grad=True
    )
    first, second = camera_of(), Camera.canonical(WIDTH, HEIGHT)
    batch = batch_of(first, Camera(first.K, second.R, second.t, WIDTH, HEIGHT))
    weight = torch.randn(
        2, 2, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(3), dtype=torch.float64
    )

    def weighted(p):
        return torch.tanh(silhouette_sums(project(p, batch), batch, 0.8)).mul(weight).sum((2, 3))

    assert torch.autograd.gradcheck(weighted, (points,), eps=1e-6, atol=1e-6)


def test_points_at_or_behind_the_camera_are_marked_and_get_no_gradient():
    # The canonical camera stands at z = 2 and looks toward -z.
    points = torch.tensor(
        [[[0.0, 0.0, 0.0], [0.1, 0.1, 2.0], [0.1, 0.0, 5.0]]],
        dtype=torch.float64,
        requires_grad=True,
    )
    batch = batch_of(Camera.canonical(64, 64))
    projected = project(points, batch)
    assert projected.valid.tolist() == [[[True, False, False]]]
    silhouette_sums(projected, batch, 0.4).square().sum().backward()
    assert torch.isfinite(points.grad).all()
    assert not points.grad[0, 1:].any()


def test_a_camera_that_moves_gets_its_gradient_too():
    points = torch.tensor(np.random.default_rng(4).uniform(-0.4, 0.4, (1, 5, 3)))
    batch = batch_of(camera_of())
    moving = [batch.K.requires_grad_(), batch.R.requires_grad_(), batch.t.requires_grad_()]
    assert torch.autograd.gradcheck(
        lambda K, R, t: project(points, CameraBatch(K, R, t, 40, 30)).points_px, moving
    )
