"""`tso refine --image`: photos beside the masks, of clouds that have colours."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.painted import MASK, photo, sheet
from tso_cli.io.clouds import read_cloud


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    points, colours = sheet(2.0)
    start = points + np.stack([0.03 * np.cos(3.3 * points[:, 0]), 0.0 * points[:, 0], 0.0 * points[:, 0]], 1)
    trimesh.PointCloud(start, np.rint(255.0 * colours).astype(np.uint8)).export("cloud.ply")
    Image.fromarray((255 * MASK).astype(np.uint8)).save("mask.png")
    Image.fromarray(np.rint(255.0 * photo(0.8)).astype(np.uint8)).save("photo.png")
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save("small.png")
    return tmp_path


def test_an_image_brings_a_cloud_nearer_and_its_colours_stay(folder, refine):
    for name, words in {"image": ("--image", "photo.png"), "mask": ()}.items():
        assert refine("cloud.ply", "mask.png", *words, "-o", f"{name}.ply", "--symmetry", "none").code == 0
    truth = sheet(2.0)[0]
    with_image, without = (
        np.linalg.norm(read_cloud(f"{name}.ply").points - truth, axis=1).mean() for name in ("image", "mask")
    )
    assert with_image < 0.5 * without
    assert np.array_equal(read_cloud("image.ply").colours(), read_cloud("cloud.ply").colours())


@pytest.mark.parametrize(
    ("photos", "message"),
    [
        (("small.png",), "small.png: is 8x8, the mask mask.png is 64x64"),
        (("photo.png", "photo.png"), "found 2 images for 1 masks, expected one for each"),
        (("none.png",), "none.png: does not exist"),
    ],
)
def test_an_image_that_does_not_fit_gets_one_line_and_writes_nothing(folder, refine, photos, message):
    assert message in refine("cloud.ply", "mask.png", *(word for photo in photos for word in ("--image", photo))).refusal
    assert not list(folder.glob("*.refined.ply"))
