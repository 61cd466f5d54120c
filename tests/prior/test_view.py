"""What a view shows, in its own axes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation

from tests.scenes import seen
from tso_cli import Camera, View
from tso_cli.losses.mask_chamfer import MaskTarget
from tso_cli.prior import Frame, LearnedPrior, SeenCloud, Shown
from tso_cli.prior.features import CELL, GRID, HALF
from tso_cli.prior.learned import _samples
from tso_cli.prior.view import cells_of_maps, signed_distance, turn_to_front
from tso_cli.render.viewpoints import look_at

from .common import some_weights

CENTRES = (np.arange(GRID) + 0.5) * CELL - HALF


def ball_in(camera, centre=(0.0, 0.0, 0.0), radius=0.4):
    """The view of a ball: the pixels whose rays hit it."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    plane = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(camera.K).T
    middle = camera.R @ centre + camera.t
    if camera.model == "perspective":
        plane /= np.linalg.norm(plane, axis=-1, keepdims=True)
        off = middle - (plane @ middle)[..., None] * plane
    else:
        off = plane[..., :2] - middle[:2]
    return View(np.float32(np.linalg.norm(off, axis=-1) < radius), camera)


def assert_disc(shown, radius, tolerance):
    """In the picture; beyond its border distances are as large as they can be."""
    away = np.hypot(*np.meshgrid(CENTRES, CENTRES))
    inner = away < 0.5
    np.testing.assert_allclose(shown.distance[inner], away[inner] - radius, atol=tolerance)


def shown(view, frame, start=None, known=None, truncated=False):
    target = MaskTarget.of(view.mask, known, truncated=truncated)
    return Shown.of(view.camera, target, start, frame)


def test_the_distance_to_a_mask_is_the_euclidean_one():
    rng = np.random.default_rng(3)
    inside = rng.random((20, 30)) > 0.7
    expected = np.where(
        inside, 0.5 - distance_transform_edt(inside), distance_transform_edt(~inside) - 0.5
    )
    np.testing.assert_allclose(signed_distance(inside), expected)


@given(
    st.tuples(*[st.floats(-3.0, 3.0)] * 3).filter(lambda v: v[2] > 0.1 - 0.999 * np.linalg.norm(v))
)
def test_the_least_rotation_turns_a_direction_to_the_front(direction):
    turn = turn_to_front(np.array(direction))
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    front = turn @ direction / np.linalg.norm(direction)
    np.testing.assert_allclose(front, [0.0, 0.0, 1.0], atol=1e-9)


def test_a_ball_is_seen_as_a_disc_in_units_of_the_cloud():
    """From 2 away a ball of radius .4 covers .4 / sqrt(1 - .04) of the plane through its middle."""
    camera = look_at(30.0, 20.0, 2.0, (256, 256))
    view = ball_in(camera)
    found = shown(view, Frame(np.zeros(3), 1.0))
    assert found.closeness == pytest.approx(0.5)
    assert_disc(found, 0.4 / np.sqrt(0.96), 0.012)
    np.testing.assert_allclose(np.linalg.norm(found.cells, axis=1).max(), 0.4, atol=0.05)


def test_a_cloud_off_the_axis_and_of_another_size_is_seen_in_the_middle():
    offset = np.array([0.3, -0.2, 0.1])
    camera = look_at(30.0, 20.0, 6.0, (256, 256))
    view = ball_in(camera, offset, 0.8)
    found = shown(view, Frame(offset, 2.0))
    assert_disc(found, 0.4 / np.sqrt(1.0 - (0.4 * found.closeness) ** 2), 0.012)


def test_an_orthographic_camera_has_no_closeness():
    K = np.array([[50.0, 0.0, 31.5], [0.0, 50.0, 31.5], [0.0, 0.0, 1.0]])
    camera = Camera(K, np.eye(3), [0.0, 0.0, 5.0], 64, 64, "orthographic")
    found = shown(ball_in(camera), Frame(np.zeros(3), 1.0))
    assert found.closeness == 0.0
    assert_disc(found, 0.4, 0.025)


