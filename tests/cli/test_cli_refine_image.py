"""`tso refine --image`: photos beside the masks, of clouds that have colours."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.painted import MASK, photo, sheet
from tso_cli.io.clouds import read_cloud, write_cloud

from .run import errors, tso


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    points, colours = sheet(2.0)
    start = points + np.stack([0.03 * np.cos(3.3 * points[:, 0]), 0.0 * points[:, 0], 0.0 * points[:, 0]], 1)
    trimesh.PointCloud(start, np.rint(255.0 * colours).astype(np.uint8)).export("cloud.ply")
    write_cloud("plain.ply", start)
    Image.fromarray((255 * MASK).astype(np.uint8)).save("mask.png")
    Image.fromarray(np.rint(255.0 * photo(0.8)).astype(np.uint8)).save("photo.png")
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save("small.png")
    return tmp_path


def run(*words):
    return tso("refine", *words, "--symmetry", "none")


def test_an_image_brings_a_cloud_nearer_and_its_colours_stay(folder, capsys):
    assert run("cloud.ply", "mask.png", "--image", "photo.png", "-o", "image.ply") == 0
    assert run("cloud.ply", "mask.png", "-o", "mask.ply") == 0
    truth = sheet(2.0)[0]
    with_image, without = (
        np.linalg.norm(read_cloud(f"{name}.ply").points - truth, axis=1).mean() for name in ("image", "mask")
    )
    assert with_image < 0.5 * without
    assert np.array_equal(read_cloud("image.ply").colours(), read_cloud("cloud.ply").colours())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("plain.ply", "--image", "photo.png"), "plain.ply: its points have no colours, expected red, green and blue"),
        (("cloud.ply", "--image", "small.png"), "small.png: is 8x8, the mask mask.png is 64x64"),
        (("cloud.ply", "--image", "photo.png", "--image", "photo.png"), "found 2 images for 1 masks, expected one for each"),
        (("cloud.ply", "--image", "none.png"), "none.png: does not exist"),
        (("cloud.ply", "--image", "photo.png", "--preset", "paper"), "--image is for --mode points --preset best"),
        (("photo.png", "--image", "photo.png", "--mode", "latent"), "--image is for --mode points --preset best"),
    ],
)
def test_an_image_that_does_not_fit_gets_one_line_and_writes_nothing(folder, capsys, words, message):
    source, *more = words
    assert run(source, "mask.png", *more) == 2
    (error,) = errors(capsys)
    assert message in error
    assert not list(folder.glob("*.refined.ply"))
