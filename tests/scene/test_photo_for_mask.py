"""A photo given in place of its mask is told; soft masks are not."""

import warnings

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from tests.scenes import EXAMPLES, example
from tso_cli.scene.load import ViewFiles, load_views


@pytest.mark.parametrize("name", ["chair", "car", "airplane"])
def test_a_photo_in_place_of_its_mask_is_told(name):
    with pytest.warns(UserWarning, match=r"image.png: looks like a photo"):
        load_views(ViewFiles([EXAMPLES / name / "image.png"], EXAMPLES / name / "camera.json", invert=True))


@pytest.mark.parametrize("name", ["chair", "car", "airplane"])
@pytest.mark.parametrize("blur", [0.0, 1.0, 3.0])
def test_a_soft_mask_is_none(name, blur, tmp_path):
    soft = gaussian_filter(example(name).mask, blur) if blur else example(name).mask
    Image.fromarray((255.0 * soft).astype(np.uint8)).save(tmp_path / "mask.png")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_views(ViewFiles([tmp_path / "mask.png"]))