def test_beyond_the_border_of_a_truncated_picture_nothing_is_known():
    K = np.array([[50.0, 0.0, 31.5], [0.0, 50.0, 31.5], [0.0, 0.0, 1.0]])
    camera = Camera(K, np.eye(3), [0.5, 0.0, 5.0], 64, 64, "orthographic")
    view = ball_in(camera)
    assert view.truncated
    found = shown(view, Frame(np.zeros(3), 1.0), truncated=True)
    # The right border of the picture is at 32 / 50 - 0.5 in units of the cloud.
    np.testing.assert_array_equal(found.known[GRID // 2], CENTRES < 0.14)
    assert found.cells[:, 0].max() < 0.14


def test_the_frame_of_a_cloud_leaves_out_single_points_and_follows_a_turn():
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (1000, 3)) * [1.0, 0.3, 0.2]
    frame = Frame.of(points)
    assert frame.scale == pytest.approx(1.0, abs=0.03)
    with_one = Frame.of(np.concatenate([points, [[4.0, 0.0, 0.0]]]))
    assert with_one.scale == pytest.approx(frame.scale, abs=0.01)
    turn = Rotation.from_euler("xyz", [40.0, 30.0, 50.0], degrees=True).as_matrix()
    turned = Frame.of(points @ turn.T + [1.0, 2.0, 3.0])
    assert turned.scale == pytest.approx(frame.scale, abs=0.05)
    np.testing.assert_allclose(turned.centre, turn @ frame.centre + [1.0, 2.0, 3.0], atol=0.05)


def test_a_cloud_and_a_camera_that_are_turned_together_move_alike():
    prior = LearnedPrior(some_weights())
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.5, 0.5, (512, 3)) * [1.0, 0.5, 0.4]
    view = seen(1.1 * points, look_at(30.0, 20.0, 2.5, (64, 64)))
    turn = Rotation.from_euler("xyz", [20.0, 130.0, 50.0], degrees=True).as_matrix()
    camera = Camera(view.camera.K, view.camera.R @ turn.T, view.camera.t, 64, 64)
    steps = []
    for cloud, seen_by in ((points, view.camera), (points @ turn.T, camera)):
        frame = Frame(np.zeros(3), 1.0)
        of_view = Shown.of(seen_by, MaskTarget.of(view.mask), cloud, frame)
        scene = SeenCloud(cloud, frame, [of_view])
        steps.append(scene.ask(prior, cloud).displacements)
    np.testing.assert_allclose(steps[1], steps[0] @ turn.T, atol=1e-9)
    assert np.abs(steps[0]).max() > 0.01


def test_points_of_a_sample_are_as_dense_as_the_cloud():
    """A tenth of the points is spread over ten times the length of the others."""
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform(0.0, 0.1, (4500, 3)), rng.uniform(0.0, 1.0, (500, 3))])
    for sample in _samples(points):
        assert len(set(sample.chosen)) == 512
        assert (sample.chosen >= 4500).mean() == pytest.approx(0.1, abs=0.03)
        assert (sample.chosen[:128] >= 4500).mean() == pytest.approx(0.1, abs=0.05)


def test_two_samples_of_1024_points_have_all_of_them_and_each_answers_by_itself():
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (1024, 3))
    view = seen(1.1 * points, look_at(30.0, 20.0, 2.5, (64, 64)))
    frame, prior = Frame(np.zeros(3), 1.0), LearnedPrior(some_weights())
    of_view = Shown.of(view.camera, MaskTarget.of(view.mask), points, frame)
    scene = SeenCloud(points, frame, [of_view])
    first, second = _samples(points @ of_view.rotation.T)
    assert len({*first.chosen, *second.chosen}) == 1024
    steps = []
    for sample in (first, second):
        alone = SeenCloud(points, frame, [of_view])
        alone.__dict__["_samples"] = [[sample]]
        steps.append(alone.ask(prior, points).displacements)
    assert np.abs(steps[1] - steps[0]).max() > 0.01
    np.testing.assert_allclose(
        scene.ask(prior, points).displacements, np.mean(steps, axis=0), atol=1e-9
    )


def test_an_object_off_the_axis_of_the_picture_is_measured_in_units_of_the_cloud():
    """At 35 degrees the picture of a ball is an ellipse; in the view's own axes it is a disc."""
    K = np.array([[60.0, 0.0, 127.5], [0.0, 60.0, 127.5], [0.0, 0.0, 1.0]])
    camera = Camera(K, np.eye(3), [0.7 * 1.5, 0.0, 1.5], 256, 256)
    found = shown(ball_in(camera), Frame(np.zeros(3), 1.0))
    away = np.hypot(*np.meshgrid(CENTRES, CENTRES))
    expected = away - 0.4 / np.sqrt(1.0 - (0.4 * found.closeness) ** 2)
    near = np.abs(expected) < 0.15
    slope = np.polyfit(expected[near], found.distance[near], 1)[0]
    assert slope == pytest.approx(1.0, abs=0.06)


