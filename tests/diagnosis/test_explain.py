"""Which hypothesis explains cloud, cameras and masks: of the whole input, of views, of pairs."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import example, in_photo, seen, turned
from tso_cli import Camera, View
from tso_cli.diagnosis.assumptions import assumptions_of
from tso_cli.diagnosis.cells import Outline
from tso_cli.diagnosis.explain import MOST_CANDIDATES, Table, agreement
from tso_cli.diagnosis.hypotheses import FOCAL_UNITS, HYPOTHESES
from tso_cli.geometry.points import scattered
from tso_cli.losses.silhouette import silhouette_of

from .common import (
    EXAMPLES,
    PLANE,
    around,
    assumed,
    changed,
    examined,
    named,
    paired,
)
from .mistakes import INVISIBLE, mistaken

# Of the whole input


@pytest.mark.parametrize("name", sorted(set(HYPOTHESES) - INVISIBLE))
def test_a_mistake_is_found_before_the_start(name):
    points, view = mistaken(name)
    found = examined(points, [view]).of_input
    assert name in [finding.name for finding in found]
    assert len(found) <= MOST_CANDIDATES
    for finding in found:
        assert finding.views == (0,)
        assert finding.suspicious
        assert 0.4 <= finding.score <= 1.0
        assert 0.04 <= finding.gain <= finding.score


@pytest.mark.parametrize("millimetres", [36, 32])
def test_a_focal_length_in_millimetres_is_found_in_a_large_picture(millimetres):
    scene = example("airplane")
    width, height = 4 * scene.camera.width, 4 * scene.camera.height
    camera = scene.camera.resized(width, height)
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= millimetres / width
    mask = np.kron(scene.mask, np.ones((4, 4), np.float32))
    view = replace(scene.view, mask=mask, known=None, camera=replace(camera, K=K))
    found = examined(scene.target, [view]).of_input
    assert f"focal-mm-{millimetres}" in [finding.name for finding in found]


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_focal_length_in_millimetres_does_not_pass_for_a_camera_inside_the_cloud(name):
    """As who reads 67.5 mm. In millimetres the camera would see points all over its picture."""
    scene = example(name)
    K = scene.camera.K.copy()
    K[[0, 1], [0, 1]] *= 36.0 / scene.camera.width
    view = replace(scene.view, camera=replace(scene.camera, K=K))
    names = [finding.name for finding in examined(scene.points, [view]).of_input]
    assert "focal-mm-36" in names
    assert not [name for name in names if name.startswith("camera-")]


@pytest.mark.parametrize("name", EXAMPLES)
def test_another_unit_of_the_focal_length_is_not_tried_where_pixels_are_plausible(name):
    scene = example(name)
    K = np.diag([0.3, 0.3, 1.0]) @ scene.camera.K
    wide = replace(scene.view, camera=replace(scene.camera, K=K))
    for view in (scene.view, wide):
        names = [finding.name for finding in examined(scene.target, [view]).of_input]
        assert not {hypothesis.name for hypothesis in FOCAL_UNITS} & set(names)


@pytest.mark.parametrize("name", EXAMPLES)
def test_right_input_is_not_suspicious(name):
    scene = example(name)
    for points in (scene.points, scene.target):
        assert examined(points, [scene.view]).of_input == ()


@pytest.mark.parametrize("name", EXAMPLES)
@pytest.mark.parametrize("times", [24, 48, 64, 80, 96, 128, 160])
def test_right_input_of_a_few_pixels_is_not_suspicious(name, times):
    scene = example(name)
    corner = 20 * times + times // 3
    large = in_photo(scene.view, 64 * times // len(scene.mask), corner, corner)
    pixels = large.mask.reshape(64, times, 64, times).mean((1, 3)) > 0.5
    K = large.camera.K / [[times], [times], [1.0]]
    K[:2, 2] -= 0.5 - 0.5 / times
    if pixels.any():
        view = View(np.float32(pixels), replace(large.camera, K=K, width=64, height=64))
        assert examined(scene.points, [view]).of_input == ()


def test_the_order_of_the_points_does_not_matter():
    """In an organised cloud, every 1,024th point is of one column."""
    side = np.linspace(-0.5, 0.5, 1024)
    grid = np.stack([np.repeat(side, 1024), np.tile(side, 1024), np.zeros(1024 * 1024)], 1)
    shuffled = np.random.default_rng(0).permutation(grid)
    ious = [agreement(scattered(points, 1024), [PLANE.view]) for points in (grid, shuffled)]
    assert ious[0] == pytest.approx(ious[1], abs=0.05)


def test_points_on_unknown_pixels_are_no_disagreement():
    known = np.ones(PLANE.mask.shape, bool)
    known[:, : known.shape[1] // 2] = False
    half = agreement(PLANE.target, [replace(PLANE.view, known=known)])
    assert half > 0.9 * agreement(PLANE.target, [PLANE.view])


def test_an_object_that_the_border_truncates_does_not_pass_for_an_inverted_mask():
    K = PLANE.camera.K * [[3.0, 1.0, 1.0], [1.0, 3.0, 1.0], [1.0, 1.0, 1.0]]
    camera = replace(PLANE.camera, K=K)
    near = View(silhouette_of(PLANE.target, camera), camera)
    found = examined(PLANE.points, [near]).of_input
    assert "mask-inverted" not in [finding.name for finding in found]


def test_the_unknown_part_of_a_border_does_not_hide_that_a_mask_is_inverted():
    known = np.ones(PLANE.mask.shape, bool)
    known[:, : known.shape[1] // 2 - 20] = False
    mask = np.where(known, 1.0 - PLANE.mask, 0.0).astype(np.float32)
    found = examined(PLANE.target, [replace(PLANE.view, mask=mask, known=known)]).of_input
    assert found[0].name == "mask-inverted"


# Under assumptions


@pytest.mark.parametrize("name", ["mask-inverted", "cloud-z-up", "opengl"])
def test_a_wrong_assumption_is_the_only_finding(name):
    found = examined(PLANE.target, [PLANE.view], assumed(name)).of_input
    assert [finding.without for finding in found] == list(assumed(name))
    assert [finding.name for finding in found] == [name]


@pytest.mark.parametrize("name", ["mask-inverted", "mask-flipped", "cloud-z-up", "opengl"])
def test_under_a_right_assumption_nothing_is_found(name):
    points, view = mistaken(name)
    found = examined(points, [view], assumed(name))
    assert found.of_input == ()
    assert found.of_views == ()


def test_a_wrong_assumption_about_one_view_is_found_as_it_was_given():
    views = around()
    given = assumptions_of([f"mask-inverted@{views[1].name}"], [view.name for view in views])
    (finding,) = examined(PLANE.target, views, given).of_input
    assert finding.without == given[0]
    assert finding.gain > 0.16


# Of single views


@pytest.mark.parametrize("name", ["mask-inverted", "mask-upside-down", "opengl", "camera-to-world"])
def test_a_mistake_in_one_view_of_several_is_found_there(name):
    views = around(3)
    assert examined(PLANE.points, views).of_views == ()
    found = examined(PLANE.points, [*views[:2], changed(views[2], name)])
    assert found.of_input == ()
    assert named(found.of_views) == [(name, (2,))]
    (finding,) = found.of_views
    alone = agreement(PLANE.points, views[2:])
    assert finding.score == pytest.approx(alone, abs=0.02)


@pytest.mark.parametrize("wrong", [0, 1])
@pytest.mark.parametrize("name", ["camera-to-world", "mask-upside-down", "mask-inverted"])
def test_of_two_views_the_one_that_the_cloud_does_not_fit_is_the_wrong_one(name, wrong):
    views = around(2)
    views[wrong] = changed(views[wrong], name)
    assert named(examined(PLANE.points, views).of_views) == [(name, (wrong,))]


# Of two mistakes at once, of widths


@pytest.mark.parametrize(("camera", "cloud"), [("opengl", "cloud-z-up"), ("pix3d", "cloud-y-up")])
def test_two_mistakes_at_once_are_found_as_a_pair(camera, cloud):
    opposite = {"cloud-z-up": "cloud-y-up", "cloud-y-up": "cloud-z-up"}[cloud]
    points = PLANE.points @ HYPOTHESES[opposite].matrix.T
    found = examined(points, [changed(PLANE.view, camera)]).of_input
    assert f"{camera}+{cloud}" in [finding.name for finding in found]


def test_a_focal_length_in_millimetres_is_found_with_wrong_axes():
    """As who copies Pix3D's focal length and pose."""
    scene = example("airplane")
    width, height = 4 * scene.camera.width, 4 * scene.camera.height
    camera = HYPOTHESES["pix3d"].camera(scene.camera.resized(width, height))
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= 32.0 / width
    view = View(np.kron(scene.mask, np.ones((4, 4), np.float32)), camera)
    found = examined(scene.target, [replace(view, camera=replace(camera, K=K))]).of_input
    assert "focal-mm-32+pix3d" in [finding.name for finding in found]


