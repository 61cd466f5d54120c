"""Files from Python, named by strings."""

import json

import numpy as np
import pytest

import tso_cli
from tso_cli import (
    Camera,
    InputError,
    RefineConfig,
    View,
    draw_overlay,
    read_camera,
    read_cameras,
    read_depth,
    read_image,
    read_mask,
    refine,
    write_cameras,
    write_depth,
    write_mask,
)

MASK = np.zeros((48, 64), np.float32)
MASK[12:40, 20:50] = 1.0


@pytest.fixture
def name(tmp_path):
    return lambda file: str(tmp_path / file)


def test_one_camera_and_several_read_back_as_they_were_written(name):
    one, other = Camera.canonical(64, 48), Camera.canonical(32, 32)
    write_cameras(name("one.json"), one)
    write_cameras(name("two.json"), [one, other])
    for found in (read_camera(name("one.json"), 64, 48), read_cameras(name("two.json"))[0]):
        np.testing.assert_array_equal(found.K, one.K)
        np.testing.assert_array_equal(found.R, one.R)
    assert [camera.width for camera in read_cameras(name("two.json"))] == [64, 32]


def test_cameras_of_a_file_without_sizes_are_for_the_size_that_is_given(name):
    frame = {"file_path": "./a", "transform_matrix": np.eye(4).tolist()}
    with open(name("transforms.json"), "w") as file:
        json.dump({"camera_angle_x": np.pi / 2.0, "frames": [frame, frame]}, file)
    with pytest.raises(InputError, match="expected width and height, or `size`"):
        read_cameras(name("transforms.json"))
    cameras = read_cameras(name("transforms.json"), size=(64, 48))
    assert [(camera.width, camera.height) for camera in cameras] == [(64, 48)] * 2
    np.testing.assert_allclose(cameras[0].K, [[32.0, 0, 31.5], [0, 32.0, 23.5], [0, 0, 1]])


def test_a_mask_reads_back_to_a_256th(name):
    soft = MASK * np.linspace(0.5, 1.0, 64, dtype=np.float32)
    write_mask(name("mask.png"), soft)
    assert np.abs(read_mask(name("mask.png")) - soft).max() <= 0.5 / 255.0 + 1e-6


def test_a_depth_map_reads_back_with_its_unknown_pixels(name):
    depth = np.where(MASK > 0.5, 1.25, np.nan)
    write_depth(name("depth.npy"), depth)
    np.testing.assert_array_equal(read_depth(name("depth.npy")), depth)
    np.testing.assert_array_equal(read_depth(name("depth.npy"), scale=2.0), 2.0 * depth)


@pytest.mark.parametrize(
    ("write", "file", "value", "message"),
    [
        (write_mask, "mask.jpg", MASK, "the suffix is '.jpg', expected .png"),
        (write_mask, "mask.png", 2.0 * MASK, "mask values span 0 to 2, expected 0 to 1"),
        (write_mask, "mask.png", MASK[0], r"has shape \[64\], expected a mask \[H, W\]"),
        (write_depth, "depth.png", MASK, "the suffix is '.png', expected .npy"),
    ],
)
def test_what_cannot_be_written_is_refused_in_words(name, tmp_path, write, file, value, message):
    with pytest.raises(InputError, match=message):
        write(name(file), value)
    assert not list(tmp_path.iterdir())


def test_a_file_that_exists_stays_without_overwrite(name):
    write_mask(name("mask.png"), MASK)
    with pytest.raises(InputError, match="exists"):
        write_mask(name("mask.png"), MASK)
    write_mask(name("mask.png"), MASK, overwrite=True)


def test_the_overlay_is_a_picture_that_can_be_read(name):
    view = View(MASK, Camera.canonical(64, 48))
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (200, 3))
    result = refine(points, view, config=RefineConfig(steps=3))
    draw_overlay(name("overlay.png"), result, view)
    assert read_image(name("overlay.png")).shape[2] == 3
    with pytest.raises(InputError, match="exists"):
        draw_overlay(name("overlay.png"), result, view)


def test_every_public_name_can_be_loaded_and_is_shown_to_editors():
    for public in tso_cli.__all__:
        assert getattr(tso_cli, public) is not None
    assert dir(tso_cli) == sorted(tso_cli.__all__)
    assert set(tso_cli.__all__) == set(tso_cli._WHERE)
