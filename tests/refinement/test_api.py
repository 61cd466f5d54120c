"""The loop: what it promises about its result, and the invariances of its settings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import tso_cli
from tso_cli.errors import InputError, TsoError
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.view import View
from tso_cli.io.cameras import read_camera
from tso_cli.io.clouds import read_cloud
from tso_cli.io.images import read_mask
from tso_cli.kernels.dispatch import planned
from tso_cli.network.model import Encoder, build_network
from tso_cli.refinement import PRESETS, RefineConfig, refine, refine_batch, resampled_view, run
from tso_cli.refinement import optimise as loop
from tso_cli.refinement.cloud import Cloud
from tso_cli.refinement.objective import SilhouetteObjective, ViewTargets
from tso_cli.refinement.parameters import NetworkParameters
from tso_cli.refinement.presets import BEST
from tso_cli.refinement.prior import position_prior
from tso_cli.refinement.problem import Problem
from tso_cli.refinement.smooth_field import SmoothField
from tso_cli.render import look_at
from tso_cli.silhouette.chamfer import chamfer
from tso_cli.silhouette.projection import silhouette_of

PAPER = RefineConfig(preset="paper")
CHAIR = Path(__file__).parents[2] / "examples" / "chair"


@pytest.fixture(scope="module")
def chair():
    mask = read_mask(CHAIR / "mask.png")
    camera = read_camera(CHAIR / "camera.json", mask.shape[1], mask.shape[0])
    return read_cloud(CHAIR / "initial.ply").points, mask, camera


def _error(points) -> float:
    target = torch.tensor(read_cloud(CHAIR / "target.ply").points)[None]
    return sum(chamfer(torch.as_tensor(points, dtype=torch.float64)[None], target)).item()


def test_the_papers_settings_bring_the_chair_nearer_to_the_truth(chair):
    points, mask, camera = chair
    result = tso_cli.refine(points, mask, camera, PAPER)
    assert _error(result.points) < 0.97 * _error(points)
    assert result.iou_after > result.iou_before + 0.01
    assert result.loss_after < result.loss_before
    assert (result.steps, result.stop_reason, result.mode) == (50, "max_steps", "points")
    assert (result.learning_rate, result.gamma, result.sigma_sq) == (5e-4, 1e6, 0.4)


def test_tensors_lists_and_views_say_the_same_as_arrays(chair):
    points, mask, camera = chair
    config = RefineConfig(steps=3)
    expected = refine(points, mask, camera, config).points
    for variant in (
        refine(torch.tensor(points), torch.tensor(mask), camera, config),
        refine(points.tolist(), [mask], [camera], config),
        refine(points, View(mask, camera), config=config),
    ):
        np.testing.assert_array_equal(variant.points, expected)


def test_zero_steps_give_back_every_bit_of_the_start(chair):
    points, mask, camera = chair
    result = refine(points + 4_000_000.1, mask, _shifted(camera, 4_000_000.1), RefineConfig(steps=0))
    np.testing.assert_array_equal(result.points, points + 4_000_000.1)
    assert result.loss_before == result.loss_after
    assert result.chamfer_to_initial == 0.0


def _shifted(camera: Camera, by: float, scale: float = 1.0) -> Camera:
    """The camera that sees scale * X + by where ``camera`` sees X."""
    return Camera(camera.K, camera.R, scale * camera.t - camera.R @ np.full(3, by), camera.width, camera.height, camera.model)


@pytest.mark.parametrize("preset", PRESETS)
def test_scaling_cloud_and_camera_by_a_thousand_changes_nothing(chair, preset):
    points, mask, camera = chair
    config = RefineConfig(preset=preset)
    expected = refine(points, mask, camera, config)
    scaled = refine(points * 1000.0, mask, _shifted(camera, 0.0, 1000.0), config)
    np.testing.assert_allclose(scaled.points / 1000.0, expected.points, atol=1e-4)
    assert scaled.loss_after == pytest.approx(expected.loss_after, rel=1e-4)
    assert scaled.chamfer_to_initial == pytest.approx(expected.chamfer_to_initial, rel=1e-3)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_scan_with_coordinates_near_four_million_is_refined_as_at_the_origin(chair, preset):
    points, mask, camera = chair
    config = RefineConfig(preset=preset)
    expected = refine(points, mask, camera, config)
    far = refine(points + 4e6, mask, _shifted(camera, 4e6), config)
    # At four million, coordinates hold nine digits after the point: of two points equally near, the other may be the nearer.
    np.testing.assert_allclose(far.points - 4e6, expected.points, atol=1e-4 if preset == "paper" else 0.02)
    assert _error(far.points - 4e6) == pytest.approx(_error(expected.points), rel=0.02)


@pytest.mark.parametrize("preset", PRESETS)
def test_enlarging_mask_and_intrinsics_by_two_changes_nothing(chair, preset):
    points, mask, camera = chair
    config = RefineConfig(preset=preset)
    finer = mask.repeat(2, axis=0).repeat(2, axis=1)
    expected = refine(points, mask, camera, config)
    result = refine(points, finer, camera.resized(2 * camera.width, 2 * camera.height), config)
    np.testing.assert_allclose(result.points, expected.points, atol=1e-4)
    assert result.sigma_sq == expected.sigma_sq
    assert result.loss_after == pytest.approx(expected.loss_after, rel=1e-4)


def test_a_grid_of_64_cells_loses_nothing_against_one_of_256(chair, monkeypatch):
    points, mask, camera = chair
    coarse = refine(points, mask, camera, PAPER)

    def fine(view, sigma_sq, centre, scale, box):
        return resampled_view.resample_view(view, 0.4 * 4**2, centre, scale, box, 256)

    monkeypatch.setattr("tso_cli.refinement.problem.resample_view", fine)
    full = refine(points, mask, camera, PAPER)
    assert not np.array_equal(coarse.points, full.points)
    assert _error(coarse.points) < 1.01 * _error(full.points)
    # the working view is the same scene: its loss is that of every pixel but for the averaged rim of the mask
    assert coarse.loss_before == pytest.approx(full.loss_before, rel=0.05)


def test_the_result_is_the_best_iterate_and_the_start_is_a_candidate(chair):
    points, mask, camera = chair
    wild = refine(points, mask, camera, RefineConfig(learning_rate=0.5, steps=5, preset="paper"))
    assert wild.best_step == 0
    np.testing.assert_array_equal(wild.points, points)
    tame = refine(points, mask, camera, PAPER)
    assert tame.loss_after == min(tame.losses)
    assert len(tame.losses) == tame.steps + 1


def test_gamma_holds_the_cloud_near_its_start(chair):
    points, mask, camera = chair
    held = refine(points, mask, camera, RefineConfig(gamma=1e8, preset="paper"))
    loose = refine(points, mask, camera, RefineConfig(gamma=0.0, preset="paper"))
    assert held.chamfer_to_initial < 0.2 * loose.chamfer_to_initial


def test_two_runs_give_the_same_bits(chair):
    points, mask, camera = chair
    np.testing.assert_array_equal(refine(points, mask, camera).points, refine(points, mask, camera).points)


def test_an_interrupt_keeps_the_best_so_far(chair):
    points, mask, camera = chair

    def interrupt(step, steps, loss):
        if step == 4:
            raise KeyboardInterrupt

    result = refine(points, mask, camera, progress=interrupt)
    assert (result.stop_reason, result.steps, result.best_step) == ("interrupted", 4, 4)
    assert result.loss_after < result.loss_before


def test_a_loss_that_stops_being_a_number_keeps_the_best_before_it(chair, monkeypatch):
    points, mask, camera = chair
    calls = iter(range(1000))
    true_call = SilhouetteObjective.__call__

    def failing(self, moved):
        return true_call(self, moved) * (torch.nan if next(calls) >= 3 else 1.0)

    monkeypatch.setattr(SilhouetteObjective, "__call__", failing)
    result = refine(points, mask, camera, PAPER)
    assert (result.stop_reason, result.steps, result.best_step) == ("non_finite", 2, 2)
    assert np.isfinite(result.points).all()
    calls = iter(range(2, 1000))
    with pytest.raises(TsoError, match="after the first step"):
        refine(points, mask, camera, PAPER)
    with pytest.raises(TsoError, match="loss of the start"):
        refine(points, mask, camera, PAPER)


def test_reading_the_losses_rarely_as_on_a_gpu_changes_no_result(chair, monkeypatch):
    points, mask, camera = chair
    expected = refine(points, mask, camera)
    monkeypatch.setattr(loop, "whole_batches", lambda tensor: True)
    rarely = refine(points, mask, camera)
    np.testing.assert_array_equal(rarely.points, expected.points)
    assert rarely.losses == expected.losses
    true_call, calls = SilhouetteObjective.__call__, []

    def failing(self, moved):
        calls.append(1)
        return true_call(self, moved) * (torch.nan if len(calls) > 3 else 1.0)

    monkeypatch.setattr(SilhouetteObjective, "__call__", failing)
    result = refine(points, mask, camera, PAPER)
    assert (result.stop_reason, result.steps, result.best_step) == ("non_finite", 2, 2)
    assert len(calls) == loop.STEPS_UNREAD + 1


def test_ignored_pixels_leave_the_points_they_cover_alone(chair):
    points, mask, camera = chair
    known = np.zeros(mask.shape, bool)
    known[:, : mask.shape[1] // 2] = True
    result = refine(points, View(mask, camera, known), config=RefineConfig(gamma=0.0, preset="paper"))
    columns = camera.project(points)[0][:, 0]
    moved = np.linalg.norm(result.points - points, axis=1)
    # points well inside the ignored half, beyond the reach of the kernel
    assert moved[columns > mask.shape[1] / 2 + 20].max() == 0.0
    assert moved[columns < mask.shape[1] / 2].max() > 1e-3


@pytest.mark.parametrize("preset", ["paper", "best"])
def test_several_views_add_up_and_by_the_default_preset_what_is_told_twice_counts_once(chair, preset):
    points, mask, camera = chair
    config = RefineConfig(steps=0, preset=preset, symmetry="none")
    one = refine(points, mask, camera, config)
    two = refine(points, [mask, mask], [camera, camera], config)
    assert two.loss_before == pytest.approx({"paper": 2, "best": 1}[preset] * one.loss_before, rel=1e-6)
    assert two.view_weights == {"paper": [1.0, 1.0], "best": [0.5, 0.5]}[preset]
    assert two.iou_before == pytest.approx(one.iou_before)


def test_an_orthographic_camera_refines_too(chair):
    points, mask, _ = chair
    K = np.array([[180.0, 0.0, 127.5], [0.0, 180.0, 127.5], [0.0, 0.0, 1.0]])
    camera = Camera(K, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.0]), 256, 256, "orthographic")
    result = refine(points, mask, camera)
    assert result.loss_after < result.loss_before


@pytest.fixture
def photo():
    """A small network, a picture for it and a mask."""
    mask = np.zeros((64, 64), np.float32)
    mask[22:42, 25:40] = 1.0
    return build_network(points=64), torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0)), mask


@pytest.mark.parametrize("mode", ["encoder", "encoder-decoder", "latent"])
def test_a_network_mode_moves_only_its_own_numbers_and_leaves_the_network_as_it_was(mode, photo, monkeypatch):
    network, image, mask = photo
    before = {name: value.clone() for name, value in network.state_dict().items()}
    seen = {}
    true_descend = run.descend

    def spy(forward, objective, optimiser, *rest):
        seen["count"] = sum(p.numel() for p in optimiser._parameters)
        return true_descend(forward, objective, optimiser, *rest)

    monkeypatch.setattr(run, "descend", spy)
    result = refine(None, mask, config=RefineConfig(mode, steps=3, preset="paper"), network=network, image=image)
    assert result.loss_after < result.loss_before
    assert result.gamma == (0.0 if mode == "encoder" else 1e6)
    encoder, decoder = (sum(p.numel() for p in half.parameters()) for half in (network.encoder, network.decoder))
    assert seen["count"] == {"encoder": encoder, "encoder-decoder": encoder + decoder, "latent": 128}[mode]
    for name, value in network.state_dict().items():
        assert torch.equal(value, before[name])
    assert all(weight.requires_grad and weight.grad is None for weight in network.parameters())


def test_the_latent_vector_starts_at_the_prediction_and_its_cloud_is_always_the_decoders(photo):
    network, image, _ = photo
    start = NetworkParameters(network, image, "latent", torch.device("cpu"))
    (latent,) = start.parameters
    assert latent.shape == (1, 128)
    with torch.no_grad():
        torch.testing.assert_close(torch.tensor(start.cloud.initial).float(), network(image[None])[0], rtol=0, atol=1e-6)
        latent += 0.1
        expected = (network.decoder(latent)[0].double().numpy() - start.cloud.centre) / start.cloud.scale
        np.testing.assert_allclose(start.forward()[0].numpy(), expected, atol=1e-6)


def test_a_step_of_the_latent_variant_does_not_look_at_the_picture_again(photo, monkeypatch):
    network, image, mask = photo
    looks = []
    true_forward = Encoder.forward
    monkeypatch.setattr(Encoder, "forward", lambda encoder, images: looks.append(1) or true_forward(encoder, images))
    refine(None, mask, config=RefineConfig("latent", steps=4), network=network, image=image)
    assert len(looks) == 1


def test_the_gradient_by_the_latent_vector_is_that_of_finite_differences(photo):
    network, image, mask = photo
    start = NetworkParameters(network, image, "latent", torch.device("cpu"))
    start._predict.double()
    latent = start.parameters[0].detach().double()
    view = resampled_view.resample_view(View(mask, Camera.canonical(64, 64)), 0.4, start.cloud.centre, start.cloud.scale)
    term = SilhouetteObjective([[view]], start.counts, latent.new_zeros(1, 64, 3))

    def loss(values):
        start._input = values
        return term(start.forward())

    assert torch.autograd.gradcheck(loss, latent.requires_grad_(), eps=1e-6, atol=1e-3, rtol=1e-5)


def test_what_cannot_be_refined_is_refused(chair):
    points, mask, camera = chair
    for bad, words in (
        (dict(points=points[:0]), "points"),
        (dict(points=points[:, :2]), "points"),
        (dict(points=np.where(points > 0.4, np.nan, points)), "finite"),
        (dict(points=points * 0.0), "same|degenerate|extent"),
        (dict(points=points + [0, 0, 50.0]), "behind|outside|hardly meet|no point"),
        (dict(masks=mask * 0.0), "no pixel is foreground"),
        (dict(masks=mask * 0.0 + 1.0), "every pixel is foreground"),
        (dict(masks=mask[:-1]), "expected the same"),
        (dict(masks=[mask, mask]), "one camera for each mask"),
        (dict(masks=None), "masks are no arrays"),
        (dict(masks=[mask[None]]), "a mask has shape"),
        (dict(config=RefineConfig("encoder")), "needs a network"),
    ):
        arguments = dict(points=points, masks=mask, cameras=camera) | bad
        with pytest.raises(InputError, match=words):
            refine(**arguments)


@pytest.mark.parametrize(
    "bad",
    [
        {"seed": -1},
        {"steps": 2.5},
        {"learning_rate": "a"},
        {"mode": "magic"},
        {"steps": -1},
        {"learning_rate": 0.0},
        {"gamma": -1.0},
        {"sigma_sq": float("nan")},
    ],
)
def test_settings_out_of_range_are_refused(bad):
    with pytest.raises(InputError, match=next(iter(bad))):
        RefineConfig(**bad)


def test_a_device_that_is_not_there_is_refused(chair):
    if torch.cuda.is_available():
        pytest.skip("this machine has CUDA")
    with pytest.raises(InputError, match="cuda: not available"):
        refine(*chair, RefineConfig(device="cuda"))


@pytest.mark.parametrize("work", [0, 1 << 60], ids=["plain", "compiled"])
def test_a_batch_of_clouds_of_different_sizes_comes_to_what_each_comes_to_alone(chair, work):
    points, mask, camera = chair
    larger = np.concatenate([points, points * 0.99])
    far = points + 100.0
    scenes = [
        (points, View(mask, camera)),
        (points[::3], [View(mask, camera), View(mask, camera)]),
        (larger, View(mask, camera)),
        (far, View(mask, _shifted(camera, 100.0))),
        (points[::2] * 0.9, View(mask, camera, np.arange(256)[:, None] + np.zeros((256, 256)) < 200)),
    ]
    # in one form of the kernels: where a gradient is nearly zero, Adam makes a step of its last digits
    with planned(work, work):
        together, single = refine_batch(scenes, PAPER), [refine(own, views, config=PAPER) for own, views in scenes]
    for found, alone in zip(together, single, strict=True):
        np.testing.assert_allclose(found.points, alone.points, atol=2e-5)
        assert found.loss_after == pytest.approx(alone.loss_after, rel=1e-5)
        assert (found.steps, found.stop_reason) == (50, "max_steps")
        assert found.best_step == pytest.approx(alone.best_step, abs=2)
        assert (found.iou_before, found.iou_after) == pytest.approx((alone.iou_before, alone.iou_after), abs=1e-3)
        assert found.chamfer_to_initial == pytest.approx(alone.chamfer_to_initial, rel=1e-3)


def test_in_a_batch_one_that_cannot_be_refined_stops_no_other(chair, monkeypatch):
    points, mask, camera = chair
    behind = Camera(camera.K, camera.R, camera.t - [0.0, 0.0, 9.0], camera.width, camera.height)
    scenes = [(points, View(mask, camera)), (points, View(mask, behind)), (np.full((5, 3), np.nan), View(mask, camera))]
    good, unseen, nothing = refine_batch(scenes, RefineConfig(steps=3))
    assert good.loss_after < good.loss_before
    assert isinstance(unseen, InputError)
    assert "behind the camera" in str(unseen)
    assert "points of scene 2" in str(nothing)
    calls = iter(range(1000))
    true_call = SilhouetteObjective.__call__

    def failing(self, moved):
        return true_call(self, moved) * torch.tensor([1.0, torch.nan if next(calls) >= 3 else 1.0])

    monkeypatch.setattr(SilhouetteObjective, "__call__", failing)
    whole, broken = refine_batch([scenes[0], scenes[0]], PAPER)
    assert (whole.stop_reason, whole.steps) == ("max_steps", 50)
    assert (broken.stop_reason, broken.steps, broken.best_step) == ("non_finite", 2, 2)
    assert np.isfinite(broken.points).all()
    np.testing.assert_allclose(whole.points, refine_batch([scenes[0]] * 2, PAPER)[0].points, atol=1e-5)


def test_a_batch_refines_by_the_best_preset_as_one_at_a_time_does(chair):
    points, mask, camera = chair
    scenes = [(points, View(mask, camera)), (points[:900] * 0.9, View(mask, camera))]
    for found, (own, views) in zip(refine_batch(scenes), scenes, strict=True):
        alone = refine(own, views)
        # Which of two points is nearer can hang on a last bit, and what follows with it: the same quality, not the same bits.
        assert found.loss_after == pytest.approx(alone.loss_after, rel=0.02)
        assert found.symmetry == pytest.approx(alone.symmetry)
        np.testing.assert_allclose(found.points, alone.points, atol=0.05)


@pytest.mark.parametrize("preset", PRESETS)
def test_clouds_that_are_their_own_nodes_move_beside_larger_ones_as_alone(chair, preset):
    points, mask, camera = chair
    larger = np.concatenate([points, points * 0.99])[:1500]
    scenes = [(points[:800], View(mask, camera)), (larger, View(mask, camera))]
    config = RefineConfig(preset=preset, steps=6, symmetry="none")
    for found, (own, views) in zip(refine_batch(scenes, config), scenes, strict=True):
        np.testing.assert_allclose(found.points, refine(own, views, config=config).points, atol=1e-4)


@pytest.mark.parametrize("width", [1, 2, 3])
def test_a_pole_thinner_than_a_pixel_of_the_loop_is_moved_onto_its_mask(width):
    rng = np.random.default_rng(0)
    pole = rng.uniform(-1.0, 1.0, (300, 3)) * [0.005, 0.5, 0.005]
    rows = np.arange(20, 236)
    mask = np.zeros((256, 256), np.float32)
    for across in range(width):
        mask[rows, rows // 6 + 106 + across] = 1.0
    camera = Camera.canonical(256, 256)
    result = refine(pole, mask, camera)
    off = []
    for cloud in (pole, result.points):
        column, row = camera.project(cloud)[0].T
        off.append(np.abs(column - row / 6 - 106.0 - 0.5 * (width - 1)).mean())
    assert off[1] < 0.9 * off[0]


def test_an_ignore_map_that_leaves_no_pixel_of_the_loop_is_refused(chair):
    points, mask, camera = chair
    every_fourth = np.arange(256)[:, None] % 4 + np.arange(256) % 4 == 0
    with pytest.raises(InputError, match="front: no pixel is known to be foreground when it is worked on at 64x64"):
        refine(points, View(mask, camera, every_fourth, name="front"))


def test_what_no_picture_shows_stays_nearly_where_it_was():
    """A long bar goes out of the picture on the left; the picture wants it higher where it shows it."""
    axes = np.linspace(-2.0, 0.4, 120), np.linspace(-0.1, 0.1, 5), np.linspace(-0.1, 0.1, 4)
    bar = np.stack(np.meshgrid(*axes), -1).reshape(-1, 3)
    camera = look_at(0.0, 0.0, 2.2, (64, 64))
    seen = camera.project(bar)[0][:, 0] > -0.5
    assert 0.3 < seen.mean() < 0.7
    mask = (silhouette_of(bar + [0.0, 0.06, 0.0], camera) > 0.5).astype(np.float32)
    config = RefineConfig(symmetry="none", coarse_to_fine=replace(BEST, least_prior_weight=0.0, most_prior_weight=0.0))
    moved = refine(bar, mask, camera, config).points[:, 1] - bar[:, 1]
    assert moved[seen].mean() > 0.02
    assert np.abs(moved[~seen]).mean() < 0.15 * moved[seen].mean()


@pytest.mark.parametrize("masks", [1, 2])
def test_the_result_is_a_mean_over_the_stages_and_the_last_counts_for_more_where_there_are_more_masks(chair, masks):
    points, mask, camera = chair
    side = look_at(90.0, 10.0, 2.0, (64, 64))
    views = [View(mask, camera), View((silhouette_of(points * [1.0, 1.1, 1.0], side) > 0.5).astype(np.float32), side)][:masks]

    def refined(*shares):
        stages = tuple(replace(stage, averaging_weight=share) for stage, share in zip(BEST.stages, shares, strict=True))
        recipe = replace(BEST, stages=stages, least_prior_weight=0.0)
        return refine(points, views, config=RefineConfig(symmetry="none", coarse_to_fine=recipe))

    alone = [refined(*(1.0 if one == stage else 1e-12 for one in range(3))).points for stage in range(3)]
    found = refined(1.0, 2.0, 3.0)
    shares = np.array([1.0, 2.0, 3.0 * sum(found.view_weights) ** 2])
    assert sum(found.view_weights) > 0.95 * masks
    expected = np.einsum("s,snk->nk", shares / shares.sum(), alone)
    np.testing.assert_allclose(found.points, expected, atol=1e-6)
    assert np.abs(alone[0] - alone[2]).max() > 1e-3


def test_a_flipped_mask_counts_for_a_quarter_and_a_depth_map_as_a_mask(chair):
    points, mask, camera = chair
    depth = np.where(mask > 0.5, camera.t[2], 0.0)

    def pictures(views, symmetry="none", weights=(1.0, 1.0)):
        item = Problem.of(Cloud(points, "points"), tuple(views), RefineConfig(symmetry=symmetry).settings())
        return item.evidence(list(weights[: len(views)]))

    one, deep = View(mask, camera), View(mask, camera, depth=depth)
    assert pictures([one]) == 1.0
    assert pictures([one, one]) == 2.0
    assert pictures([one], "x") == 1.25
    assert pictures([deep]) == 2.0
    assert pictures([one, deep], "x") == 3.5
    assert pictures([one, deep], "x", (0.5, 0.1)) == pytest.approx(0.5 * 1.25 + 0.1 * 2.25)


@pytest.mark.parametrize("seed", range(20))
def test_what_takes_no_step_keeps_every_bit(chair, seed):
    _, mask, camera = chair
    points = np.random.default_rng(seed).uniform(-0.4, 0.4, (200, 3))
    np.testing.assert_array_equal(refine(points, mask, camera, RefineConfig(steps=0, symmetry="none")).points, points)


def test_the_more_pictures_there_are_the_less_a_start_that_is_far_off_is_held(chair):
    points, mask, camera = chair
    cloud = Cloud(points, "points")
    working = [Problem.of(cloud, (View(mask, camera),), RefineConfig(symmetry="none").settings()).resampled]
    first, counts = torch.tensor(cloud.normalised(), dtype=torch.float32)[None], torch.tensor([len(points)])
    targets, field = ViewTargets(working, counts, first), SmoothField(first, counts)
    recipe = replace(BEST, prior_weight=1e-6, by_area=False)
    for pictures in (1.0, 1.25, 2.0):
        found = position_prior(first, counts, targets, field, recipe, torch.tensor([pictures])).weights
        expected = torch.full_like(found, BEST.least_prior_weight / pictures**2 * 1024 / len(points))
        torch.testing.assert_close(found, expected)


def _cut_off(view: View) -> View:
    """The same picture without its upper half: the border goes through the object."""
    camera, half = view.camera, view.mask.shape[0] // 2
    lower = replace(camera, K=camera.K - [[0.0, 0.0, 0.0], [0.0, 0.0, half], [0.0, 0.0, 0.0]], height=camera.height - half)
    return View(view.mask[half:], lower)


def test_an_object_that_the_border_cuts_is_held_three_times_as_tightly(chair):
    points, mask, camera = chair
    cloud = Cloud(points, "points")
    first, counts = torch.tensor(cloud.normalised(), dtype=torch.float32)[None], torch.tensor([len(points)])
    field, recipe = SmoothField(first, counts), replace(BEST, prior_weight=1e-6, by_area=False)
    held = []
    for view in (View(mask, camera), _cut_off(View(mask, camera))):
        working = [Problem.of(cloud, (view,), RefineConfig(symmetry="none").settings()).resampled]
        held.append(position_prior(first, counts, ViewTargets(working, counts, first), field, recipe).weights)
    torch.testing.assert_close(held[1], 3.0 * held[0])


@pytest.mark.parametrize(("cut", "expected"), [((True, True), 1.0), ((True, False), 2.0), ((False, False), 2.0)])
def test_what_is_cut_off_in_all_pictures_is_as_unknown_with_two_as_with_one(chair, monkeypatch, cut, expected):
    points, mask, camera = chair
    side = look_at(90.0, 10.0, 3.0, (64, 64))
    views = [View(mask, camera), View((silhouette_of(points, side) > 0.5).astype(np.float32), side)]
    told = []

    def spied(*arguments):
        told.append(float(arguments[-1][0]))
        return position_prior(*arguments)

    monkeypatch.setattr("tso_cli.refinement.coarse_to_fine.position_prior", spied)
    shown = [_cut_off(view) if gone else view for view, gone in zip(views, cut, strict=True)]
    refine(points, shown, config=RefineConfig(steps=3, symmetry="none"))
    assert told == [pytest.approx(expected, rel=0.05)] * len(told)
    assert told