@pytest.mark.parametrize("width", [97, 518])
def test_the_principal_point_tells_the_width_that_K_is_of(width):
    K = PLANE.camera.resized(width, width * PLANE.camera.height // PLANE.camera.width).K
    found = examined(PLANE.points, [replace(PLANE.view, camera=replace(PLANE.camera, K=K))])
    assert f"K-of-width={width}" in [finding.name for finding in found.of_input]


@pytest.mark.parametrize("shift", [(0.05, -0.04), (0.03, 0.03)])
def test_K_of_a_cropped_picture_is_not_of_another_width(shift):
    K = PLANE.camera.K.copy()
    K[:2, 2] += np.array([PLANE.camera.width, PLANE.camera.height]) * shift
    found = examined(PLANE.points, [replace(PLANE.view, camera=replace(PLANE.camera, K=K))])
    assert not [one for one in found.of_input if one.name.startswith("K-of-width")]


@pytest.mark.parametrize("size", [(1, 64), (64, 1)])
def test_a_picture_of_one_column_or_row_has_no_half(size):
    mask = np.zeros(64, np.float32)
    mask[8:56] = 1.0
    view = View(mask.reshape(size), Camera.canonical(*size[::-1]))
    examined(PLANE.points, [view])


def test_a_width_that_no_assumption_can_name_is_not_tried():
    """As who reads a principal point in ten thousandths of a pixel."""
    camera = replace(PLANE.camera, K=np.diag([1e4, 1e4, 1.0]) @ PLANE.camera.K)
    outlines = [Outline(replace(PLANE.view, camera=camera))]
    candidates = Table(PLANE.points, outlines, ()).candidates
    assert not any("K-of-width" in candidate.name for candidate in candidates)


def test_a_wrong_width_of_K_is_left_out_and_not_mended_by_another_width():
    given = assumptions_of(["K-of-width=518"], [PLANE.view.name])
    (finding,) = examined(PLANE.points, [PLANE.view], given).of_input
    assert finding.without == given[0]


@pytest.mark.parametrize("times", [0.6, 0.7, 1.4, 1.8])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_stretched_can_is_no_can_with_exchanged_axes(axis, times):
    rng = np.random.default_rng(0)
    angle, height = rng.uniform(0.0, 2.0 * np.pi, 4096), rng.uniform(-0.3, 0.3, 4096)
    can = np.stack([0.3 * np.cos(angle), height, 0.3 * np.sin(angle)], 1)
    scale = np.ones(3)
    scale[axis] = times
    for degrees in (0.0, 40.0):
        view = seen(can, turned(PLANE.camera, degrees))
        assert examined(can * scale, [view]).of_input == ()


def test_two_wrong_views_of_four_are_both_found():
    views = around()
    for number in (1, 2):
        views[number] = changed(views[number], "mask-inverted")
    found = examined(PLANE.target, views).of_views
    assert named(found) == [("mask-inverted", (1,)), ("mask-inverted", (2,))]


def test_a_mistake_in_the_cloud_is_never_found_in_a_single_view():
    views = around(3)
    # As if the cloud were turned for one camera alone.
    of_cloud = HYPOTHESES["cloud-upside-down"].matrix
    camera = replace(views[2].camera, R=views[2].camera.R @ of_cloud)
    found = examined(PLANE.points, [*views[:2], replace(views[2], camera=camera)])
    assert not any(HYPOTHESES[finding.name].of_cloud for finding in found.of_views)


# Of pairs


@pytest.mark.parametrize("order", [[1, 0], [1, 0, 2], [1, 2, 3, 0]])
def test_masks_that_are_not_in_the_order_of_their_cameras_are_found_in_pairs(order):
    found = examined(PLANE.points, paired(around(len(order)), order))
    assert found.of_views == ()
    (finding,) = found.of_input
    moved = [camera for camera, mask in enumerate(order) if mask != camera]
    # Camera i belongs to the mask that came with camera k, where order[k] is i.
    expected = [(order.index(camera), camera) for camera in moved]
    assert finding.name == "mispaired"
    assert sorted(finding.pairs) == sorted(expected)
    assert finding.views == tuple(moved)


@pytest.mark.parametrize(("name", "degrees"), [("chair", 60.0), ("car", 30.0)])
def test_several_masks_that_are_exchanged_need_to_gain_less_than_one(name, degrees):
    scene = example(name)
    views = [seen(scene.target, turned(scene.camera, degrees * i)) for i in range(4)]
    (finding,) = examined(scene.points, paired(views, [1, 2, 3, 0])).of_input
    assert finding.pairs == ((3, 0), (0, 1), (1, 2), (2, 3))


def test_a_pair_among_many_is_a_finding_of_views():
    views = around(8)
    found = examined(PLANE.points, paired(views, [0, 1, 2, 3, 4, 5, 7, 6]))
    assert found.of_input == ()
    (finding,) = found.of_views
    assert sorted(finding.pairs) == [(6, 7), (7, 6)]
    assert finding.views == (6, 7)


def test_a_pair_is_found_though_another_view_fits_one_of_its_masks_too():
    """From 0 and 5 degrees the chair fits both masks; one of them has the mask of 90 degrees."""
    chair = example("chair")
    views = [seen(chair.target, turned(chair.camera, angle)) for angle in (0.0, 5.0, 90.0)]
    (finding,) = examined(chair.points, paired(views, [0, 2, 1])).of_input
    assert sorted(finding.pairs) == [(1, 2), (2, 1)]


def test_a_view_that_gains_nothing_from_another_mask_is_in_no_pair():
    """Camera 0 has the mask of 25 degrees, which its own mask of 20 degrees hardly differs from."""
    angles = 20.0, 25.0, 100.0, 150.0
    views = [seen(PLANE.target, turned(PLANE.camera, angle)) for angle in angles]
    found = examined(PLANE.points, paired(views, [1, 3, 2, 0]))
    (finding,) = (*found.of_input, *found.of_views)
    assert finding.views == (1, 3)
    assert finding.pairs == ((0, 1), (1, 3))


def test_flipped_masks_of_a_symmetric_object_do_not_pass_for_exchanged_ones():
    """From 45 degrees left and right of its mirror plane each looks like the other, flipped."""
    car = example("car")
    views = [seen(car.target, turned(car.camera, angle)) for angle in (0.0, 90.0)]
    found = examined(car.target, [changed(view, "mask-flipped") for view in views]).of_input
    assert "mask-flipped" in [finding.name for finding in found]
    assert "mispaired" not in [finding.name for finding in found]


def test_views_that_agree_are_exchanged_with_none():
    """All masks of an object of revolution are alike; another's mask may fit a little better."""
    ball = np.random.default_rng(0).normal(size=(16_384, 3))
    ball *= [0.1, 0.2, 0.1] / np.linalg.norm(ball, axis=1, keepdims=True)
    views = [seen(ball, turned(PLANE.camera, 40.0 * i)) for i in range(4)]
    found = examined(1.2 * ball, paired(views, [3, 0, 1, 2]))
    assert found.of_input == ()
    assert found.of_views == ()


def test_pixels_that_are_unknown_in_a_mask_are_unknown_with_the_camera_of_another():
    views = paired(around(2), [1, 0])
    known = np.ones(views[0].mask.shape, bool)
    known[:, : known.shape[1] // 2] = False
    found = examined(PLANE.target, [replace(views[0], known=known), views[1]]).of_input
    assert found[0].name == "mispaired"
    assert found[0].score > 0.8


def test_masks_of_another_size_are_exchanged_with_none():
    views = paired(around(2), [1, 0])
    mixed = [in_photo(views[0], 2, 0, 0), views[1]]
    found = examined(PLANE.points, mixed)
    assert "mispaired" not in [one.name for one in (*found.of_input, *found.of_views)]
