"""The weights of views: which of them are held to be wrong, and which are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tso_cli.camera import Camera
from tso_cli.files.cameras import read_camera
from tso_cli.files.clouds import read_cloud
from tso_cli.metrics import chamfer
from tso_cli.objective import working_view
from tso_cli.projection import silhouette_of
from tso_cli.refinement import RefineConfig, refine, refine_batch
from tso_cli.scene import View
from tso_cli.weighting import view_weights

EXAMPLES = Path(__file__).parents[1] / "examples"
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


def test_losses_that_are_much_alike_all_count_in_full():
    losses = torch.tensor([[1.0, 1.2, 0.8, 1.4]], dtype=torch.float64)
    torch.testing.assert_close(view_weights(losses, APART), torch.ones_like(losses))


def test_a_view_of_great_loss_whose_gradient_no_other_shares_is_discounted_alone():
    weights = view_weights(LOSSES, APART)[0]
    torch.testing.assert_close(weights[:3], torch.ones(3, dtype=torch.float64))
    assert weights[3] == pytest.approx((1.5 / (6.0 / 1.05)) ** 4)


def test_a_view_of_great_loss_whose_gradient_the_others_share_counts_in_full():
    pulls = APART.clone()
    pulls[0, 3, :3] = 1.0
    torch.testing.assert_close(view_weights(LOSSES, pulls), torch.ones_like(LOSSES))


def test_the_unit_of_losses_and_of_each_gradient_is_of_no_matter():
    scaled = view_weights(1e-6 * LOSSES, APART * torch.tensor([1.0, 1e3, 1e-3, 7.0], dtype=torch.float64)[:, None])
    torch.testing.assert_close(scaled, view_weights(LOSSES, APART))


def test_the_size_of_an_object_in_the_picture_knows_no_resolution(chair):
    _, _, (view, *_) = chair
    finer = View(view.mask.repeat(2, 0).repeat(2, 1), view.camera.resized(128, 128))
    far = View(view.mask, replace(view.camera, t=view.camera.t * [1.0, 1.0, 2.0]))
    size, same, half = (working_view(v, None, np.zeros(3), 1.0).size for v in (view, finer, far))
    assert same == pytest.approx(size)
    assert half == pytest.approx(size / 2)
    assert size == pytest.approx(120.0 / view.camera.t[2])


def test_right_views_cost_nothing(chair):
    points, _, views = chair
    assert refine(points, views).view_weights == pytest.approx([1.0] * 4, abs=0.02)


def _with_a_wrong_one(views: list[View], target: np.ndarray, what: str) -> list[View]:
    if what == "a camera turned by 40 degrees":
        wrong = View(views[1].mask, _turned(views[1].camera, 40.0))
    else:
        wrong = _seen(target[:, [1, 2, 0]] * [1.3, 0.5, 1.0], views[1].camera)
    return [views[0], wrong, *views[2:]]


@pytest.mark.parametrize("what", ["a camera turned by 40 degrees", "a mask of something else"])
def test_a_wrong_view_among_four_is_discounted_and_no_other(car, what):
    points, target, views = car
    weights = refine(points, _with_a_wrong_one(views, target, what), config=RefineConfig(steps=0)).view_weights
    assert weights[1] < 0.3
    assert min(np.delete(weights, 1)) > 0.9


def test_a_mask_of_something_else_spoils_less_than_if_it_were_trusted(car, monkeypatch):
    points, target, views = car
    mixed = _with_a_wrong_one(views, target, "a mask of something else")
    doubting = refine(points, mixed)
    monkeypatch.setattr("tso_cli.weighting.FEWEST_TO_JUDGE", 99)
    trusting = refine(points, mixed)
    assert trusting.view_weights == [1.0] * 4
    assert chamfer(doubting.points, target).chamfer < chamfer(trusting.points, target).chamfer


def test_of_two_views_neither_is_doubted(chair):
    points, _, views = chair
    bad = View(views[1].mask, _turned(views[1].camera, 40.0))
    assert refine(points, [views[0], bad]).view_weights == [1.0, 1.0]


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
