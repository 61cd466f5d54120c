"""The weights of views: which of them are held to be wrong, and which are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.view import View
from tso_cli.io.cameras import read_camera
from tso_cli.io.clouds import read_cloud
from tso_cli.refinement import RefineConfig, refine, refine_batch
from tso_cli.refinement.cloud import Cloud
from tso_cli.refinement.problem import Problem
from tso_cli.refinement.resampled_view import resample_view
from tso_cli.refinement.view_weights import ViewWeights, inlier_weights, shared_weights
from tso_cli.silhouette.projection import silhouette_of

EXAMPLES = Path(__file__).parents[2] / "examples"
APART = torch.eye(5, dtype=torch.float64)[None, :4]  # four gradients of which none helps another
LOSSES = torch.tensor([[1.0, 1.1, 0.9, 6.0]], dtype=torch.float64)


@pytest.fixture(scope="module")
def chair():
    return _seen_around("chair")


@pytest.fixture(scope="module")
def car():
    return _seen_around("car")


def _seen_around(name: str):
    """The initial cloud of an example, its target, and four views of the target around it."""
    points, target = (read_cloud(EXAMPLES / name / file).points for file in ("initial.ply", "target.ply"))
    camera = read_camera(EXAMPLES / name / "camera.json", 256, 256).resized(64, 64)
    return points, target, [_seen(target, _turned(camera, degrees)) for degrees in (0.0, 70.0, 150.0, 240.0)]


def _turned(camera: Camera, degrees: float) -> Camera:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return replace(camera, R=camera.R @ [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _seen(cloud: np.ndarray, camera: Camera) -> View:
    return View(silhouette_of(cloud, camera), camera)


def weighed(points: np.ndarray, views: list[View]) -> ViewWeights:
    """At the start, of one cloud."""
    cloud = Cloud(points, "points", colours=np.full_like(points, 0.5))
    working = Problem.of(cloud, tuple(views), RefineConfig(symmetry="none").settings()).resampled
    first = torch.tensor(cloud.normalised(), dtype=torch.float32)[None]
    return ViewWeights.of([working], torch.tensor([len(points)]), first)


def doubted(points: np.ndarray, views: list[View]) -> list[float]:
    return weighed(points, views).inlier[0].tolist()


BALL = np.random.default_rng(0).normal(size=(300, 3))
BALL *= 0.4 / np.linalg.norm(BALL, axis=1, keepdims=True)
LEVEL = replace(Camera.canonical(64, 64), R=np.diag([1.0, -1.0, -1.0]))


def divided(*degrees: float, **more: object) -> list[float]:
    """Weights of cameras turned about a ball by so many degrees."""
    views = [replace(_seen(BALL, _turned(LEVEL, turn)), **more) for turn in degrees]
    return weighed(BALL, views).loss[0].tolist()


def test_pictures_from_one_place_share_the_weight_of_one_and_one_from_the_side_keeps_its_own():
    assert divided(30.0) == [1.0]
    assert divided(30.0, 30.0, 30.0, 120.0) == pytest.approx([1 / 3, 1 / 3, 1 / 3, 1.0])


def test_a_silhouette_from_behind_tells_what_that_from_the_front_does_and_a_depth_map_and_a_photo_do_not():
    assert divided(0.0, 180.0) == pytest.approx([0.5, 0.5], abs=1e-3)
    assert divided(0.0, 180.0, depth=np.full((64, 64), 1.6)) == pytest.approx([1.0, 1.0])
    assert divided(0.0, 180.0, image=np.full((64, 64, 3), 0.5, np.float32)) == pytest.approx([1.0, 1.0])
    assert divided(0.0, 0.0, depth=np.full((64, 64), 1.6)) == pytest.approx([0.5, 0.5])


def test_the_further_apart_two_cameras_are_the_more_their_pictures_count():
    both = [sum(divided(0.0, turn)) for turn in (0.0, 10.0, 20.0, 45.0, 90.0)]
    assert both == sorted(both)
    assert both[0] == pytest.approx(1.0)
    assert both[1] < 1.1
    assert both[3] > 1.85
    assert both[4] == pytest.approx(2.0)


def test_pictures_of_different_parts_from_one_place_share_nothing():
    view = _seen(BALL, LEVEL)
    left = np.zeros(view.mask.shape, bool)
    left[:, :32] = True
    halves = [replace(view, known=left), replace(view, known=~left)]
    assert weighed(BALL, halves).loss[0].tolist() == [1.0, 1.0]
    # What the whole picture tells is told once more by each of its halves.
    whole = weighed(BALL, [view, *halves]).loss[0]
    assert float(whole[0]) == pytest.approx(0.5, abs=0.01)


def test_views_that_tell_the_same_count_together_as_the_most_trusted_of_them_alone():
    same = torch.ones(1, 3, 3, dtype=torch.float64)
    for trust in ([1.0, 1.0, 1.0], [1.0, 0.5, 0.5], [0.3, 1e-9, 0.2]):
        found = shared_weights(torch.tensor([trust], dtype=torch.float64), same)[0]
        assert float(found.sum()) == pytest.approx(max(trust))


def test_views_that_tell_nothing_alike_keep_their_trust():
    trust = torch.tensor([[1.0, 0.5, 1e-12]], dtype=torch.float64)
    torch.testing.assert_close(shared_weights(trust, torch.eye(3, dtype=torch.float64)[None]), trust)


def test_an_orthographic_camera_looks_along_its_axis_wherever_it_stands():
    camera = replace(LEVEL, model="orthographic", K=np.array([[40.0, 0.0, 31.5], [0.0, 40.0, 31.5], [0.0, 0.0, 1.0]]))
    aside = replace(camera, t=np.array([0.2, 0.1, 9.0]))
    assert weighed(BALL, [_seen(BALL, camera), _seen(BALL, aside)]).loss[0].tolist() == pytest.approx([0.5, 0.5])


def test_four_pictures_of_one_side_move_a_cloud_hardly_further_than_one_does(chair, monkeypatch):
    points, target, (view, *_) = chair
    near = [_seen(target, _turned(view.camera, turn)) for turn in (0.0, 4.0, 8.0, 12.0)]

    def way(views):
        return (
            float(np.square(refine(points, views, config=RefineConfig(symmetry="none")).points - points).sum(1).mean()) ** 0.5
        )

    once, often = way(near[:1]), way(near)
    assert often < 1.3 * once
    monkeypatch.setattr("tso_cli.refinement.view_weights.REDUNDANCY_POWER", 1e9)
    assert way(near) > 1.5 * once


def test_losses_that_are_much_alike_all_count_in_square():
    losses = torch.tensor([[1.0, 1.2, 0.8, 1.4]], dtype=torch.float64)
    torch.testing.assert_close(inlier_weights(losses, APART), torch.ones_like(losses))


def test_a_view_of_great_loss_whose_gradient_no_other_shares_is_discounted_alone():
    weights = inlier_weights(LOSSES, APART)[0]
    torch.testing.assert_close(weights[:3], torch.ones(3, dtype=torch.float64))
    assert weights[3] == pytest.approx((1.5 / (6.0 / 1.05)) ** 4)


def test_a_view_of_great_loss_whose_gradient_the_others_share_counts_in_square():
    pulls = APART.clone()
    pulls[0, 3, :3] = 1.0
    torch.testing.assert_close(inlier_weights(LOSSES, pulls), torch.ones_like(LOSSES))


def test_the_unit_of_losses_and_of_each_gradient_is_of_no_matter():
    scaled = inlier_weights(1e-6 * LOSSES, APART * torch.tensor([1.0, 1e3, 1e-3, 7.0], dtype=torch.float64)[:, None])
    torch.testing.assert_close(scaled, inlier_weights(LOSSES, APART))


def test_the_size_of_an_object_in_the_picture_knows_no_resolution(chair):
    _, _, (view, *_) = chair
    finer = View(view.mask.repeat(2, 0).repeat(2, 1), view.camera.resized(128, 128))
    far = View(view.mask, replace(view.camera, t=view.camera.t * [1.0, 1.0, 2.0]))
    size, same, half = (resample_view(v, 0.4, np.zeros(3), 1.0).magnification for v in (view, finer, far))
    assert same == pytest.approx(size)
    assert half == pytest.approx(size / 2)
    assert size == pytest.approx(120.0 / view.camera.t[2])


def test_right_views_cost_nothing(chair):
    points, _, views = chair
    assert doubted(points, views) == pytest.approx([1.0] * 4, abs=0.02)


def _with_a_wrong_one(views: list[View], target: np.ndarray, what: str) -> list[View]:
    if what == "a camera turned by 40 degrees":
        wrong = View(views[1].mask, _turned(views[1].camera, 40.0))
    else:
        wrong = _seen(target[:, [1, 2, 0]] * [1.3, 0.5, 1.0], views[1].camera)
    return [views[0], wrong, *views[2:]]


@pytest.mark.parametrize("what", ["a camera turned by 40 degrees", "a mask of something else"])
def test_a_wrong_view_among_four_is_discounted_and_no_other(car, what):
    points, target, views = car
    weights = doubted(points, _with_a_wrong_one(views, target, what))
    assert weights[1] < 0.3
    assert min(np.delete(weights, 1)) > 0.9


def test_a_mask_of_something_else_spoils_less_than_if_it_were_trusted(car, monkeypatch):
    points, target, views = car
    mixed = _with_a_wrong_one(views, target, "a mask of something else")
    doubting = refine(points, mixed)
    monkeypatch.setattr("tso_cli.refinement.view_weights.FEWEST_TO_JUDGE", 99)
    trusting = refine(points, mixed)
    assert trusting.view_weights[1] > doubting.view_weights[1]
    assert chamfer(doubting.points, target).chamfer < chamfer(trusting.points, target).chamfer


def test_pictures_of_one_side_are_trusted_and_share_a_weight(chair):
    points, _, (view, *_) = chair
    found = refine(points, [view, view, view], config=RefineConfig(steps=0))
    assert found.view_trust == [1.0] * 3
    assert found.view_weights == pytest.approx([1 / 3] * 3)


def test_of_two_views_neither_is_doubted(chair):
    points, _, views = chair
    bad = View(views[1].mask, _turned(views[1].camera, 40.0))
    assert doubted(points, [views[0], bad]) == [1.0, 1.0]


def test_in_a_batch_each_cloud_has_weights_and_scores_of_its_own(chair):
    points, target, views = chair
    large = _seen(target, views[3].camera.resized(96, 80))
    bad = View(views[1].mask, _turned(views[1].camera, 40.0))
    scenes = [(points, [*views[:3], large]), (points[::2], [views[0], bad, views[2], large])]
    config = RefineConfig(steps=12)  # more of them make much of the last bits
    for found, scene in zip(refine_batch(scenes, config), scenes, strict=True):
        alone = refine(*scene, config=config)
        assert found.view_weights == pytest.approx(alone.view_weights, rel=1e-3)
        np.testing.assert_allclose(found.view_ious, alone.view_ious, atol=2e-3)
        assert found.iou_after == pytest.approx(np.mean(found.view_ious, 0)[1])


def test_ious_stand_in_the_order_of_the_views_whatever_their_sizes(chair):
    points, target, views = chair
    mixed = [views[0], _seen(target, views[1].camera.resized(96, 80)), views[2]]
    expected = [refine(points, view).view_ious[0][0] for view in mixed]
    assert [before for before, _ in refine(points, mixed).view_ious] == pytest.approx(expected)
