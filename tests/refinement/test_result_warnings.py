"""Warnings of a result: that nothing moved, and why; and of coarse masks."""

from dataclasses import replace

import numpy as np

from tests.losses.scenes import points_at
from tests.scenes import block
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.render import look_at


def _small_mask(points: np.ndarray, rows: int, columns: int) -> View:
    """A photo of 640x480 in which the object is so large, and a camera that sees ``points`` there."""
    mask = block(np.s_[200 : 200 + rows, 300 : 300 + columns], (480, 640))
    camera = look_at(30.0, 20.0, 3.0, (640, 480))
    low, high = (bound(camera.project(points)[0], axis=0) for bound in (np.min, np.max))
    middle = 300.0 + (columns - 1) / 2.0, 200.0 + (rows - 1) / 2.0
    zoom = rows / (high - low)[1]
    K = np.diag([zoom, zoom, 1.0]) @ camera.K
    K[:2, 2] += middle - zoom * (low + high) / 2.0
    return View(mask, replace(camera, K=K), name="small.png")


def test_for_a_cloud_that_covers_its_mask_there_is_nothing_to_do():
    # Points at every third of a pixel.
    pixels = np.stack(
        np.meshgrid(np.arange(20.0, 43.1, 1 / 3), np.arange(20.0, 43.1, 1 / 3)), -1
    ).reshape(-1, 2)
    camera = Camera.canonical(64, 64)
    points = points_at(pixels, camera, np.full(len(pixels), 2.0))
    result = refine(
        points,
        View(block(np.s_[20:44, 20:44]), camera),
        config=RefineConfig(steps=3, symmetry="none"),
    )
    assert (result.stop_reason, result.best_step, result.loss_before) == ("nothing_to_do", 0, 0.0)
    assert result.warnings == (
        "nothing to do: the cloud already agrees with all that the mask shows; the cloud is as it was",
    )
    assert (result.moved_mean, result.moved_max) == (0.0, 0.0)
    np.testing.assert_array_equal(result.points, points)


def test_a_tiny_displacement_is_warned_of(chair):
    result = refine(*chair[:3], RefineConfig(learning_rate=1e-6, steps=2, preset="paper"))
    assert result.stop_reason == "max_steps"
    assert 0.0 < result.moved_max < 1e-3
    assert result.warnings == (
        "hardly anything moved: no point by more than 0.1 % of the object's size",
    )


def test_pixels_wider_than_the_spacing_of_the_points_are_warned_of_where_they_are_few(chair):
    points, view = chair.points, chair.view
    coarse = "small.png: shows the object with only 30 pixels: details smaller than 1/6 of its size cannot be seen"

    def warned(cloud: np.ndarray, mask: View) -> bool:
        return coarse in refine(cloud, mask, config=RefineConfig(steps=0)).warnings

    small = _small_mask(points, 6, 5)
    assert warned(points, small)
    # The spacing of a sparser cloud is wider than the pixels.
    assert not warned(points[::20], small)
    # Fewer than 16 pixels are coarse for any cloud.
    assert refine(points[::60], _small_mask(points, 5, 3), config=RefineConfig(steps=0)).warnings[
        1:
    ]
    assert len(refine(points, view, config=RefineConfig(steps=0)).warnings) == 1