def test_what_lies_behind_a_wide_camera_is_unknown():
    K = np.array([[30.0, 0.0, 63.5], [0.0, 30.0, 63.5], [0.0, 0.0, 1.0]])
    direction = np.array([np.sin(np.radians(60.0)), 0.0, np.cos(np.radians(60.0))])
    camera = Camera(K, np.eye(3), 1.2 * direction, 128, 128)
    found = shown(ball_in(camera), Frame(np.zeros(3), 1.0))
    assert np.isfinite(found.distance).all()
    assert 0.0 < found.known.mean() < 1.0
    at_camera = Camera(K, np.eye(3), [0.0, 0.0, 0.0], 128, 128)
    view = View(ball_in(camera).mask, at_camera)
    assert shown(view, Frame(np.zeros(3), 1.0)) is None


def test_ignored_pixels_are_as_in_the_silhouette_of_the_start():
    """The right half is ignored: there the start, a ball of its own, is shown."""
    camera = look_at(0.0, 0.0, 2.0, (64, 64))
    rng = np.random.default_rng(0)
    start = rng.normal(size=(2000, 3))
    start *= 0.3 / np.linalg.norm(start, axis=1, keepdims=True)
    known = np.ones((64, 64))
    known[:, 32:] = 0.0
    found = shown(ball_in(camera), Frame(np.zeros(3), 1.0), start, known)
    x, y = np.meshgrid(CENTRES, CENTRES)
    away, right = np.hypot(x, y), x > 0.1
    inside = found.distance < 0.0
    assert (inside == (away < np.where(right, 0.3, 0.41)))[np.abs(x) > 0.1].mean() > 0.97
    assert found.known.all()


def test_the_cut_of_a_truncated_picture_is_no_outline():
    """The window reaches beyond the picture, whose border cuts the ball in the middle."""
    K = np.array([[50.0, 0.0, 31.5], [0.0, 50.0, 31.5], [0.0, 0.0, 1.0]])
    camera = Camera(K, np.eye(3), [0.0, 0.0, 5.0], 64, 64, "orthographic")
    mask = ball_in(camera).mask.copy()
    mask[:, 32:] = 0.0
    target = MaskTarget.of(mask, bounds=(-0.5, -0.5, 31.5, 63.5), truncated=True)
    found = Shown.of(camera, target, None, Frame(np.zeros(3), 1.0))
    x, y = np.meshgrid(CENTRES, CENTRES)
    shown_part = (np.abs(x + 0.32) < 0.32) & (np.abs(y) < 0.64)
    np.testing.assert_array_equal(found.known, shown_part)
    # At the cut the middle of the ball is as far from the outline as before.
    middle = (np.abs(y) < 0.03) & (np.abs(x + 0.05) < 0.03)
    assert found.distance[middle].max() < -0.3


def test_a_whole_object_in_a_tight_picture_is_known_all_around():
    K = np.array([[50.0, 0.0, 31.5], [0.0, 50.0, 31.5], [0.0, 0.0, 1.0]])
    camera = Camera(K, np.eye(3), [0.0, 0.0, 5.0], 64, 64, "orthographic")
    known = np.zeros((64, 64))
    known[10:54, 10:54] = 1.0
    mask = MaskTarget.of(ball_in(camera).mask, known, (9.5, 9.5, 53.5, 53.5))
    found = Shown.of(camera, mask, None, Frame(np.zeros(3), 1.0))
    assert found.known.all()
    assert_disc(found, 0.4, 0.025)


@pytest.mark.parametrize("model", ["perspective", "orthographic"])
def test_the_cell_of_a_pixel_is_the_cell_whose_centre_is_seen_there(model):
    camera = look_at(30.0, 20.0, 5.0, (400, 400))
    if model == "orthographic":
        K = camera.K.copy()
        K[[0, 1], [0, 1]] = 180.0
        camera = Camera(K, camera.R, camera.t, 400, 400, model)
    frame = Frame(np.array([0.2, -0.1, 0.15]), 1.3)
    found = shown(ball_in(camera, frame.centre, 0.5), frame)
    w = np.stack(np.meshgrid(CENTRES, CENTRES), -1)
    places, _ = camera.project(frame.centre + frame.scale * w.reshape(-1, 2) @ found.rotation[:2])
    column, row = np.rint(places).astype(int).T
    inside = (np.minimum(row, column) >= 0) & (np.maximum(row, column) < 400)
    rows, columns = cells_of_maps(camera, frame)
    assert inside.sum() > 1000
    at_pixels = rows[row[inside], column[inside]] * GRID + columns[row[inside], column[inside]]
    np.testing.assert_array_equal(at_pixels, np.flatnonzero(inside))
