"""Placing a network's cloud in front of a camera."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import block, seen
from tso_cli import Camera, View
from tso_cli.scene import network
from tso_cli.scene.network import align_silhouette, place_in_front, view_to_world

CANONICAL = Camera.canonical(64, 64)


@pytest.mark.parametrize("focal", [60.0, 120.0, 400.0])
def test_a_cloud_placed_in_front_fills_the_box_of_the_mask(cloud, focal):
    K = np.array([[focal, 0.0, 20.0], [0.0, focal, 40.0], [0.0, 0.0, 1.0]])
    view = View(block(np.s_[30:52, 10:32]), Camera(K, np.eye(3), np.zeros(3), 64, 64))
    placed = place_in_front(cloud, view)
    pixels, depth = placed.project(cloud)
    assert np.ptp(pixels, axis=0).max() + 1.0 == pytest.approx(22.0, abs=1e-3)
    assert depth.min() > 0.0
    np.testing.assert_allclose((pixels.min(0) + pixels.max(0)) / 2, [20.5, 40.5], atol=1e-3)


def test_the_way_back_to_the_world_keeps_the_picture_and_finds_the_true_size(cloud):
    rotation = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    # an object of longest side 3 about the world's origin, 6 units from the camera
    camera = replace(CANONICAL, R=rotation, t=np.array([0.0, 0.0, 6.0]))
    aligned = cloud @ (CANONICAL.R @ rotation).T
    world = view_to_world(aligned, CANONICAL, camera)
    np.testing.assert_allclose(world, 3.0 * cloud, atol=1e-9)
    np.testing.assert_allclose(camera.project(world)[0], CANONICAL.project(aligned)[0], atol=1e-9)


def test_alignment_finds_the_camera_that_the_mask_was_seen_through(cloud):
    truth = replace(CANONICAL, t=np.array([0.03, -0.02, 2.08]))
    aligned = align_silhouette(cloud, replace(seen(cloud, truth), camera=CANONICAL), steps=60)
    assert (np.abs(aligned.t - truth.t) < [0.01, 0.01, 0.04]).all()
    np.testing.assert_array_equal([aligned.K, aligned.R], [CANONICAL.K, CANONICAL.R])


def test_alignment_is_not_misled_by_an_outlier_as_the_box_is(cloud):
    view, points = seen(cloud, CANONICAL), np.vstack([cloud, [[0.34, 0.0, 0.0]]])
    boxed = place_in_front(points, view)
    aligned = align_silhouette(points, replace(view, camera=boxed), steps=100)
    assert boxed.t[2] > 2.2
    errors = [np.abs(camera.t - CANONICAL.t)[[0, 2]] for camera in (aligned, boxed)]
    assert (errors[0] < 0.2 * errors[1]).all()


def test_alignment_never_ends_at_a_worse_place_than_it_began(cloud, monkeypatch):
    view = seen(cloud, CANONICAL)
    np.testing.assert_array_equal(align_silhouette(cloud, view, steps=0).t, view.camera.t)
    monkeypatch.setattr(network, "ALIGNMENT_STEP", 3.0)
    np.testing.assert_array_equal(align_silhouette(cloud, view).t, view.camera.t)


def test_alignment_heeds_no_ignored_pixel(cloud):
    view, known = seen(cloud, CANONICAL), block(np.s_[:, :52]) > 0.0
    expected = align_silhouette(cloud, replace(view, known=known)).t
    changed = np.where(known, view.mask, np.float32(1.0))
    np.testing.assert_array_equal(
        align_silhouette(cloud, View(changed, CANONICAL, known)).t, expected
    )
    assert not np.allclose(align_silhouette(cloud, View(changed, CANONICAL)).t, expected, atol=0.01)
