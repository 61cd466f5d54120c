"""Network input: photo, mask and camera get the same crop, an exact area average."""

from dataclasses import replace

import numpy as np
import pytest

from tests.corruption import assert_refused
from tests.scenes import EXAMPLES, block
from tso_cli import Camera, View
from tso_cli.geometry.resampling import area_resize
from tso_cli.io.images import read_image
from tso_cli.network.input import crop_box, network_input, whole_box
from tso_cli.network.model import NetworkConfig, build_network
from tso_cli.scene.network import network_scene


def rectangle(height, width, region):
    return View(block(region, (height, width)), Camera.canonical(width, height))


def overlaps(low, high, cells, pixels):
    """Lengths [cells, pixels] that cells between two borders share with the pixels of an image."""
    borders, centres = np.linspace(low, high, cells + 1)[:, None], np.arange(pixels)
    return np.clip(
        np.minimum(borders[1:], centres + 0.5) - np.maximum(borders[:-1], centres - 0.5), 0.0, None
    )


@pytest.mark.parametrize(
    "box",
    [(0.2, 1.1, 6.7, 5.4), (-3.0, -2.0, 4.0, 9.0), (2.1, 2.2, 2.9, 3.7), (-4.5, 0.0, 3.5, 3.0)],
)
def test_area_resize_is_the_exact_average_and_coverage_the_share_inside_the_image(box):
    array, (left, top, right, bottom) = np.random.default_rng(0).random((7, 8)), box
    values, coverage = area_resize(array, box, 4, 3)
    down, across = overlaps(top, bottom, 3, 7), overlaps(left, right, 4, 8)
    area = np.outer(down.sum(1), across.sum(1))
    np.testing.assert_allclose(values * area, down @ array @ across.T, atol=1e-12)
    np.testing.assert_allclose(coverage, area * 12 / ((right - left) * (bottom - top)), atol=1e-12)
    assert not values[area == 0.0].any()


def test_pixels_of_weight_zero_do_not_enter_the_average():
    known = np.array([[True, False], [True, False]])
    values, coverage = area_resize(
        np.array([[1.0, 100.0], [3.0, 100.0]]), (-0.5, -0.5, 1.5, 1.5), 1, 1, known
    )
    assert (values.item(), coverage.item()) == pytest.approx((2.0, 0.5))


def test_the_longer_side_of_the_mask_fills_the_crop_to_the_given_share():
    view = rectangle(100, 200, np.s_[10:40, 50:140])
    for share in (0.5, 0.9, 1.0):
        left, top, right, bottom = crop_box(view.box(), share)
        assert right - left == pytest.approx(90 / share) == pytest.approx(bottom - top)
        assert ((left + right) / 2, (top + bottom) / 2) == pytest.approx((94.5, 24.5))


def test_the_cropped_camera_projects_points_to_their_pixels_in_the_crop():
    """Spots in a photo lie in the crop where the cropped camera projects them."""
    camera = replace(Camera.canonical(320, 240), t=np.array([0.1, -0.05, 2.5]))
    points = np.random.default_rng(3).uniform(-0.3, 0.3, (4, 3))
    pixels, _ = camera.project(points)
    low, high = np.floor(pixels.min(0)).astype(int) - 20, np.ceil(pixels.max(0)).astype(int) + 20
    mask = block(np.s_[low[1] : high[1], low[0] : high[0]], (240, 320))
    v, u = np.mgrid[:240, :320]
    rows, columns = np.mgrid[:64, :64]
    for point, pixel in zip(points, pixels, strict=True):
        spot = np.exp(-((u - pixel[0]) ** 2 + (v - pixel[1]) ** 2) / (2 * 4.0**2))
        photo = np.rint(255.0 * spot[..., None]).astype(np.uint8).repeat(3, 2)
        crop = network_input(photo, View(mask, camera), background="keep")
        light = crop.image[0].astype(float)
        centre = np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()
        np.testing.assert_allclose(centre, crop.camera.project(point[None])[0][0], atol=1e-2)
    np.testing.assert_array_equal([*crop.camera.R, crop.camera.t], [*camera.R, camera.t])
    assert crop.camera.width == 64
    assert crop.camera.height == 64


@pytest.mark.parametrize(("background", "value"), [("black", 0.0), ("white", 1.0), ("keep", 0.6)])
def test_the_background_follows_the_mask(background, value):
    view = rectangle(90, 90, np.s_[30:60, 40:50])
    image = np.full((90, 90, 3), 153, np.uint8)
    crop = network_input(image, view, background=background)
    assert crop.image.dtype == np.float32
    assert crop.image.shape == (3, 64, 64)
    np.testing.assert_allclose(crop.image[:, crop.mask == 1.0], 0.6, atol=1e-6)
    np.testing.assert_allclose(crop.image[:, crop.mask == 0.0], value, atol=1e-6)


def test_what_lies_outside_the_photo_is_unknown_and_has_the_background_colour():
    view = rectangle(40, 40, np.s_[:, :20])
    crop = network_input(
        np.full((40, 40, 3), 255, np.uint8), view, crop_share=0.8, background="white"
    )
    assert not crop.known[0].any()
    assert not crop.known[:, 0].any()
    assert crop.known[32, 32]
    np.testing.assert_array_equal(crop.mask[~crop.known], 0.0)
    np.testing.assert_allclose(crop.image, 1.0, atol=1e-6)
    assert crop.view().known is crop.known


