"""Where a cloud projects in a view, and why cloud and mask do not meet."""

import numpy as np
import pytest

from tests.scenes import block
from tso_cli import Camera, View
from tso_cli.diagnosis.placement import box_iou, describe_box, place, why_apart

CANONICAL = Camera.canonical(64, 64)


def test_points_are_counted_behind_the_camera_inside_the_image_and_on_the_mask(cloud):
    view = View(block(np.s_[24:40, 24:40]), CANONICAL)
    points = np.vstack([cloud, [[0.0, 0.0, 3.0], [5.0, 0.0, 0.0]]])
    placement = place(points, view)
    assert placement.points == 502
    assert placement.behind == 1
    assert placement.inside_image == 500
    pixels = np.rint(view.camera.project(cloud)[0]).astype(int)
    on_mask = view.mask[pixels[:, 1], pixels[:, 0]] > 0.5
    assert placement.inside_mask == np.count_nonzero(on_mask)
    assert placement.mask_box == (23.5, 23.5, 39.5, 39.5)
    assert placement.meets
    assert why_apart(placement, view) is None


@pytest.mark.parametrize(
    ("other", "iou"), [((0, 0, 2, 2), 1.0), ((1, 0, 3, 2), 1 / 3), ((3, 0, 4, 2), 0.0)]
)
def test_the_iou_of_boxes(other, iou):
    assert box_iou((0, 0, 2, 2), other) == pytest.approx(iou, rel=1e-15, abs=0.0)


def test_a_box_in_words():
    assert describe_box((29.5, -0.5, 33.5, 12.0)) == "columns 30 to 33, rows 0 to 12"


@pytest.mark.parametrize(
    ("move", "words"),
    [
        ((0.0, 0.0, 5.0), "all 500 points lie behind the camera"),
        ((9.0, 0.0, 0.0), "no point falls inside the 64x64 image"),
        ((0.42, -0.4, 0.0), "hardly meet: IoU of the boxes 0.000, expected over 0.05"),
    ],
)
def test_why_a_cloud_misses_the_mask(cloud, move, words):
    view = View(block(np.s_[4:12, 4:12]), CANONICAL)
    placement = place(cloud * 0.2 + move, view)
    assert not placement.meets
    assert words in why_apart(placement, view)


def test_a_cloud_on_both_sides_of_the_image_misses_the_mask():
    """The cloud's box covers the image, and no point of the cloud falls inside."""
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (40, 3))
    points[:, 0] += np.where(np.arange(40) % 2, 3.0, -3.0)
    view = View(block(np.s_[20:44, 20:44]), CANONICAL)
    assert why_apart(place(points, view), view) == "no point falls inside the 64x64 image"
