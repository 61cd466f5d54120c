"""Where a cloud projects in a view."""

from dataclasses import replace

import numpy as np
import pytest

from tests.corruption import assert_refused
from tests.scenes import block
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.diagnosis.placement import behind_warnings, box_iou, place, require_overlap


def test_points_are_counted_behind_the_camera_inside_the_image_and_on_the_mask(cloud):
    view = View(block(np.s_[24:40, 24:40]), Camera.canonical(64, 64))
    points = np.vstack([cloud, [[0.0, 0.0, 3.0], [5.0, 0.0, 0.0]]])
    placement = place(points, view)
    assert (placement.points, placement.behind, placement.inside_image) == (502, 1, 500)
    pixels = np.rint(view.camera.project(cloud)[0]).astype(int)
    assert placement.inside_mask == int((view.mask[pixels[:, 1], pixels[:, 0]] > 0.5).sum())
    assert placement.mask_box == (23.5, 23.5, 39.5, 39.5)


@pytest.mark.parametrize(
    ("other", "iou"), [((0, 0, 2, 2), 1.0), ((1, 0, 3, 2), 1 / 3), ((3, 0, 4, 2), 0.0)]
)
def test_the_iou_of_boxes(other, iou):
    assert box_iou((0, 0, 2, 2), other) == pytest.approx(iou, rel=1e-15, abs=0.0)


@pytest.mark.parametrize(
    ("move", "words"),
    [
        ((0, 0, 5.0), "all 500 points lie behind"),
        ((9.0, 0, 0), "no point falls inside"),
        ((0.42, -0.4, 0), "hardly meet"),
    ],
)
def test_a_cloud_that_misses_the_mask_is_refused_with_advice(cloud, move, words):
    view = View(block(np.s_[4:12, 4:12]), Camera.canonical(64, 64), name="mask.png")
    assert_refused(
        f"mask.png: .*{words}.*OpenCV", require_overlap, place(cloud * 0.2 + move, view), view
    )


def test_a_cloud_that_meets_one_part_of_a_mask_is_refused_with_advice_to_leave_out_the_rest(cloud):
    camera = Camera.canonical(64, 64)
    mask = block(np.s_[30:34, 30:34])
    mask[2, 2] = 1.0
    view = View(mask, camera, name="mask.png")
    columns = camera.project(cloud * 0.13)[0][:, 0]
    assert 2.0 < np.ptp(columns) < 6.0
    assert_refused(
        "hardly meet.*; try --assume X",
        require_overlap,
        place(cloud * 0.13, view),
        view,
        "try --assume X",
    )
    refused = r"meets a part of the mask \(columns 30 to 34, rows 30 to 34\).*--ignore"
    assert_refused(refused, require_overlap, place(cloud * 0.13, view), view)


def test_a_part_that_runs_through_the_cloud_does_not_hide_the_part_that_it_meets(cloud):
    mask = block(np.s_[20:24, 30:34]) + block(np.s_[:, 35:40]) + block(np.s_[4:6, 4:6])
    view = View(mask, Camera.canonical(64, 64), name="mask.png")
    placement = replace(place(cloud * 0.2, view), points_box=(29.5, 19.5, 37.5, 23.5), box_iou=0.0)
    refused = r"meets a part of the mask \(columns 30 to 34, rows 20 to 24\).*--ignore"
    assert_refused(refused, require_overlap, placement, view)


def test_a_cloud_on_both_sides_of_the_image_is_refused():
    """Its box covers the image, on which none of its points falls."""
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (40, 3)) + np.where(
        np.arange(40) % 2, 3.0, -3.0
    )[:, None] * [1, 0, 0]
    view = View(block(np.s_[20:44, 20:44]), Camera.canonical(64, 64))
    assert_refused(
        "no point falls inside the 64x64 image", require_overlap, place(points, view), view
    )


def test_points_behind_the_camera_are_warned_of(cloud):
    view = View(block(np.s_[20:44, 20:44]), Camera.canonical(64, 64))
    points = np.vstack([cloud, [[0.0, 0.0, 3.0]]])
    placement = place(points, view)
    require_overlap(placement, view)
    assert behind_warnings(placement, view) == [
        "mask: 1 of 501 points lie behind the camera and take no part"
    ]
    # Fewer would be outliers.
    clump = np.vstack([cloud, np.random.default_rng(0).normal([0.0, 0.0, 3.0], 0.01, (300, 3))])
    with pytest.warns(UserWarning, match="300 of 800 points lie behind the camera"):
        refine(clump, view, config=RefineConfig(steps=0))
