"""The table of hypotheses, and views under assumptions."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.corruption import assert_refused
from tso_cli import View
from tso_cli.diagnosis.assumptions import (
    INVERTED,
    Assumption,
    as_meant,
    assumptions_of,
    axes_of,
    left_handed,
)
from tso_cli.diagnosis.hypotheses import HYPOTHESES, hypothesis_called, of_width
from tso_cli.geometry.camera import Camera

from .common import PLANE, around, assumed, changed
from .mistakes import mistaken


@pytest.mark.parametrize("name", HYPOTHESES)
def test_under_its_assumption_a_mistake_projects_as_the_right_input_does(name):
    points, view = mistaken(name)
    if name == "principal-point-swapped":
        K = PLANE.camera.K + [[0.0, 0.0, 9.0], [0.0, 0.0, -4.0], [0.0, 0.0, 0.0]]
        view = replace(PLANE.view, camera=replace(PLANE.camera, K=K))
        swapped = changed(view, name).camera.K
        assert swapped[0, 2] == K[1, 2]
        assert swapped[1, 2] == K[0, 2]
        return
    meant = as_meant(view, assumed(name))
    pixels, mask = meant.camera.project(points)[0], meant.mask
    if left_handed(assumed(name)):
        pixels = [PLANE.camera.width - 1.0, 0.0] + pixels * [-1.0, 1.0]
        mask = mask[:, ::-1]
    np.testing.assert_allclose(pixels, PLANE.camera.project(PLANE.target)[0], atol=1e-6)
    np.testing.assert_array_equal(mask, PLANE.mask)


@pytest.mark.parametrize("name", [name for name, one in HYPOTHESES.items() if one.axes != "x y z"])
def test_depth_map_and_photo_are_mirrored_with_the_camera_of_a_left_handed_cloud(name):
    columns = np.arange(1.0, 1.0 + PLANE.mask.shape[1])
    depth = np.where(PLANE.mask > 0.5, columns, np.nan)
    photo = np.nan_to_num(depth, nan=0.0)[..., None].repeat(3, 2).astype(np.float32) / 256.0
    known = np.ones(PLANE.mask.shape, bool)
    known[:, :9] = False
    view = changed(replace(PLANE.view, depth=depth, image=photo, known=known), name)
    order = np.s_[:, ::-1] if left_handed(assumed(name)) else np.s_[:]
    np.testing.assert_array_equal(view.mask[order], PLANE.mask)
    np.testing.assert_array_equal(view.known[order], known)
    np.testing.assert_array_equal(view.depth[order], depth)
    np.testing.assert_array_equal(view.image[order], photo)


@pytest.mark.parametrize(
    ("name", "order"),
    [
        ("mask-flipped", np.s_[:, ::-1]),
        ("mask-upside-down", np.s_[::-1]),
        ("mask-turned", np.s_[::-1, ::-1]),
    ],
)
def test_a_mask_is_flipped_with_its_unknown_pixels_and_without_its_depth_map(name, order):
    known = np.ones(PLANE.mask.shape, bool)
    known[:9, :7] = False
    depth = np.where(PLANE.mask > 0.5, 2.0, 3.0)
    view = changed(replace(PLANE.view, known=known, depth=depth), name)
    np.testing.assert_array_equal(view.mask, PLANE.mask[order])
    np.testing.assert_array_equal(view.known, known[order])
    np.testing.assert_array_equal(view.depth, depth)
    np.testing.assert_array_equal(view.camera.R, PLANE.camera.R)


def test_an_assumption_of_one_view_leaves_the_others_as_they_were_read():
    views = around(2)
    (given,) = assumptions_of(["mask-inverted@1.png"], [view.name for view in views])
    assert as_meant(views[0], [given]) is views[0]
    np.testing.assert_array_equal(as_meant(views[1], [given]).mask, 1.0 - views[1].mask)


def test_the_same_change_twice_is_none():
    twice = as_meant(PLANE.view, [*assumed("mask-flipped"), *assumed("mask-flipped")])
    np.testing.assert_array_equal(twice.mask, PLANE.mask)
    np.testing.assert_array_equal(axes_of(2 * assumed("cloud-xy-swapped")), np.eye(3))
    assert not left_handed(2 * assumed("cloud-xy-swapped"))


@pytest.mark.parametrize("name", HYPOTHESES)
def test_axes_are_a_turn_or_a_mirrored_turn(name):
    matrix = HYPOTHESES[name].matrix
    np.testing.assert_array_equal(matrix @ matrix.T, np.eye(3))
    assert left_handed(assumed(name)) == (np.linalg.det(matrix) < 0.0)
    assert left_handed(assumed(name)) == name.endswith(("xy-swapped", "yz-swapped", "xz-swapped"))


def test_units_of_an_orthographic_camera_are_in_its_k():
    K = np.diag([100.0, 100.0, 1.0])
    camera = Camera(K, np.eye(3), np.array([0.0, 0.0, 2.0]), 64, 64, "orthographic")
    points = np.array([[0.1, 0.2, 0.0]])
    millimetres = HYPOTHESES["cloud-millimetres"].camera(camera)
    np.testing.assert_allclose(millimetres.project(1000.0 * points)[0], camera.project(points)[0])


def test_hypotheses_about_the_cloud_are_those_named_after_it():
    about_cloud = {name for name, one in HYPOTHESES.items() if one.of_cloud}
    assert about_cloud == {name for name in HYPOTHESES if name.startswith("cloud-")}


def test_hypotheses_about_the_camera_change_it():
    about_mask = {name for name, one in HYPOTHESES.items() if one.of_mask}
    assert about_mask == {name for name in HYPOTHESES if name.startswith("mask-")}
    for name, one in HYPOTHESES.items():
        assert one.name == name
        assert not (one.of_mask and one.changes_camera)
        assert one.of_mask or one.changes_camera or one.axes != "x y z"


@pytest.mark.parametrize("name", HYPOTHESES)
def test_an_assumption_can_be_sent_to_another_process(name):
    (one,) = assumed(name)
    assert pickle.loads(pickle.dumps(one)) == one


def test_a_mask_that_is_turned_left_is_turned_back_to_the_right():
    upright = np.arange(6.0, dtype=np.float32).reshape(2, 3)
    square = np.zeros((3, 3), np.float32)
    square[:2] = upright / 6.0
    camera = Camera.canonical(3, 3)
    for name, turns in (("mask-turned-left", 1), ("mask-turned-right", -1)):
        turned = View(np.rot90(square, turns), camera)
        np.testing.assert_array_equal(changed(turned, name).mask, square)


def test_PyTorch3D_s_R_and_T_are_meant_as_PyTorch3D_projects():
    """x_camera = x R + T, with x to the left and y up."""
    camera = PLANE.camera
    x_left = np.diag([-1.0, -1.0, 1.0])
    dumped = replace(camera, R=(x_left @ camera.R).T, t=x_left @ camera.t)
    seen = PLANE.target @ dumped.R + dumped.t
    meant = HYPOTHESES["pytorch3d"].camera(dumped)
    np.testing.assert_allclose(
        PLANE.target @ meant.R.T + meant.t, seen * [-1.0, -1.0, 1.0], atol=1e-12
    )


@pytest.mark.parametrize(("width", "height"), [(518, None), (100, 300)])
def test_K_of_another_image_is_resized_with_it(width, height):
    camera = PLANE.camera
    size = width, height or round(width * camera.height / camera.width)
    given = replace(camera, K=camera.resized(*size).K)
    meant = of_width(width, height).camera(given)
    np.testing.assert_allclose(meant.K, camera.K, rtol=0.005)


def test_a_width_is_part_of_the_name():
    assert hypothesis_called("K-of-width=518") == of_width(518)
    assert hypothesis_called("K-of-width=518x392") == of_width(518, 392)
    for name in ("K-of-width", "K-of-width=0", "K-of-width=5.5", "K-of-width=518x", "opengl=3"):
        assert hypothesis_called(name) is None


# Names


def test_assumptions_are_named_as_they_are_read():
    views = ["a/1.png", "a/2.png"]
    texts = ["opengl", "mask-flipped@a/1.png"]
    assert [one.text for one in assumptions_of(texts, views)] == texts
    by_last_part = assumptions_of(["mask-flipped@2.png"], views)
    assert by_last_part == (Assumption(HYPOTHESES["mask-flipped"], str(Path("a/2.png"))),)
    assert assumptions_of(["mask-inverted"], views) == (INVERTED,)


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["upside"], "`assume` is 'upside', expected a name of `assume` list, such as mask-upside"),
        (["mask-inverted@"], "such as mask-inverted, or NAME@MASK for one mask"),
        (["cloud-z-up@1.png"], "expected cloud-z-up alone: the cloud is the same for all masks"),
        (["opengl", "opengl"], "`assume` has opengl twice, expected it once"),
        (["opengl@3.png"], "there is no such mask, expected one of a/1.png, b/1.png"),
        (["opengl@1.png"], "there are 2 such masks, expected one of a/1.png, b/1.png"),
    ],
)
def test_assumptions_without_a_meaning_are_refused(texts, message):
    assert_refused(message, assumptions_of, texts, ["a/1.png", "b/1.png"])
