"""A photo given in place of its mask is told; soft masks are not taken for photos."""

import warnings

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from tests.scenes import EXAMPLES, example
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.view import View
from tso_cli.scene.load import ViewFiles, load_views


def like_photo(mask, known=None):
    return View(mask.astype(np.float32), Camera.canonical(*mask.shape[::-1]), known).like_photo


@pytest.mark.parametrize("invert", [False, True])
@pytest.mark.parametrize("name", ["chair", "car", "airplane"])
def test_a_photo_in_place_of_its_mask_is_told_beside_a_right_one_too(name, invert):
    files = [EXAMPLES / name / "mask.png", EXAMPLES / name / "image.png"]
    camera = EXAMPLES / name / "camera.json"
    with pytest.warns(UserWarning, match=r"image.png: looks like a photo") as told:
        views = [load_views(ViewFiles([file], camera, invert=invert))[0][0] for file in files]
    assert len(told) == 1
    assert [view.like_photo for view in views] == [False, True]


def test_a_large_photo_is_told(tmp_path):
    with Image.open(EXAMPLES / "chair" / "image.png") as image:
        image.resize((3000, 3000)).save(tmp_path / "large.png")
    with pytest.warns(UserWarning, match=r"large.png: looks like a photo"):
        load_views(ViewFiles([tmp_path / "large.png"]))


@pytest.mark.parametrize("name", ["chair", "car", "airplane"])
@pytest.mark.parametrize("blur", [0.0, 1.0, 3.0])
def test_a_soft_mask_is_none(name, blur, tmp_path):
    soft = gaussian_filter(example(name).mask, blur) if blur else example(name).mask
    Image.fromarray((255.0 * soft).astype(np.uint8)).save(tmp_path / "mask.png")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_views(ViewFiles([tmp_path / "mask.png"]))


def test_a_soft_mask_of_struts_as_thin_as_a_pixel_is_none():
    mask = np.zeros((256, 256))
    # Each strut covers a row to three fifths and the next one to two.
    mask[::8], mask[1::8] = 0.6, 0.4
    assert not like_photo(mask)


def test_a_soft_mask_of_few_pixels_is_none():
    rows, columns = np.indices((64, 64))
    assert not like_photo(1.0 / (1.0 + np.exp((np.hypot(rows - 32, columns - 32) - 8.0) / 3.0)))


def test_what_the_ignore_map_leaves_out_may_be_grey():
    mask = np.where(example("chair").mask > 0.5, 1.0, 0.0)
    known = np.ones(mask.shape, bool)
    mask[:, :90], known[:, :90] = 0.4, False
    assert like_photo(mask)
    assert not like_photo(mask, known)
