"""A photo given in place of its mask is told, and nothing follows it; soft masks are not taken for photos."""

import json

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from tests.scenes import EXAMPLES, example
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.view import View
from tso_cli.refinement.agreement import Agreement
from tso_cli.scene.load import ViewFiles, load_points_scene, load_views


def photo_of(name):
    """As masks whose photo is light beside the object."""
    return ViewFiles([EXAMPLES / name / "image.png"], EXAMPLES / name / "camera.json", invert=True)


@pytest.mark.parametrize("name", ["chair", "car", "airplane"])
def test_a_photo_in_place_of_its_mask_is_suspected_and_nothing_else(name):
    scene = load_points_scene(EXAMPLES / name / "initial.ply", photo_of(name))
    agreement = Agreement.of(scene.moving, scene.views)
    assert "image.png is a photo, grey in many places: try its mask" in agreement.suspicion
    assert len(agreement.named) == 1 and agreement.hint is None


@pytest.mark.parametrize("name", ["chair", "car", "airplane"])
@pytest.mark.parametrize("blur", [0.0, 1.0, 3.0])
def test_a_soft_mask_is_none(name, blur, tmp_path):
    soft = gaussian_filter(example(name).mask, blur) if blur else example(name).mask
    Image.fromarray((255.0 * soft).astype(np.uint8)).save(tmp_path / "mask.png")
    ((view,), _) = load_views(ViewFiles([tmp_path / "mask.png"]))
    assert not view.shows_photo


def test_a_soft_mask_of_struts_as_thin_as_a_pixel_is_none():
    mask = np.zeros((256, 256), np.float32)
    # Each strut covers a row to three fifths and the next one to two.
    mask[::8], mask[1::8] = 0.6, 0.4
    assert not View(mask, Camera.canonical(256, 256)).shows_photo


@pytest.mark.parametrize("name", ["chair", "car", "airplane"])
def test_a_cloud_does_not_follow_a_photo(tso, name, tmp_path):
    folder, output = EXAMPLES / name, tmp_path / "o.ply"
    given = folder / "initial.ply", folder / "image.png", "--camera", folder / "camera.json", "-o", output, "--json"
    found = json.loads(tso("refine", *given).out)
    assert found["verdict"] == "doubtful" and "photo" in found["reason"] and found["moved_mean"] == 0.0
    assert tso("refine", *given, "--strict", "--overwrite").code == 3
