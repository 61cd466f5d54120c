"""Files become views as they were read, and the assumptions under which they are meant."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.corruption import assert_refused
from tests.scenes import EXAMPLES as FOLDER
from tests.scenes import block
from tso_cli.diagnosis.assumptions import INVERTED
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.io.masks import MaskChoice, read_mask
from tso_cli.io.shipped import default_checkpoint
from tso_cli.io.views import NO_FILE, ViewFiles, load_views
from tso_cli.scene.load import MIRRORED, load_points_scene
from tso_cli.scene.network import load_network_scene

MASK, CLOUD = Path("mask.png"), Path("initial.ply")


def test_views_stay_as_they_were_read_and_are_meant_as_assumed(folder):
    scene = load_points_scene(CLOUD, MASK, ["mask-inverted", "mask-flipped"])
    mask = read_mask(MASK)
    (read,), (meant,) = scene.given.read, scene.views
    np.testing.assert_array_equal(read.mask, mask)
    np.testing.assert_array_equal(meant.mask, 1.0 - mask[:, ::-1])
    assert [one.text for one in scene.given.assumptions] == ["mask-inverted", "mask-flipped"]
    assert scene.given.assumptions[0] == INVERTED


def test_a_network_sees_the_object_that_a_label_names(folder):
    labels = np.where(read_mask(MASK) > 0.5, 2, 0).astype(np.uint8)
    labels[:9, :9] = 1
    Image.fromarray(labels).save("labels.png")
    files = ViewFiles([Path("labels.png")], Path("camera.json"), choice=MaskChoice("2"))
    checkpoint = default_checkpoint()
    found = load_network_scene(Path("image.png"), files, checkpoint)
    expected = load_network_scene(Path("image.png"), ViewFiles([MASK]), checkpoint)
    np.testing.assert_allclose(found.points, expected.points, atol=0.01)


def test_the_camera_of_a_left_handed_cloud_is_said_to_be_mirrored(folder):
    points = read_cloud(CLOUD).points
    write_cloud("left.ply", points[:, [1, 0, 2]])
    scene = load_points_scene(Path("left.ply"), MASK, ["cloud-xy-swapped"])
    assert scene.camera_sources == (f"camera.json{MIRRORED}",)
    right = load_points_scene(CLOUD, MASK)
    assert right.camera_sources == ("camera.json",)
    pixels, _ = right.view.camera.project(points)
    mirrored, _ = scene.view.camera.project(scene.points)
    np.testing.assert_allclose(mirrored[:, 0], 255.0 - pixels[:, 0], atol=1e-3)
    np.testing.assert_allclose(mirrored[:, 1], pixels[:, 1], atol=1e-3)
    np.testing.assert_array_equal(scene.view.mask, right.view.mask[:, ::-1])


def test_reading_finds_and_warns_of_nothing(folder, recwarn):
    with Image.open("image.png") as image:
        np.save("photo.npy", np.asarray(image.convert("L")))
    scene = load_points_scene(CLOUD, Path("photo.npy"))
    assert scene.given.known == ()
    assert not recwarn.list


def test_a_mask_without_a_camera_file_has_the_canonical_camera(folder):
    Path("camera.json").unlink()
    scene = load_points_scene(CLOUD, MASK)
    assert scene.camera_sources == (f"canonical {NO_FILE}",)
    assert scene.camera_summary == f"canonical camera {NO_FILE}"


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (
            {"masks": [MASK, MASK], "ignore": [MASK]},
            "mask.png: found 1 ignore maps for 2 masks, expected one for each or none",
        ),
        (
            {"masks": [MASK], "depth": [MASK, MASK]},
            "mask.png: found 2 depth maps for 1 masks, expected one for each or none",
        ),
        (
            {"masks": [MASK], "image": [Path("small.png")]},
            r"small.png: is 8x8, the mask mask.png is 256x256 \(width x height\), expected the",
        ),
        (
            {"masks": [MASK], "ignore": [Path("small.png")]},
            r"small.png: is 8x8, the mask mask.png is 256x256 \(width x height\), expected the",
        ),
    ],
)
def test_files_that_do_not_belong_to_the_masks_are_refused(folder, files, message):
    Image.fromarray((255 * block(np.s_[2:4, 2:4], (8, 8))).astype(np.uint8)).save("small.png")
    assert_refused(message, load_views, ViewFiles(**files))


# The fitted camera


@pytest.fixture(scope="module")
def fitted():
    """The chair's scene, whose camera is fitted to the true cloud and the mask."""
    chair = FOLDER / "chair"
    return load_points_scene(chair / "target.ply", chair / "mask.png", fit=0)


def test_a_sure_camera_is_no_finding(fitted):
    assert fitted.given.known == ()
    assert fitted.camera_summary.startswith("camera fitted to cloud and mask: pose sure; focal ")


def test_an_unsure_camera_is_a_finding_with_its_reason(folder):
    other = FOLDER / "airplane" / "initial.ply"
    scene = load_points_scene(other, MASK, fit=0)
    (finding,) = scene.given.known
    assert finding.name == "unsure-camera"
    assert finding.views == (0,)
    assert finding.says.startswith("the fitted camera is unsure: ")
    assert scene.camera_summary.startswith("camera fitted to cloud and mask: pose unsure; focal ")


def test_a_camera_is_fitted_to_the_mask_as_it_is_meant(fitted, tmp_path):
    chair = FOLDER / "chair"
    dark = np.rint(255.0 * (1.0 - read_mask(chair / "mask.png"))).astype(np.uint8)
    Image.fromarray(dark).save(tmp_path / "dark.png")
    meant = ["mask-inverted"]
    scene = load_points_scene(chair / "target.ply", tmp_path / "dark.png", meant, fit=0)
    assert scene.given.assumptions == (INVERTED,)
    np.testing.assert_allclose(scene.view.camera.R, fitted.view.camera.R, atol=1e-6)
    np.testing.assert_allclose(scene.view.mask, fitted.view.mask, atol=1e-6)


def test_the_mask_of_a_left_handed_cloud_is_mirrored_before_a_camera_is_fitted(fitted, tmp_path):
    chair = FOLDER / "chair"
    write_cloud(tmp_path / "left.ply", read_cloud(chair / "target.ply").points[:, [1, 0, 2]])
    meant = ["cloud-xy-swapped"]
    scene = load_points_scene(tmp_path / "left.ply", chair / "mask.png", meant, fit=0)
    assert scene.given.assumptions == ()
    np.testing.assert_array_equal(scene.view.mask, fitted.view.mask[:, ::-1])


def test_a_camera_is_fitted_in_the_axes_of_the_cloud(fitted):
    chair = FOLDER / "chair"
    meant = ["cloud-upside-down"]
    scene = load_points_scene(chair / "target.ply", chair / "mask.png", meant, fit=0)
    assert scene.given.assumptions == ()
    np.testing.assert_allclose(scene.view.camera.R, fitted.view.camera.R, atol=1e-6)
