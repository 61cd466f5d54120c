"""The camera: what it accepts, and the changes of frame that keep its picture."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.corruption import assert_refused
from tso_cli.geometry.camera import NEAR, Camera, intrinsics

CANONICAL = Camera.canonical(64, 48)


def _points(seed=0):
    return np.random.default_rng(seed).uniform(-0.4, 0.4, (30, 3))


def test_the_canonical_camera_is_centred_and_two_units_away_at_any_size():
    assert CANONICAL.K.tolist() == [[120.0, 0.0, 31.5], [0.0, 120.0, 23.5], [0.0, 0.0, 1.0]]
    assert CANONICAL.t.tolist() == [0.0, 0.0, 2.0]
    np.testing.assert_allclose(CANONICAL.resized(128, 96).K, Camera.canonical(128, 96).K)
    # Right in the world is a larger column, up a smaller row.
    pixels, depth = CANONICAL.project(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]))
    np.testing.assert_allclose(pixels, [[31.5, 23.5], [37.5, 23.5], [31.5, 17.5]])
    np.testing.assert_allclose(depth, 2.0)


@settings(max_examples=40, deadline=None)
@given(
    st.floats(-20, 20),
    st.floats(-20, 20),
    st.floats(5, 90),
    st.floats(5, 90),
    st.integers(8, 200),
    st.integers(8, 200),
)
def test_a_point_seen_in_a_crop_is_the_point_seen_in_the_picture(
    left, top, across, down, width, height
):
    box = (left, top, left + across, top + down)
    pixels, _ = CANONICAL.project(_points())
    cropped, _ = CANONICAL.cropped(box, width, height).project(_points())
    expected = (pixels - [left, top]) * [width / across, height / down] - 0.5
    np.testing.assert_allclose(cropped, expected, atol=1e-6)


@pytest.mark.parametrize("model", ["perspective", "orthographic"])
@settings(max_examples=25, deadline=None)
@given(st.floats(1e-3, 1e4), st.tuples(*[st.floats(-1e6, 1e6)] * 3))
def test_a_normalised_cloud_is_seen_where_the_cloud_is(model, scale, centre):
    shift = np.array(centre)
    camera = Camera(
        CANONICAL.K, CANONICAL.R, scale * CANONICAL.t - CANONICAL.R @ shift, 64, 48, model
    )
    cloud = _points() * scale + shift
    seen, _ = camera.project(cloud)
    normalised, _ = camera.for_normalised(shift, scale).project((cloud - shift) / scale)
    np.testing.assert_allclose(normalised, seen, rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_a_perspective_camera_sees_what_is_far_enough_in_front_of_it(scale):
    camera = Camera(CANONICAL.K, np.eye(3), np.zeros(3), 64, 48)
    # The longest side of this cloud is twice its scale. The last point is far outside the image.
    depths = np.array([-1.0, 0.0, 0.9 * 2.0 * NEAR, 1.1 * 2.0 * NEAR, 1.0, 1.0])
    points = scale * np.stack([[0.0] * 5 + [1.9], np.zeros(6), depths], axis=1)
    pixels, depth, visible = camera.project_visible(points)
    assert visible.tolist() == [False, False, False, True, True, True]
    assert np.array_equal(pixels, camera.project(points)[0], equal_nan=True)
    assert np.array_equal(depth, camera.project(points)[1])


def test_an_orthographic_camera_sees_every_point():
    camera = Camera(CANONICAL.K, np.eye(3), np.zeros(3), 64, 48, "orthographic")
    assert camera.project_visible(_points())[2].all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(K=np.eye(2)), "K has shape"),
        (dict(K=np.diag([1.0, 0.0, 1.0])), "singular"),
        (dict(K=np.diag([1.0, 1.0, 2.0])), "expected \\[\\[fx"),
        (dict(R=np.diag([1.0, 1.0, -1.0])), "not a rotation"),
        (dict(t=[0.0, np.nan, 1.0]), "not finite"),
        (dict(width=0), "width is 0"),
        (dict(width="64"), "width is '64'"),
        (dict(height=2.5), "height is 2.5"),
        (dict(model="fisheye"), "perspective, orthographic"),
    ],
)
def test_what_is_no_camera_is_refused(change, words):
    good = dict(K=CANONICAL.K, R=CANONICAL.R, t=CANONICAL.t, width=64, height=48)
    assert_refused(words, Camera, **(good | change))


def test_a_focal_length_without_digits_is_refused():
    assert_refused("fx = 1e-300", Camera, intrinsics(1e-300, 64, 64), np.eye(3), np.ones(3), 64, 64)