def test_ignored_pixels_stay_unknown_in_the_crop():
    view, known = rectangle(64, 64, np.s_[16:48, 16:48]), block(np.s_[:, 40:44]) == 0.0
    crop = network_input(np.zeros((64, 64, 3), np.uint8), replace(view, known=known))
    left, _, right, _ = crop_box(view.box(), 0.9)
    centres = left + (np.flatnonzero(~crop.known.all(0)) + 0.5) * (right - left) / 64
    assert len(centres) > 0
    assert centres.min() > 39.0
    assert centres.max() < 44.0


def test_an_alpha_channel_counts_only_where_the_photo_is_kept():
    view = rectangle(64, 64, np.s_[16:48, 16:48])
    image = np.full((64, 64, 4), 255, np.uint8)
    image[:, :, 3] = 0
    assert network_input(image, view, background="black").image.max() == pytest.approx(1.0)
    assert network_input(image, view, background="keep").image.max() == 0.0


def test_a_photo_enlarged_gives_the_same_input_and_soft_mask_values_are_kept():
    small = rectangle(32, 32, np.s_[8:24, 8:24])
    small.mask[8:24, 15:18] = 0.7
    image = np.random.default_rng(0).integers(0, 256, (32, 32, 3)).astype(np.uint8)
    mask = np.kron(small.mask, np.ones((5, 5), np.float32))
    big = network_input(image.repeat(5, 0).repeat(5, 1), View(mask, small.camera.resized(160, 160)))
    one = network_input(image, small)
    np.testing.assert_allclose(one.image, big.image, atol=1e-6)
    np.testing.assert_allclose(one.mask, big.mask, atol=1e-6)
    np.testing.assert_allclose(one.camera.K, big.camera.K, atol=1e-9)
    assert np.isclose(one.mask, 0.7).any()


def test_wrong_sizes_are_refused():
    view, image = rectangle(40, 40, np.s_[10:30, 10:30]), np.zeros((40, 40, 3), np.uint8)
    assert_refused("the image is 30x40, the mask 40x40", network_input, image[:, :30], view)
    assert_refused("box is", area_resize, image, (3.0, 0.0, 3.0, 5.0), 4, 4)


@pytest.mark.parametrize("size", [0.3, 0.9])
def test_a_crop_of_share_0_keeps_the_size_of_the_object(size):
    """The larger of two objects fills more of the input; the canonical picture is not cropped."""
    half = round(60.0 * size)  # of its side, in pixels of 128
    view = rectangle(128, 128, np.s_[64 - half : 64 + half, 64 - half : 64 + half])
    crop = network_input(np.zeros((128, 128, 3), np.uint8), view, crop_share=0.0)
    np.testing.assert_allclose(whole_box(view.camera), (-0.5, -0.5, 127.5, 127.5))
    assert crop.mask.sum() == pytest.approx(half**2, rel=0.06)


def test_a_crop_of_share_0_does_not_depend_on_resolution_or_distance():
    near = Camera.canonical(64, 64)
    far = Camera(
        [[360.0, 0.0, 200.0], [0.0, 360.0, 90.0], [0.0, 0.0, 1.0]], near.R, 1.5 * near.t, 320, 240
    )
    point = np.array([[0.2, -0.1, 0.0]])
    pixels = []
    for camera in (near, far):
        u, v = np.rint(camera.project(np.zeros((1, 3)))[0][0]).astype(int)
        mask = block(np.s_[v - 3 : v + 4, u - 3 : u + 4], (camera.height, camera.width))
        crop = network_input(
            np.zeros((*mask.shape, 3), np.uint8), View(mask, camera), crop_share=0.0
        )
        pixels.append(crop.camera.project(point)[0][0])
    np.testing.assert_allclose(pixels[0], pixels[1], atol=1e-9)


@pytest.mark.parametrize(
    ("t", "message"),
    [
        ((0.0, 0.0, -2.0), "at depth -2, expected it in front"),
        (
            (5.0, 0.0, 2.0),
            r"nothing of the object lies in the 1\.07 units around the world's origin",
        ),
    ],
)
def test_a_crop_of_share_0_needs_the_object_before_the_camera_and_near_the_origin(t, message):
    camera = replace(Camera.canonical(64, 64), t=np.array(t))
    view = View(block(np.s_[20:30, 20:30]), camera)
    assert_refused(message, network_input, np.zeros((64, 64, 3), np.uint8), view, crop_share=0.0)


def test_a_network_that_sees_sizes_takes_the_distance_of_the_camera_and_notes_its_absence(chair):
    image = read_image(EXAMPLES / "chair" / "image.png")
    network, config = build_network(seed=0).eval(), NetworkConfig(crop_share=0.0)

    def crop_of(distance):
        view = View(chair.mask, replace(chair.camera, t=distance * chair.camera.t))
        scene = network_scene(image, view, network, config)
        assert "(only its K and t)" in scene.camera_summary
        return scene.views[0].mask

    # The same object, said to be nearer and so smaller, fills less of what the network sees.
    assert crop_of(0.75).sum() < 0.7 * crop_of(1.0).sum()
    for known_camera, notes in ((True, []), (False, ["assumed-picture"])):
        scene = network_scene(image, chair.view, network, config, known_camera=known_camera)
        assert [finding.name for finding in scene.given.known] == notes
