"""The window: lengths are measured in it, so that the size of the photo does not matter."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.scenes import block, example, in_photo
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.diagnosis.findings import Finding
from tso_cli.geometry.view import object_box
from tso_cli.geometry.window import window_of
from tso_cli.optimisation.resampled_view import resample_view


@pytest.mark.parametrize(
    ("name", "preset"), [("car", "paper"), pytest.param("airplane", "best", marks=pytest.mark.slow)]
)
def test_an_object_comes_as_near_to_the_truth_in_a_large_photo_as_in_a_small_one(name, preset):
    shown, config = example(name), RefineConfig(preset=preset)
    views = shown.view, in_photo(shown.view, 8, 1792, 1792)
    errors = np.array(
        [shown.error(refine(shown.points, view, config=config).points) for view in views]
    )
    small, large = errors / shown.error(shown.points)
    assert large == pytest.approx(small, abs=0.02)
    assert max(small, large) < 0.97


def test_the_window_is_a_square_around_mask_and_cloud():
    view = View(block(np.s_[200:280, 300:400], (480, 640)), Camera.canonical(640, 480))
    np.testing.assert_allclose(window_of(view), (287.0, 177.0, 412.0, 302.0))
    cloud = np.repeat([[0.3, 0.1, 0.0], [0.0, 0.0, 0.0]], 200, 0)
    left, top, right, bottom = window_of(view, cloud)
    assert left < 300 < view.camera.project(cloud)[0][:, 0].max() < right
    assert right - left == pytest.approx(bottom - top)


def test_a_few_outliers_do_not_widen_the_window(chair):
    photo = in_photo(chair.view, 8, 896, 537)
    with_outlier = np.vstack([chair.points, chair.points.mean(0) + [1.5, 0.0, 0.0]])
    np.testing.assert_allclose(
        window_of(photo, with_outlier), window_of(photo, chair.points), atol=4.0
    )


def test_the_window_ends_at_the_border_that_truncates_the_object():
    left, top, right, bottom = window_of(View(block(np.s_[14:64, 10:50]), Camera.canonical(64, 64)))
    assert bottom == pytest.approx(63.5)
    assert (left + right) / 2.0 == pytest.approx(29.5)
    assert top == pytest.approx(63.5 - (right - left))


def test_an_image_that_the_object_fills_is_its_own_window():
    view = View(block(np.s_[2:62, 4:60]), Camera.canonical(64, 64))
    assert window_of(view) == pytest.approx((-0.5, -0.5, 63.5, 63.5))
    working = resample_view(view, 0.4, np.zeros(3), 1.0, window_of(view))
    np.testing.assert_array_equal(working.mask, view.mask)
    np.testing.assert_allclose(working.camera.K, view.camera.K)
    assert working.known is None


def test_only_the_borders_of_the_image_truncate_an_object():
    # At a shift of 1 the object ends one pixel from the border, less than half a cell.
    mask = block(np.s_[60:199, 0:40], (200, 200))
    for shift, expected in ((0, True), (1, False), (20, False), (159, False), (160, True)):
        view = View(np.roll(mask, shift, 1), Camera.canonical(200, 200))
        assert resample_view(view, 0.4, np.zeros(3), 1.0).target.truncated == expected


def test_foreground_far_from_the_object_is_left_out_and_reported():
    car = example("car")
    photo = in_photo(car.view, 4, 384, 230)
    mask = photo.mask.copy()
    mask[-40:-38, 30:32] = 1.0
    with_specks = View(mask, photo.camera)
    assert with_specks.box() == photo.box()
    assert with_specks.specks == 4
    assert photo.specks == 0
    result, expected = (
        refine(car.points[::4], view, config=RefineConfig(steps=2)) for view in (with_specks, photo)
    )
    np.testing.assert_array_equal(result.points, expected.points)
    assert result.fit.iou_after == expected.fit.iou_after
    assert result.findings == (Finding("specks", (0,), values={"pixels": 4}),)


def test_parts_of_an_object_are_no_specks():
    thin = block(np.s_[90:110, 20:60], (200, 200)) > 0.0
    thin[100, 60:180] = True  # an aerial, joined to it
    assert object_box(thin) == (20, 90, 180, 110)
    thin[100, 60:65] = False  # now in two parts, but a large one
    assert object_box(thin) == (20, 90, 180, 110)
    assert object_box(block(np.s_[::20, ::20], (200, 200)) > 0.0) == (0, 0, 181, 181)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 39), st.integers(0, 39)), min_size=1, max_size=60))
def test_the_box_of_an_object_holds_nearly_all_of_it(pixels):
    inside = block(tuple(np.array(pixels).T), (40, 40)) > 0.0
    left, top, right, bottom = object_box(inside)
    assert inside[top:bottom, left:right].sum() >= 0.99 * inside.sum()
    assert inside[top].any()
    assert inside[bottom - 1].any()
    assert inside[:, left].any()
    assert inside[:, right - 1].any()


@settings(max_examples=30, deadline=None)
@given(
    st.integers(8, 90),
    st.integers(8, 90),
    st.integers(0, 80),
    st.integers(0, 80),
    st.integers(1, 60),
    st.integers(1, 60),
)
def test_any_mask_lies_in_its_window(height, width, row, column, tall, wide):
    mask = block(
        np.s_[min(row, height - 1) : row + tall, min(column, width - 1) : column + wide],
        (height, width),
    )
    if mask.all():
        return
    view = View(mask, Camera.canonical(width, height))
    left, top, right, bottom = window_of(view)
    box = view.box()
    assert left <= box[0] + 1e-9
    assert top <= box[1] + 1e-9
    assert right >= box[2] - 1e-9
    assert bottom >= box[3] - 1e-9
    assert right - left == pytest.approx(bottom - top)
    seen = resample_view(view, 0.4, np.zeros(3), 1.0)
    assert seen.target.inside.any()
    assert 0.0 <= seen.mask.min() <= seen.mask.max() <= 1.0 + 1e-9
