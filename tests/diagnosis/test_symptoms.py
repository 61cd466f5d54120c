"""What a cloud, a mask or a camera looks like when something is wrong with it, one by one."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from tests.scenes import EXAMPLES as FOLDER
from tests.scenes import about, block, example, in_photo
from tso_cli import Camera, View
from tso_cli.diagnosis import symptoms
from tso_cli.diagnosis.cells import Outline
from tso_cli.diagnosis.placement import place
from tso_cli.io.masks import read_mask

from .common import EXAMPLES, boxed

CANONICAL = Camera.canonical(64, 64)


def view_of(mask: np.ndarray, known: np.ndarray | None = None) -> View:
    return View(mask.astype(np.float32), Camera.canonical(*mask.shape[::-1]), known)


# A photo in place of a mask


@pytest.mark.parametrize("invert", [False, True])
@pytest.mark.parametrize("name", EXAMPLES)
def test_a_photo_in_place_of_a_mask_is_found_and_its_mask_is_none(name, invert):
    found = []
    for file in ("mask.png", "image.png"):
        # A file of one channel may be a map of probabilities, and is read as it is.
        with Image.open(FOLDER / name / file) as image:
            mask = np.asarray(image.convert("L")) / np.float32(255.0)
        found.append(symptoms.photo(view_of(1.0 - mask if invert else mask), 3))
    assert found[0] is None
    assert found[1].name == "photo"
    assert found[1].views == (3,)


def test_a_large_photo_is_found(tmp_path):
    with Image.open(FOLDER / "chair" / "image.png") as image:
        np.save(tmp_path / "large.npy", np.asarray(image.convert("L").resize((3000, 3000))))
    assert symptoms.photo(view_of(read_mask(tmp_path / "large.npy")), 0)


@pytest.mark.parametrize("name", EXAMPLES)
@pytest.mark.parametrize("blur", [0.0, 1.0, 3.0])
def test_a_soft_mask_is_no_photo(name, blur):
    mask = example(name).mask
    soft = gaussian_filter(mask, blur) if blur else mask
    assert symptoms.photo(view_of(np.rint(255.0 * soft) / 255.0), 0) is None


def test_a_soft_mask_of_struts_as_thin_as_a_pixel_is_no_photo():
    mask = np.zeros((256, 256))
    # Each strut covers three fifths of one row and two fifths of the next one.
    mask[::8], mask[1::8] = 0.6, 0.4
    assert symptoms.photo(view_of(mask), 0) is None


def test_a_soft_mask_of_few_pixels_is_no_photo():
    rows, columns = np.indices((64, 64))
    mask = 1.0 / (1.0 + np.exp((np.hypot(rows - 32, columns - 32) - 8.0) / 3.0))
    assert symptoms.photo(view_of(mask), 0) is None


def test_what_the_ignore_map_leaves_out_may_be_grey():
    mask = np.where(example("chair").mask > 0.5, 1.0, 0.0)
    known = np.ones(mask.shape, bool)
    mask[:, :90], known[:, :90] = 0.4, False
    assert symptoms.photo(view_of(mask), 0)
    assert symptoms.photo(view_of(mask, known), 0) is None


# Coarse masks


@pytest.mark.parametrize(
    ("rows", "columns", "points", "name"),
    [
        (1, 1, 1024, "coarse"),
        (3, 2, 1024, "coarse"),
        (3, 5, 4, "coarse"),  # fewer than 16 pixels, whatever the points
        (15, 15, 1024, "coarse"),
        (15, 15, 450, None),  # two points for each pixel
        (16, 1, 1024, None),
        (16, 16, 100_000, None),
    ],
)
def test_a_coarse_mask(rows, columns, points, name):
    view = view_of(block(np.s_[20 : 20 + rows, 9 : 9 + columns]))
    found = symptoms.coarse(view, 2, points)
    assert (found and found.name) == name
    if name == "coarse":
        assert dict(found.values) == {"pixels": rows * columns, "side": max(rows, columns)}
        assert found.views == (2,)
        assert f"few pixels ({rows * columns})" in found.says


def test_foreground_far_from_the_object_is_a_speck():
    mask = block(np.s_[4:30, 4:30])
    assert symptoms.specks(view_of(mask), 0) is None
    mask[61:63, 60:63] = 1.0
    found = symptoms.specks(view_of(mask), 1)
    assert found.views == (1,)
    assert found.says == "foreground far from the object is left out (6 px)"


# Points and the camera


@pytest.mark.parametrize(("count", "found"), [(0, False), (1, True), (499, True), (500, False)])
def test_points_behind_the_camera(cloud, count, found):
    points = cloud.copy()
    points[:count] += [0.0, 0.0, 5.0]
    finding = symptoms.behind(place(points, view_of(block(np.s_[20:44, 20:44]))), 0)
    assert bool(finding) == found
    if found:
        assert finding.says.startswith(f"{count} of 500 points lie behind the camera")


# Bounding boxes in place of masks


def box_in(view: View, points: np.ndarray):
    return symptoms.bounding_box(Outline(view), view, 1, points)


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_box_in_place_of_a_mask_is_found(name):
    scene = example(name)
    assert box_in(scene.view, scene.points) is None
    finding = box_in(boxed(scene.view), scene.points)
    assert finding.name == "box"
    assert finding.views == (1,)
    assert finding.suspicious


def panel(count: int = 1024) -> np.ndarray:
    """A frontal sheet [N, 3], which fills its bounding box."""
    rng = np.random.default_rng(0)
    sides = rng.uniform(-0.5, 0.5, count), rng.uniform(-0.2, 0.2, count), np.zeros(count)
    return np.stack(sides, axis=1)


_NOISE = np.random.default_rng(1)
PANELS = {
    "as it is": panel(),
    "few points": panel(512),
    "turned": panel() @ about("z", 10.0).T,
    "noisy": panel() + _NOISE.normal(scale=[0.02, 0.02, 0.0], size=(1024, 3)),
    "outliers": np.vstack([panel(), _NOISE.uniform(-0.6, 0.6, (10, 3)) * [1.0, 1.0, 0.0]]),
    "an ellipse": panel()[np.square(panel()[:, :2] / [0.5, 0.2]).sum(1) < 1.0],
}


@pytest.mark.parametrize("name", PANELS)
def test_a_panel_that_fills_its_box_is_no_box(name):
    camera = Camera.canonical(256, 256)
    pixels = np.rint(camera.project(panel())[0]).astype(int)
    (left, top), (right, bottom) = pixels.min(0), pixels.max(0)
    mask = block(np.s_[top : bottom + 1, left : right + 1], (256, 256))
    assert box_in(View(mask, camera), PANELS[name]) is None


def test_few_pixels_or_points_do_not_show_a_box():
    scene = example("car")
    assert box_in(boxed(scene.view), scene.points)
    assert box_in(boxed(scene.view), scene.points[:100]) is None
    mask, camera = scene.mask[::20, ::20], scene.camera.resized(13, 13)
    assert box_in(boxed(View(mask, camera)), scene.points) is None


def test_an_inverted_mask_that_fills_the_picture_is_no_box():
    scene = example("car")
    view = in_photo(scene.view, 12, 1000, 1000)
    inverted = replace(view, mask=1.0 - view.mask)
    assert inverted.inside.mean() > 0.99
    assert box_in(inverted, scene.points) is None
