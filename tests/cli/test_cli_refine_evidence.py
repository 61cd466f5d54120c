"""`tso refine --depth` with the depths of an example's target; `--image` with painted clouds."""

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.ndimage import minimum_filter

from tests.painted import MASK, photo, sheet
from tso_cli.io.clouds import read_cloud


@pytest.fixture
def depth_map(folder, chair):
    """depth.png: depths of the target's nearest points, each drawn 9 px wide; 0 elsewhere."""
    _, mask, camera, target = chair
    pixels, depth = camera.project(target)
    nearest = np.full(mask.shape, np.inf)
    np.minimum.at(nearest, tuple(pixels.round().astype(int).T[::-1]), depth)
    nearest = minimum_filter(nearest, 9)
    depth = np.where(np.isfinite(nearest) & (mask > 0.5), nearest, 0.0)
    Image.fromarray((1e4 * depth).round().astype(np.uint16)).save("depth.png")


def test_a_depth_map_takes_off_a_quarter_more_than_the_mask_alone(depth_map, chair, refine):
    plain = ("initial.ply", "mask.png", "--symmetry", "none", "--prior", "none", "-o")
    with_depth = ("--depth", "depth.png", "--depth-scale", "0.0001")
    refine(*plain, "mask.ply")
    run = refine(*plain, "depth.ply", *with_depth)
    assert "--depth-scale" not in run.err
    refine("initial.ply", "mask.png", *with_depth, "-o", "both.ply")
    mask, depth, both = (
        chair.error(read_cloud(f"{name}.ply").points) for name in ("mask", "depth", "both")
    )
    assert depth < 0.75 * mask
    # The learned prior, which sees no depth, is corrected by it.
    assert both < depth


def test_a_depth_map_in_another_unit_is_warned_of(depth_map, refine):
    run = refine("initial.ply", "mask.png", "--check", "--depth", "depth.png")
    assert "is the scale of the depth map right? (--depth-scale)" in run.err


@pytest.fixture
def painted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    points, colours = sheet(2.0)
    start = points + np.stack(
        [0.03 * np.cos(3.3 * points[:, 0]), 0.0 * points[:, 0], 0.0 * points[:, 0]], 1
    )
    trimesh.PointCloud(start, np.rint(255.0 * colours).astype(np.uint8)).export("cloud.ply")
    Image.fromarray((255 * MASK).astype(np.uint8)).save("mask.png")
    Image.fromarray(np.rint(255.0 * photo(0.8)).astype(np.uint8)).save("photo.png")
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save("small.png")
    return tmp_path


def test_an_image_brings_a_cloud_nearer_and_its_colours_stay(painted, refine):
    for name, words in {"image": ("--image", "photo.png"), "mask": ()}.items():
        run = refine("cloud.ply", "mask.png", *words, "-o", f"{name}.ply", "--symmetry", "none")
        assert run.code == 0
    truth = sheet(2.0)[0]
    moved = np.stack([read_cloud(name).points for name in ("image.ply", "mask.ply")])
    with_image, without = np.linalg.norm(moved - truth, axis=2).mean(1)
    assert with_image < 0.5 * without
    assert np.array_equal(read_cloud("image.ply").colours(), read_cloud("cloud.ply").colours())


@pytest.mark.parametrize(
    ("photos", "message"),
    [
        (("small.png",), "small.png: is 8x8, the mask mask.png is 64x64"),
        (
            ("photo.png", "photo.png"),
            "--image photo.png: found 2 images for 1 masks, expected one for each or none",
        ),
        (("none.png",), "none.png: does not exist"),
    ],
)
def test_an_image_that_does_not_fit_gets_one_line_and_writes_nothing(
    painted, refine, photos, message
):
    options = [word for photo in photos for word in ("--image", photo)]
    assert message in refine("cloud.ply", "mask.png", *options).refusal
    assert not list(painted.glob("*.refined.ply"))
