"""Eq. 1: world to pixels, and gradients back."""

import numpy as np

from tso_cli.geometry.camera import Camera
from tso_cli.losses.projection import pixels_under, project_differentiably

from .common import MODELS, assert_gradient
from .scenes import camera_of, points_at, scattered


@MODELS
def test_projection_is_K_times_R_p_plus_t(model):
    camera, pixels = camera_of(model), scattered()
    points = points_at(pixels, camera, np.linspace(1.0, 3.0, len(pixels)))
    projected = project_differentiably(points, camera)
    np.testing.assert_allclose(projected.points_px, pixels, atol=1e-12)
    np.testing.assert_allclose(camera.project(points)[0], pixels, atol=1e-12)
    assert projected.valid.all()


@MODELS
def test_the_gradient_by_points_is_that_of_finite_differences(model):
    points, camera = np.random.default_rng(2).uniform(-0.4, 0.4, (6, 3)), camera_of(model)
    points[0] = -10.0 * camera.R[2]  # behind a perspective camera
    weight = np.random.default_rng(3).normal(size=(6, 2))

    def weighted(at):
        projected = project_differentiably(at, camera)
        return float((weight * np.sin(projected.points_px)).sum()), projected.pull_back(
            weight * np.cos(projected.points_px)
        )

    assert_gradient(weighted, points)


def test_points_at_or_behind_the_camera_are_invalid_with_finite_pixels_and_no_gradient():
    # The canonical camera stands at z = 2 and looks toward -z.
    projected = project_differentiably(
        np.array([[0.0, 0.0, 0.0], [0.1, 0.1, 2.0], [0.1, 0.0, 5.0]]), Camera.canonical(64, 64)
    )
    assert projected.valid.tolist() == [True, False, False]
    assert np.isfinite(projected.points_px).all()
    gradient = projected.pull_back(np.ones((3, 2)))
    assert gradient[0].any()
    assert not gradient[1:].any()


def test_the_pixel_under_a_point_is_the_nearest_one_inside_the_image():
    pixels = np.array(
        [
            [0.4, 2.6],
            [-0.4, 0.0],
            [-0.6, 0.0],
            [7.4, 4.4],
            [7.6, 4.0],
            [3.0, 1e30],
            [np.nan, 0.0],
            [1.0, 1.0],
        ]
    )
    place, inside = pixels_under(pixels, np.arange(8) < 7, 5, 8)
    assert inside.tolist() == [True, True, False, True, False, False, False, False]
    assert place.tolist() == [24, 0, 0, 39, 0, 0, 0, 0]
