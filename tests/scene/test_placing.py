"""Placing a network's cloud in front of a camera."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import block, seen
from tso_cli import Camera, View
from tso_cli.scene import placing
from tso_cli.scene.placing import align_silhouette, place_in_front, view_to_world

CANONICAL = Camera.canonical(64, 64)


@pytest.mark.parametrize("focal", [60.0, 120.0, 400.0])
def test_a_cloud_placed_in_front_fills_the_box_of_the_mask(cloud, focal):
    K = np.array([[focal, 0.0, 20.0], [0.0, focal, 40.0], [0.0, 0.0, 1.0]])
    view = View(block(np.s_[30:52, 10:32]), Camera(K, np.eye(3), np.zeros(3), 64, 64))
    placed = place_in_front(cloud, view)
    pixels, depth = placed.project(cloud)
    assert np.ptp(pixels, axis=0).max() + 1.0 == pytest.approx(22.0, abs=1e-3) and depth.min() > 0.0
    np.testing.assert_allclose((pixels.min(0) + pixels.max(0)) / 2, [20.5, 40.5], atol=1e-3)


def test_the_way_back_to_the_world_keeps_the_picture_and_finds_the_true_size(cloud):
    rotation = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    # an object of longest side 3 about the world's origin, 6 units from the camera
    camera = Camera(Camera.canonical(64, 64).K, rotation, np.array([0.0, 0.0, 6.0]), 64, 64)
    truth = cloud * 3.0
    aligned = truth @ (np.diag([1.0, -1.0, -1.0]) @ rotation).T
    placed = replace(camera, R=np.diag([1.0, -1.0, -1.0]), t=np.array([0.0, 0.0, 2.0]))
    world = view_to_world(aligned / 3.0, placed, camera)
    np.testing.assert_allclose(world, truth, atol=1e-9)
    np.testing.assert_allclose(camera.project(world)[0], placed.project(aligned / 3.0)[0], atol=1e-9)


def test_alignment_finds_the_camera_that_the_mask_was_seen_through(cloud):
    truth = replace(Camera.canonical(64, 64), t=np.array([0.03, -0.02, 2.08]))
    view = replace(seen(cloud, truth), camera=Camera.canonical(64, 64))
    aligned_camera = align_silhouette(cloud, view, steps=60)
    assert (np.abs(aligned_camera.t - truth.t) < [0.01, 0.01, 0.04]).all()
    np.testing.assert_array_equal(aligned_camera.K, view.camera.K)
    np.testing.assert_array_equal(aligned_camera.R, view.camera.R)


def test_alignment_is_not_misled_by_one_stray_point_as_the_box_is(cloud):
    truth = Camera.canonical(64, 64)
    view = seen(cloud, truth)
    stray = np.vstack([cloud, [[0.34, 0.0, 0.0]]])
    boxed = place_in_front(stray, view)
    aligned_camera = align_silhouette(stray, replace(view, camera=boxed), steps=100)
    assert boxed.t[2] > 2.2
    assert abs(aligned_camera.t[2] - 2.0) < 0.2 * abs(boxed.t[2] - 2.0)
    assert abs(aligned_camera.t[0]) < 0.2 * abs(boxed.t[0])


def test_alignment_never_ends_at_a_worse_place_than_it_began(cloud, monkeypatch):
    view = seen(cloud, CANONICAL)
    np.testing.assert_array_equal(align_silhouette(cloud, view, steps=0).t, view.camera.t)
    monkeypatch.setattr(placing, "ALIGNMENT_STEP", 3.0)
    np.testing.assert_array_equal(align_silhouette(cloud, view).t, view.camera.t)


def test_alignment_heeds_no_ignored_pixel(cloud):
    view = seen(cloud, CANONICAL)
    known = np.ones((64, 64), bool)
    known[:, 52:] = False
    expected = align_silhouette(cloud, replace(view, known=known)).t
    changed = np.where(known, view.mask, np.float32(1.0))
    np.testing.assert_array_equal(align_silhouette(cloud, View(changed, CANONICAL, known)).t, expected)
    assert not np.allclose(align_silhouette(cloud, View(changed, CANONICAL)).t, expected, atol=0.01)
