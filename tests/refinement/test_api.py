"""`refine`: its results, invariances and refusals."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from tests.corruption import assert_refused
from tests.scenes import block, problem_of
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.diagnosis.assumptions import Assumption
from tso_cli.diagnosis.findings import Finding
from tso_cli.diagnosis.hypotheses import HYPOTHESES
from tso_cli.errors import InputError
from tso_cli.optimisation.optimise import optimise, weigh
from tso_cli.optimisation.resampled_view import resample_view
from tso_cli.refinement import PRESETS

PAPER = RefineConfig(preset="paper")


def test_the_papers_settings_bring_the_chair_nearer_to_the_true_shape(chair):
    result = refine(*chair[:3], PAPER)
    assert chair.error(result.points) < 0.97 * chair.error(chair.points)
    assert result.fit.iou_after > result.fit.iou_before + 0.01
    assert result.fit.loss_after < result.fit.loss_before
    assert result.fit.steps == 50
    assert result.fit.stop_reason == "max_steps"
    settings = result.settings
    assert settings.mode == "points"
    assert settings.learning_rate == 5e-4
    assert settings.gamma == 1e6
    assert settings.sigma_sq == 0.4


def test_tensors_lists_and_views_give_the_result_of_arrays(chair):
    points, mask, camera, _ = chair
    config = RefineConfig(steps=3, symmetry="none")
    expected = refine(points, mask, camera, config).points
    for variant in (
        refine(torch.tensor(points), torch.tensor(mask), camera, config),
        refine(points.tolist(), [mask], [camera], config),
        refine(points, View(mask, camera), config=config),
        refine(np.asfortranarray(points), mask, camera, config),
    ):
        np.testing.assert_array_equal(variant.points, expected)
    cloud = Cloud(np.asfortranarray(points), "points").controlled()
    assert cloud.start.flags.c_contiguous


def test_progress_reports_the_points_of_every_step_in_the_unit_of_the_cloud(chair):
    points, reported, given = 3.0 * chair.points + 5.0, [], chair.camera
    camera = replace(given, t=3.0 * given.t - given.R @ np.full(3, 5.0))
    config = RefineConfig(preset="paper", steps=4)
    result = refine(points, chair.mask, camera, config, progress=lambda *one: reported.append(one))
    assert [one[:2] for one in reported] == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert [one[2] for one in reported] == result.fit.losses[1:]
    np.testing.assert_allclose(reported[result.fit.best_step - 1][3], result.points, atol=1e-9)


def test_zero_steps_return_the_start_bit_for_bit(chair):
    points, mask, camera, _ = chair
    result = refine(
        points + 4_000_000.1, mask, _shifted(camera, 4_000_000.1), RefineConfig(steps=0)
    )
    np.testing.assert_array_equal(result.points, points + 4_000_000.1)
    assert result.fit.loss_before == result.fit.loss_after
    assert result.fit.chamfer_to_initial == 0.0


def _shifted(camera: Camera, by: float) -> Camera:
    """The camera that sees X + by where ``camera`` sees X."""
    return replace(camera, t=camera.t - camera.R @ np.full(3, by))


@pytest.mark.parametrize("preset", PRESETS)
def test_a_scan_with_coordinates_near_four_million_is_refined_as_at_the_origin(chair, preset):
    points, mask, camera, _ = chair
    config = RefineConfig(preset=preset)
    expected = refine(points, mask, camera, config)
    far = refine(points + 4e6, mask, _shifted(camera, 4e6), config)
    # There, coordinates have nine digits after the point, and of two points about equally near
    # the other may be the nearest.
    np.testing.assert_allclose(
        far.points - 4e6, expected.points, atol=1e-4 if preset == "paper" else 0.02
    )
    assert chair.error(far.points - 4e6) == pytest.approx(chair.error(expected.points), rel=0.02)


def test_another_unit_changes_nothing(chair):
    points, mask, camera, _ = chair
    in_millimetres = replace(camera, t=1000.0 * camera.t)
    expected, scaled = refine(points, mask, camera), refine(points * 1000.0, mask, in_millimetres)
    np.testing.assert_allclose(scaled.points / 1000.0, expected.points, atol=1e-4)
    assert scaled.fit.chamfer_to_initial == pytest.approx(expected.fit.chamfer_to_initial, rel=1e-3)


def test_enlarging_mask_and_intrinsics_by_two_changes_nothing(chair):
    points, mask, camera, _ = chair
    # The learned prior sees how many pixels the object has.
    config = RefineConfig(steps=12, symmetry="none", prior="none")
    finer = mask.repeat(2, axis=0).repeat(2, axis=1)
    expected = refine(points, mask, camera, config)
    result = refine(points, finer, camera.resized(2 * camera.width, 2 * camera.height), config)
    np.testing.assert_allclose(result.points, expected.points, atol=1e-4)
    assert result.settings.sigma_sq == expected.settings.sigma_sq
    assert result.fit.loss_after == pytest.approx(expected.fit.loss_after, rel=1e-4)


def test_a_grid_of_64_cells_loses_nothing_against_one_of_256(chair):
    settings = PAPER.settings()
    problem = problem_of(chair.points, chair.view)
    (windowed,), cloud = problem.given, problem.cloud
    box, sigma_sq = windowed.resampled.box, 4**2 * settings.sigma_sq
    finer = resample_view(windowed.view, sigma_sq, cloud.centre, cloud.scale, box, 256)
    fine = replace(problem, given=(replace(windowed, resampled=finer),))
    coarse, full = (
        optimise(weigh(each, settings), settings, settings.steps) for each in (problem, fine)
    )
    assert not np.array_equal(coarse.best, full.best)
    errors = [chair.error(cloud.denormalise(each.best)) for each in (coarse, full)]
    assert errors[0] < 1.01 * errors[1]
    # The resampled view has the loss of all pixels, except for the averaged rim of the mask.
    assert coarse.first_loss == pytest.approx(full.first_loss, rel=0.05)


def test_a_large_gamma_keeps_the_cloud_near_its_start(chair):
    strong, weak = (
        refine(*chair[:3], RefineConfig(gamma=gamma, preset="paper", accept_doubtful=True))
        for gamma in (1e8, 0.0)
    )
    assert strong.fit.chamfer_to_initial < 0.2 * weak.fit.chamfer_to_initial


def test_points_on_ignored_pixels_hardly_move(chair):
    points, mask, camera, _ = chair
    known = block(np.s_[:, :128], mask.shape) > 0.0
    result = refine(
        points, View(mask, camera, known), config=RefineConfig(gamma=0.0, preset="paper")
    )
    columns = camera.project(points)[0][:, 0]
    moved = np.linalg.norm(result.points - points, axis=1)
    # Adam enlarges what is left of their Gaussians on known pixels.
    assert moved[columns > 148.0].max() < 1e-5
    assert moved[columns < 128.0].max() > 1e-3


@pytest.mark.parametrize("preset", ["paper", "best"])
def test_losses_of_views_add_up(chair, preset):
    points, mask, camera, _ = chair
    config = RefineConfig(steps=0, preset=preset, symmetry="none")
    one = refine(points, mask, camera, config)
    two = refine(points, [mask, mask], [camera, camera], config)
    assert two.fit.loss_before == pytest.approx(2 * one.fit.loss_before, rel=1e-6)
    assert [view.inlier_weight for view in two.views] == [1.0, 1.0]
    assert two.fit.iou_before == pytest.approx(one.fit.iou_before)


def test_orthographic_views_are_refined(chair):
    K = np.array([[180.0, 0.0, 127.5], [0.0, 180.0, 127.5], [0.0, 0.0, 1.0]])
    camera = replace(Camera.canonical(256, 256), K=K, model="orthographic")
    result = refine(chair.points, chair.mask, camera, RefineConfig(steps=6, symmetry="none"))
    assert result.fit.loss_after < result.fit.loss_before


def test_unusable_points_masks_and_cameras_are_refused(chair):
    points, mask, camera, _ = chair
    for bad, words in (
        (dict(points=points[:0]), "points"),
        (dict(points=points[:, :2]), "points"),
        (dict(points=points * np.nan), "finite"),
        (dict(points=points * 0.0), "same|degenerate|extent"),
        (dict(points=points + [0, 0, 50.0]), "behind|outside|hardly meet|no point"),
        (dict(masks=mask * 0.0), "no pixel is foreground"),
        (
            dict(masks=mask * 0.0 + 1.0),
            "every pixel is foreground, expected some background \\(`invert_mask`",
        ),
        (dict(masks=mask[:-1]), "expected the same"),
        (dict(masks=[mask, mask]), "one camera for each mask"),
        (dict(masks=None), "masks are not arrays of numbers"),
        (dict(masks=[mask[None]]), "a mask has shape"),
        (dict(config=RefineConfig(mode="encoder")), "needs a network"),
    ):
        assert_refused(words, refine, **(dict(points=points, masks=mask, cameras=camera) | bad))


NO_NUMBERS = {
    "ragged": [[1, 2, 3], [1, 2]],
    "text": "x",
    "texts": [["a", "b", "c"]],
    "a dictionary": {},
    "an object": object(),
    "objects": np.full((5, 3), object()),
    "complex": np.ones((5, 3), complex),
    "complex of objects": np.full((5, 3), 1j, object),
    "times": np.zeros((5, 3), "M8[s]"),
    "beyond floats": [[10**400, 0, 0]],
    "beyond squares": np.diag([1e307, 1.0, 2.0]),
    "empty": np.zeros((0, 0)),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", NO_NUMBERS)
def test_what_is_no_array_of_real_numbers_is_an_input_error_wherever_it_is_given(chair, name):
    points, mask, camera, _ = chair
    value, view = NO_NUMBERS[name], View(mask, camera)
    for call in (
        partial(refine, value, mask, camera),
        partial(refine, points, value, camera),
        partial(refine, points, [value], camera),
        partial(refine, points, mask, value),
        partial(refine, points, mask, camera, faces=value),
        partial(refine, points, mask, camera, config=[value]),
        partial(refine, points, mask, camera, assume=[value]),
        partial(View, value, camera),
        partial(View, mask, value),
        *(partial(replace, view, **{key: value}) for key in ("known", "depth", "image")),
        *(
            partial(replace, camera, **{key: value})
            for key in ("K", "R", "t", "width", "height", "model")
        ),
        partial(Camera.canonical, value, 3),
    ):
        with pytest.raises(InputError):
            call()


def test_a_result_has_its_own_copy_of_the_points(chair):
    points = chair.points.copy()
    result = refine(points, chair.mask, chair.camera, RefineConfig(steps=1))
    for array in (result.initial, result.points, *result.measured):
        assert not np.shares_memory(array, points)


def test_an_ignore_map_that_leaves_no_background_is_named(chair):
    leaves = "every pixel that the ignore map leaves is foreground, expected some background$"
    assert_refused(leaves, replace, chair.view, known=chair.view.mask > 0.5)


@pytest.mark.parametrize(
    ("name", "value"),
    [("steps", 2.5), ("steps", -1), ("learning_rate", "a"), ("learning_rate", 0.0), ("gamma", -1.0)]
    + [("mode", "magic"), ("preset", "magic"), ("sigma_sq", float("nan")), ("device", "cuda")],
)
def test_settings_out_of_range_are_refused(name, value):
    assert_refused(name, RefineConfig, **{name: value})


def test_a_pole_thinner_than_a_cell_of_the_window_moves_onto_its_mask():
    rng = np.random.default_rng(0)
    pole = rng.uniform(-1.0, 1.0, (300, 3)) * [0.005, 0.5, 0.005]
    rows = np.arange(20, 236)
    mask = block(np.s_[rows, rows // 6 + 106], (256, 256))
    camera = Camera.canonical(256, 256)
    result = refine(pole, mask, camera, RefineConfig(accept_doubtful=True))
    columns, rows = np.stack(
        [camera.project(cloud)[0] for cloud in (pole, result.points)]
    ).transpose(2, 0, 1)
    before, after = np.abs(columns - rows / 6 - 106.0).mean(1)
    assert after < 0.9 * before


def test_an_ignore_map_that_leaves_no_known_cell_is_refused(chair):
    every_fourth = np.arange(256)[:, None] % 4 + np.arange(256) % 4 == 0
    view = replace(chair.view, known=every_fourth, name="front")
    words = "front: no cell of its window of 64x64 is known to be foreground"
    assert_refused(words, refine, chair.points, view)


@pytest.mark.parametrize("view", ["", "@mask.png"])
def test_under_an_assumption_the_result_is_of_the_input_as_it_is_meant(chair, view):
    flipped = replace(chair.view, mask=chair.mask[:, ::-1])
    config = RefineConfig(steps=3, symmetry="none")
    result = refine(chair.points, flipped, config=config, assume=[f"mask-flipped{view}"])
    as_object = refine(
        chair.points, flipped, config=config, assume=[Assumption(HYPOTHESES["mask-flipped"])]
    )
    expected = refine(chair.points, chair.view, config=config)
    np.testing.assert_array_equal(result.points, expected.points)
    np.testing.assert_array_equal(as_object.points, expected.points)
    assert result.fit == expected.fit


def test_what_is_known_of_the_input_is_a_finding_of_the_result(chair):
    known = Finding("assumed-picture", (0,))
    result = refine(*chair[:3], RefineConfig(steps=0), known=[known])
    assert result.findings == (known,)
