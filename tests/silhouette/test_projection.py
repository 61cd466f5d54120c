"""Eq. 1: world to pixels."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tso_cli.geometry.camera import Camera
from tso_cli.kernels import dispatch
from tso_cli.silhouette import projection
from tso_cli.silhouette.projection import CameraBatch, project, silhouette_of, silhouette_sums


def _camera(model: str = "perspective", seed: int = 0, width: int = 40, height: int = 30) -> Camera:
    rng = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    focal = 60.0 if model == "perspective" else 20.0
    K = np.array([[focal, 1.5, 19.0], [0.0, 1.1 * focal, 15.5], [0.0, 0.0, 1.0]])
    return Camera(K, rotation, rng.normal(size=3) * 0.1 + [0.0, 0.0, 3.0], width, height, model)


@pytest.fixture(params=["plain", "compiled"])
def form(request, monkeypatch):
    """In plain torch, and as compiled loops."""
    monkeypatch.setattr(dispatch, "POINTS_WORTH_COMPILING", 0 if request.param == "compiled" else 1 << 60)


@pytest.mark.usefixtures("form")
@pytest.mark.parametrize("model", ["perspective", "orthographic"])
def test_projection_is_K_times_R_p_plus_t(model):
    camera = _camera(model)
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (50, 3))
    tensor = torch.tensor(points)[None]
    pixels = project(tensor, CameraBatch.of([camera], tensor)).points_px[0, 0].numpy()
    seen = (camera.R @ points.T).T + camera.t
    if model == "perspective":
        seen = seen / seen[:, 2:]
    else:
        seen[:, 2] = 1.0
    np.testing.assert_allclose(pixels, (camera.K @ seen.T).T[:, :2], atol=1e-9)
    np.testing.assert_allclose(camera.project(points)[0], pixels, atol=1e-9)


@pytest.mark.usefixtures("form")
@pytest.mark.parametrize("model", ["perspective", "orthographic"])
def test_the_gradient_from_pixels_to_points_is_that_of_finite_differences(model):
    cameras = [_camera(model, seed) for seed in (0, 1)]
    points = torch.tensor(np.random.default_rng(2).uniform(-0.4, 0.4, (2, 6, 3)), requires_grad=True)
    batch = CameraBatch.of(cameras, points)
    weight = torch.randn(2, 2, 30, 40, generator=torch.Generator().manual_seed(3), dtype=torch.float64)

    def weighted(p):
        return torch.tanh(silhouette_sums(project(p, batch), batch, 0.8)).mul(weight).sum((2, 3))

    assert weighted(points).shape == (2, 2)
    assert torch.autograd.gradcheck(weighted, (points,), eps=1e-6, atol=1e-6)


@pytest.mark.usefixtures("form")
def test_points_at_or_behind_the_camera_are_marked_and_get_no_gradient():
    camera = Camera.canonical(64, 64)
    # the canonical camera stands at z = 2 and looks toward -z
    points = torch.tensor([[[0.0, 0.0, 0.0], [0.1, 0.1, 2.0], [0.1, 0.0, 5.0]]], requires_grad=True)
    batch = CameraBatch.of([camera], points)
    projected = project(points, batch)
    assert projected.valid.tolist() == [[[True, False, False]]]
    assert torch.isfinite(projected.points_px).all()
    silhouette_sums(projected, batch, 0.4).square().sum().backward()
    assert points.grad is not None
    assert torch.isfinite(points.grad).all()
    assert points.grad[0, 1:].abs().max() == 0.0


@pytest.mark.usefixtures("form")
def test_a_camera_that_moves_gets_its_gradient_too():
    points = torch.tensor(np.random.default_rng(4).uniform(-0.4, 0.4, (1, 5, 3)))
    batch = CameraBatch.of([_camera()], points)
    moving = [batch.K.requires_grad_(), batch.R.requires_grad_(), batch.t.requires_grad_()]

    def pixels(K, R, t):
        return project(points, CameraBatch(K, R, t, 40, 30)).points_px

    assert torch.autograd.gradcheck(pixels, moving)


def test_a_silhouette_on_a_coarser_grid_is_that_of_every_pixel():
    cloud = np.random.default_rng(5).uniform(-0.4, 0.4, (900, 3)) * [1.0, 0.6, 0.8]
    camera = Camera.canonical(600, 450)
    coarse = silhouette_of(cloud, camera)
    points = torch.tensor(cloud, dtype=torch.float32)[None]
    batch = CameraBatch.of([camera], points)
    sigma_sq = 0.4 * (600 / 64) ** 2
    exact = torch.tanh(silhouette_sums(project(points, batch), batch, sigma_sq, "exact"))[0, 0].numpy()
    assert coarse.shape == exact.shape == (450, 600)
    assert np.abs(coarse - exact).max() < 0.04
    assert ((coarse > 0.5) != (exact > 0.5)).mean() < 0.002


def test_a_silhouette_of_points_drawn_in_parts_is_that_of_all_at_once(monkeypatch):
    cloud, camera = np.random.default_rng(6).uniform(-0.4, 0.4, (300, 3)), _camera()
    whole = silhouette_of(cloud, camera)
    monkeypatch.setattr(projection, "POINTS_AT_ONCE", 130)
    np.testing.assert_allclose(silhouette_of(cloud, camera), whole, atol=1e-5)
    assert whole.max() > 0.1


@pytest.mark.usefixtures("form")
def test_each_cloud_of_a_batch_can_have_different_cameras():
    points = torch.tensor(np.random.default_rng(3).uniform(-0.4, 0.4, (3, 9, 3)))
    rows = [CameraBatch.of([_camera(seed=2 * i), _camera(seed=2 * i + 1)], points) for i in range(3)]
    K, R, t = (torch.stack([getattr(row, name) for row in rows]) for name in "KRt")
    together = project(points, CameraBatch(K, R, t, 40, 30)).points_px
    for i, row in enumerate(rows):
        torch.testing.assert_close(together[i], project(points[i : i + 1], row).points_px[0])


def test_the_silhouette_of_a_scan_four_million_units_away_keeps_its_pixels():
    cloud, camera = np.random.default_rng(4).uniform(-0.5, 0.5, (400, 3)), Camera.canonical(64, 64)
    shift = np.array([4e6, -3e6, 5e6])
    far = Camera(camera.K, camera.R, camera.t - camera.R @ shift, 64, 64)
    np.testing.assert_allclose(silhouette_of(cloud + shift, far), silhouette_of(cloud, camera), atol=1e-4)
