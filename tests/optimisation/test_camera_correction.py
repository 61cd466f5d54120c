"""Camera correction before the optimisation: its gradient, and which cameras it changes."""

from dataclasses import replace

import numpy as np
import pytest

from tests.losses.common import FORMS, MODELS, assert_equal, assert_gradient, in_form
from tests.scenes import about, block, example, seen, turned
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.geometry.rotations import angle_between, from_vectors
from tso_cli.optimisation.camera_correction import _WithCameras, moved_camera, moved_silhouette
from tso_cli.optimisation.objective import silhouette_loss
from tso_cli.optimisation.resampled_view import ResampledView, resample_view

PRESETS = pytest.mark.parametrize("preset", ["best", "paper"])
PLANE = example("airplane").target
CLOUD = np.random.default_rng(0).uniform(-0.4, 0.4, (15, 3))
TURNS_AND_SHIFTS = np.array(
    [[0.02, -0.03, 0.01], [0.01, 0.02, -0.01], [0.4, -0.5, 0.9], [0.0, -0.02, 0.03]]
)


def _resampled(model: str, centre: np.ndarray, scale: float) -> tuple[View, ResampledView]:
    """A view in the units of a file, and the same for clouds normalised by (X - centre) / scale."""
    mask = block(np.s_[20:45, 22:40])
    camera = Camera.canonical(64, 64)
    K = (
        camera.K
        if model == "perspective"
        else np.array([[60.0 / scale, 0, 31.5], [0, 60.0 / scale, 31.5], [0, 0, 1.0]])
    )
    view = View(mask, replace(camera, K=K, t=scale * camera.t - camera.R @ centre, model=model))
    return view, resample_view(view, 0.4, centre, scale)


@MODELS
def test_the_gradient_by_points_rotations_and_shifts_is_that_of_finite_differences(model):
    """Of two views, near the start and far from it."""
    view = _resampled(model, np.zeros(3), 1.0)[1]
    objective = _WithCameras([view, view], CLOUD * 1.01)
    for corrections in (TURNS_AND_SHIFTS, 0.0 * TURNS_AND_SHIFTS):
        assert_gradient(objective, np.concatenate([CLOUD, corrections]), tolerance=1e-4)
        # By the silhouette alone: the prior of the corrections outweighs it.
        rows = np.concatenate([CLOUD, corrections[2:]])

        def silhouette(rows):
            value, *gradients = moved_silhouette(rows[:-2], view, rows[-2], rows[-1])
            return value, np.vstack(gradients)

        assert_gradient(silhouette, rows)


@FORMS
@MODELS
def test_a_corrected_camera_in_file_units_has_the_loss_of_the_optimisation(model, form):
    centre, scale = np.array([3.0, 4.0, 5.0]), 10.0
    view, resampled = _resampled(model, centre, scale)
    turn, shift = TURNS_AND_SHIFTS[:2]
    corrected = moved_camera(view.camera, np.concatenate([turn, shift]), centre, scale)
    assert moved_camera(view.camera, np.zeros(6), centre, scale) is view.camera
    local = resample_view(replace(view, camera=corrected), 0.4, centre, scale, resampled.box).camera
    value, by_points, *_ = in_form(form, moved_silhouette, CLOUD, resampled, turn, shift)
    assert_equal(in_form(form, silhouette_loss, CLOUD, resampled, local), (value, by_points), 1e-6)


def test_a_correction_that_shows_no_point_has_an_infinite_loss():
    view = _resampled("perspective", np.zeros(3), 1.0)[1]
    value, *gradients = moved_silhouette(CLOUD, view, np.zeros(3), np.array([0.0, 0.0, -9.0]))
    assert value == np.inf
    assert not any(gradient.any() for gradient in gradients)


def _view(points, azimuth, wrong=0.0):
    """The cloud from an azimuth, and the right camera; the given one is ``wrong`` by degrees."""
    level = Camera.canonical(64, 64)
    right = turned(replace(level, R=level.R @ about("x", 25.0)), azimuth)
    given = replace(
        right, R=from_vectors(np.radians(wrong) * np.array([0.6, 0.64, 0.48])) @ right.R
    )
    return replace(seen(points, right), camera=given, name=f"from {azimuth:g}"), right


@PRESETS
def test_a_wrong_camera_is_corrected_and_a_right_one_kept(preset):
    (wrong, right), (good, _) = _view(PLANE, 40.0, 8.0), _view(PLANE, 120.0)
    result = refine(PLANE, [wrong, good], config=RefineConfig(preset=preset, refine_camera=True))
    assert angle_between(result.cameras[0].R, right.R) < 6.0
    np.testing.assert_array_equal(result.cameras[0].K, right.K)
    assert result.cameras[1] is good.camera
    without = refine(PLANE, [wrong, good], config=RefineConfig(preset=preset, steps=0))
    # IoU is measured in a window around both clouds, which differs.
    assert result.fit.iou_before == pytest.approx(without.fit.iou_before, abs=0.005)
    # The projector's masks are a pixel wider than the cloud: the IoU of the true cloud is 0.69.
    assert result.fit.iou_after > result.fit.iou_before + 0.03
    uncorrected = refine(PLANE, [wrong, good], config=RefineConfig(preset=preset))
    assert result.fit.loss_after < 0.7 * uncorrected.fit.loss_after


@PRESETS
def test_right_cameras_of_a_right_cloud_are_kept(preset):
    view, _ = _view(PLANE, 30.0)
    moved = refine(PLANE, view, config=RefineConfig(preset=preset, refine_camera=True))
    assert moved.cameras == (view.camera,)
    np.testing.assert_array_equal(
        moved.points, refine(PLANE, view, config=RefineConfig(preset=preset)).points
    )


@PRESETS
def test_flipped_views_and_weights_are_those_of_the_corrected_cameras(preset):
    views = [_view(PLANE, 40.0, 8.0)[0], _view(PLANE, 120.0)[0], _view(PLANE, 200.0)[0]]
    # The last mask is of another object.
    views[2] = replace(views[2], mask=np.roll(views[2].mask, 12, 1))
    config = RefineConfig(preset=preset, symmetry="x", steps=6)
    result = refine(PLANE, views, config=replace(config, refine_camera=True))
    assert result.cameras[0] is not views[0].camera
    corrected = [
        replace(view, camera=camera) for view, camera in zip(views, result.cameras, strict=True)
    ]
    expected = refine(PLANE, corrected, config=config)
    np.testing.assert_allclose(result.points, expected.points, atol=1e-6)
    weights = _loss_weights(result)
    assert weights == pytest.approx(_loss_weights(expected))
    if preset == "best":
        assert weights != pytest.approx(_loss_weights(refine(PLANE, views, config=config)))


def _loss_weights(result):
    return [view.loss_weight for view in result.views]


@pytest.mark.parametrize(
    "config", [RefineConfig(steps=2), RefineConfig(steps=0, refine_camera=True)]
)
def test_without_refine_camera_or_steps_the_camera_is_kept(config):
    view, _ = _view(PLANE, 40.0, 8.0)
    assert refine(PLANE, view, config=config).cameras == (view.camera,)
