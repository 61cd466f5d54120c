"""Camera correction before the descent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tso_cli.geometry.camera import Camera
from tso_cli.geometry.rotations import angle_between, from_vectors
from tso_cli.geometry.view import View
from tso_cli.refinement import RefineConfig, refine, refine_batch
from tso_cli.silhouette.projection import silhouette_of

from ..scenes import example

PRESETS = pytest.mark.parametrize("preset", ["best", "paper"])


def _view(points, azimuth, wrong=0.0):
    """The cloud from an azimuth, in degrees; ``wrong`` is the error of the view's camera, degrees."""
    right = Camera.canonical(64, 64)
    for turn in ([25.0, 0.0, 0.0], [0.0, azimuth, 0.0]):
        right = replace(right, R=right.R @ from_vectors(np.radians(turn)))
    given = replace(right, R=from_vectors(np.radians(wrong) * np.array([0.6, 0.64, 0.48])) @ right.R)
    return View(np.float32(silhouette_of(points, right) > 0.5), given, name=f"from {azimuth:g}"), right


@PRESETS
def test_a_wrong_camera_is_corrected_and_a_right_one_kept(preset):
    points = example("airplane").target
    (wrong, right), (good, _) = _view(points, 40.0, 8.0), _view(points, 120.0)
    result = refine(points, [wrong, good], config=RefineConfig(preset=preset, refine_camera=True))
    assert angle_between(result.cameras[0].R, right.R) < 6.0
    np.testing.assert_array_equal(result.cameras[0].K, right.K)
    assert result.cameras[1] is good.camera
    without = refine(points, [wrong, good], config=RefineConfig(preset=preset, steps=0))
    # IoU is measured in a window around both clouds, which differs.
    assert result.iou_before == pytest.approx(without.iou_before, abs=0.005)
    # The projector's masks are a pixel wider than the cloud: the IoU of the true cloud is 0.69.
    assert result.iou_after > result.iou_before + 0.03
    uncorrected = refine(points, [wrong, good], config=RefineConfig(preset=preset))
    assert result.loss_after < 0.7 * uncorrected.loss_after


@PRESETS
def test_right_cameras_of_a_right_cloud_are_kept(preset):
    points = example("airplane").target
    view, _ = _view(points, 30.0)
    moved = refine(points, view, config=RefineConfig(preset=preset, refine_camera=True))
    assert moved.cameras == (view.camera,)
    without = refine(points, view, config=RefineConfig(preset=preset))
    np.testing.assert_allclose(moved.points, without.points, atol=1e-6)


@PRESETS
def test_flipped_views_and_weights_are_those_of_the_corrected_cameras(preset):
    points = example("airplane").target
    views = [_view(points, 40.0, 8.0)[0], _view(points, 120.0)[0], _view(points, 200.0)[0]]
    # The last mask is of another object.
    views[2] = replace(views[2], mask=np.roll(views[2].mask, 12, 1))
    config = RefineConfig(preset=preset, symmetry="x")
    result = refine(points, views, config=replace(config, refine_camera=True))
    assert result.cameras[0] is not views[0].camera
    corrected = [replace(view, camera=camera) for view, camera in zip(views, result.cameras, strict=True)]
    expected = refine(points, corrected, config=config)
    np.testing.assert_allclose(result.points, expected.points, atol=1e-6)
    assert result.view_weights == pytest.approx(expected.view_weights)
    assert result.view_weights != pytest.approx(refine(points, views, config=config).view_weights) or preset == "paper"


@pytest.mark.parametrize("config", [RefineConfig(steps=2), RefineConfig(steps=0, refine_camera=True)])
def test_without_refine_camera_or_steps_the_camera_is_kept(config):
    points = example("airplane").target
    view, _ = _view(points, 40.0, 8.0)
    assert refine(points, view, config=config).cameras == (view.camera,)


@pytest.mark.slow
def test_clouds_of_a_batch_have_their_cameras_corrected_as_alone():
    clouds = {name: example(name).target for name in ("airplane", "car")}
    scenes = [(clouds[name][:count], _view(clouds[name], 40.0, 8.0)[0]) for name, count in (("airplane", 1024), ("car", 700))]
    config = RefineConfig(steps=3, refine_camera=True)
    for result, scene in zip(refine_batch(scenes, config), scenes, strict=True):
        alone = refine(*scene, config=config)
        np.testing.assert_allclose(result.cameras[0].R, alone.cameras[0].R, atol=1e-4)
        np.testing.assert_allclose(result.points, alone.points, atol=1e-3)
