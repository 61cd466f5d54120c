"""Cameras that are corrected before the points move."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tso_cli.errors import InputError
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.rotations import angle_between, from_vectors
from tso_cli.geometry.view import View
from tso_cli.io.clouds import read_cloud
from tso_cli.refinement import RefineConfig, refine, refine_batch
from tso_cli.silhouette.projection import silhouette_of

EXAMPLES = Path(__file__).parents[2] / "examples"
PRESETS = pytest.mark.parametrize("preset", ["best", "paper"])


def _cloud(name):
    return read_cloud(EXAMPLES / name / "target.ply").points


def _view(points, azimuth, wrong=0.0):
    """The cloud from an azimuth, in degrees; ``wrong`` is the angle by which the camera told is off."""
    right = Camera.canonical(64, 64)
    for turn in ([25.0, 0.0, 0.0], [0.0, azimuth, 0.0]):
        right = replace(right, R=right.R @ from_vectors(np.radians(turn)))
    told = replace(right, R=from_vectors(np.radians(wrong) * np.array([0.6, 0.64, 0.48])) @ right.R)
    return View(np.float32(silhouette_of(points, right) > 0.5), told, name=f"from {azimuth:g}"), right


@PRESETS
def test_of_two_cameras_the_one_that_is_off_is_corrected_and_the_other_stays(preset):
    points = _cloud("airplane")
    (wrong, right), (good, _) = _view(points, 40.0, 8.0), _view(points, 120.0)
    result = refine(points, [wrong, good], config=RefineConfig(preset=preset, refine_camera=True))
    assert angle_between(result.cameras[0].R, right.R) < 6.0
    np.testing.assert_array_equal(result.cameras[0].K, right.K)
    assert result.cameras[1] is good.camera
    without = refine(points, [wrong, good], config=RefineConfig(preset=preset, steps=0))
    # The window in which both are judged holds what each came to: pixels are divided otherwise.
    assert result.iou_before == pytest.approx(without.iou_before, abs=0.005)
    # These masks are the projector's, wider than the cloud by a pixel: the truth itself scores 0.69.
    assert result.iou_after > result.iou_before + 0.03
    uncorrected = refine(points, [wrong, good], config=RefineConfig(preset=preset))
    assert result.loss_after < 0.7 * uncorrected.loss_after


@PRESETS
@pytest.mark.parametrize("cloud", ["chair", "airplane"])
def test_right_cameras_of_a_right_cloud_stay(preset, cloud):
    points = _cloud(cloud)
    view, _ = _view(points, 30.0)
    moved = refine(points, view, config=RefineConfig(preset=preset, refine_camera=True))
    assert moved.cameras == (view.camera,)
    without = refine(points, view, config=RefineConfig(preset=preset))
    np.testing.assert_allclose(moved.points, without.points, atol=1e-6)


@PRESETS
def test_mirrored_views_and_weights_are_those_of_the_corrected_cameras(preset):
    points = _cloud("airplane")
    views = [_view(points, 40.0, 8.0)[0], _view(points, 120.0)[0], _view(points, 200.0)[0]]
    # The last shows something else.
    views[2] = replace(views[2], mask=np.roll(views[2].mask, 12, 1))
    config = RefineConfig(preset=preset, symmetry="x")
    found = refine(points, views, config=replace(config, refine_camera=True))
    assert found.cameras[0] is not views[0].camera
    settled = [replace(view, camera=camera) for view, camera in zip(views, found.cameras, strict=True)]
    expected = refine(points, settled, config=config)
    np.testing.assert_allclose(found.points, expected.points, atol=1e-6)
    assert found.view_weights == pytest.approx(expected.view_weights)
    assert found.view_weights != pytest.approx(refine(points, views, config=config).view_weights) or preset == "paper"


def test_clouds_of_a_batch_have_their_cameras_corrected_as_alone():
    scenes = [(_cloud(name)[:count], _view(_cloud(name), 40.0, 8.0)[0]) for name, count in (("airplane", 1024), ("car", 700))]
    config = RefineConfig(steps=3, refine_camera=True)
    for found, scene in zip(refine_batch(scenes, config), scenes, strict=True):
        alone = refine(*scene, config=config)
        np.testing.assert_allclose(found.cameras[0].R, alone.cameras[0].R, atol=1e-4)
        np.testing.assert_allclose(found.points, alone.points, atol=1e-3)


@pytest.mark.parametrize("config", [RefineConfig(steps=2), RefineConfig(steps=0, refine_camera=True)])
def test_without_the_option_or_a_step_the_camera_is_the_one_given(config):
    points = _cloud("airplane")
    view, _ = _view(points, 40.0, 8.0)
    assert refine(points, view, config=config).cameras == (view.camera,)


def test_only_points_mode_moves_cameras():
    with pytest.raises(InputError, match="expected points to refine the camera"):
        RefineConfig(mode="encoder", refine_camera=True)
