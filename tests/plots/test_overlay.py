"""The picture of a refinement shows what is near, and shows it where it is."""

import numpy as np
import pytest
from PIL import Image

from tests.scenes import block, in_photo, seen
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.evaluation.footprint import WindowImages
from tso_cli.plots import overlay
from tso_cli.plots.overlay import PANEL, compare, draw_overlay


def _panel(*points):
    return np.asarray(overlay._dots(*np.array(points, float).T))


@pytest.mark.parametrize("order", [1, -1])
def test_a_nearer_point_hides_a_farther_one(order):
    points = [(0.0, 0.0, -0.5), (0.0, 0.0, 0.5), (0.9, 0.9, 0.2)][::order]
    np.testing.assert_array_equal(_panel(*points)[PANEL // 2, PANEL // 2], overlay.NEAR_TO_FAR[0])


def test_a_point_is_drawn_to_the_right_and_down_of_the_middle_as_far_as_it_lies():
    panel = _panel((0.5, -0.8, 1.0), (0.5, -0.8, 1.0))
    rows, columns = np.nonzero((panel < 255).any(2))
    assert rows.mean() == pytest.approx(0.1 * PANEL, abs=1.0)
    assert columns.mean() == pytest.approx(0.75 * PANEL, abs=1.0)


def test_the_dots_of_a_large_cloud_are_small_but_there():
    many = np.random.default_rng(0).uniform(-0.9, 0.9, (100_000, 3))
    assert (_panel(*many) < 255).any(2).mean() > 0.5


@pytest.mark.parametrize("height", [10, 1000])
def test_an_image_fills_its_panel_and_keeps_its_shape(height):
    image = overlay._fitted(
        np.repeat([[(0.0, 0.0, 0.0)] * height + [(1.0, 0.5, 0.0)] * height], height, axis=0)
    )
    assert image.size == (PANEL, PANEL // 2)
    assert image.getpixel((0, 3)) == (0, 0, 0)
    assert image.getpixel((PANEL - 1, 3)) == (255, 128, 0)


POINTS = np.random.default_rng(0).uniform(-0.3, 0.3, (400, 3))


def _drawn(folder, views):
    """The picture of a cloud and its views."""
    draw_overlay(folder / "picture.png", refine(POINTS, views, config=RefineConfig(steps=0)), views)
    with Image.open(folder / "picture.png") as picture:
        return np.asarray(picture)


@pytest.mark.parametrize(("count", "rows"), [(1, 2), (3, 3), (8, 6)])
def test_one_view_gets_a_row_before_and_one_after_and_several_a_row_each(count, rows, tmp_path):
    views = [seen(1.1 * POINTS, Camera.canonical(size, 20)) for size in range(20, 20 + count)]
    assert len(_drawn(tmp_path, views)) // PANEL == rows


def test_mask_and_silhouette_differ_in_colour():
    silhouette, mask, known = (
        np.array([row], bool) for row in ([1, 0, 1, 0, 1], [1, 1, 0, 0, 1], [1, 1, 1, 1, 0])
    )
    agreed, missing, extra, unknown = overlay.COLOURS.values()
    expected = [[agreed, missing, extra, (1.0, 1.0, 1.0), unknown]]
    np.testing.assert_array_equal(compare(WindowImages(silhouette, mask, known)), expected)


@pytest.mark.parametrize("times", [1, 8])
def test_the_object_fills_its_panel_in_a_photo_of_any_size(times, tmp_path):
    photo = in_photo(View(block(np.s_[20:46, 20:46]), Camera.canonical(64, 64)), times, 0, 0)
    panel = _drawn(tmp_path, [photo])[
        overlay.TITLE : overlay.TITLE + PANEL, overlay.GAP : overlay.GAP + PANEL
    ]
    agreed = (panel == np.rint(255.0 * np.array(overlay.COLOURS["agree"]))).all(2).mean()
    assert 0.25 < agreed < 0.8


def test_a_photo_is_dimmed_behind_mask_and_silhouette_and_the_colours_stay_apart():
    silhouette, mask = np.array([[1, 0, 1, 0]], bool), np.array([[1, 1, 0, 0]], bool)
    for level in (0, 255):
        photo = np.full((1, 4, 3), level, np.uint8)
        picture = compare(WindowImages(silhouette, mask, None), photo)
        agreed, missing, extra = list(overlay.COLOURS.values())[:3]
        for shown, colour in zip(picture[0], (agreed, missing, extra), strict=False):
            others = [one for one in (agreed, missing, extra) if one != colour]
            nearest = min(np.abs(shown - one).max() for one in others)
            assert np.abs(shown - colour).max() < nearest
        assert picture[0, 3, 0] == pytest.approx(1.0 if level else 1.0 - overlay.PHOTO)


def test_the_photo_lies_where_its_mask_lies_whatever_its_resolution():
    camera, box = Camera.canonical(64, 64), (9.5, 19.5, 39.5, 49.5)
    for times in (1, 4):
        photo = np.zeros((64 * times, 64 * times, 3), np.uint8)
        photo[30 * times : 40 * times, 20 * times : 32 * times] = 200
        shown = overlay.photo_in_window(photo, camera, box)
        expected = np.zeros((30, 30))
        expected[10:20, 10:22] = 200
        np.testing.assert_array_equal(shown[..., 0], expected)
    assert overlay.photo_in_window(None, camera, box) is None
