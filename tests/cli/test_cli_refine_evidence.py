"""`tso refine --depth` with the depths of an example's target; `--image` with painted clouds."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.painted import MASK, photo, sheet
from tests.scenes import depth_of
from tso_cli.io.clouds import read_cloud


@pytest.fixture
def depth_map(folder, chair):
    """depth.png: depths of the true cloud in 10,000ths; 0 elsewhere."""
    depth = np.nan_to_num(depth_of(chair))
    Image.fromarray((1e4 * depth).round().astype(np.uint16)).save("depth.png")
    return depth


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


@pytest.fixture
def maps(depth_map):
    """The same map held in other ways, in 16 bits; 0 where it is unknown."""
    known = depth_map > 0.0
    inverse = 1.0 / np.where(known, depth_map, 1.0)
    for name, values in {
        "inverse": 5e4 * (inverse - 0.2),
        "affine": 3e4 * (depth_map - 0.95 * depth_map[known].min()),
        "inverse_npy": inverse - 0.4,
    }.items():
        values = np.where(known, values, 0.0)
        if name.endswith("npy"):
            np.save("inverse.npy", values)
        else:
            Image.fromarray(values.round().astype(np.uint16)).save(f"{name}.png")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("inverse.png", "inverse.png: the map looks like inverse depth (rank correlation with the "
         "cloud's depth -0."),
        ("inverse.png", " and is ignored: try --depth-kind inverse"),
        ("affine.png", "affine.png: the map looks like depth up to scale and shift"),
        ("affine.png", " and is ignored: try --depth-kind affine"),
        ("depth.png", "depth.png: the map's values are 9"),
        ("depth.png", "times the cloud's depths, so it is ignored: try --depth-scale 0.0001"),
        ("depth.png --depth-scale 0.1", ": try --depth-scale 0.0001"),
    ],
)  # fmt: skip
def test_a_map_that_holds_something_else_is_ignored_with_a_word_what_mends_it(
    maps, refine, words, line
):
    checked = refine("initial.ply", "mask.png", "--check", "--depth", *words.split())
    assert line in checked.err
    run = refine("initial.ply", "mask.png", "--json", "--depth", *words.split())
    assert any(line in text for text in run.document["warnings"])
    assert line in run.err
    without = refine("initial.ply", "mask.png", "-o", "without.ply", "--json")
    for name in ("confidence", "verdict", "loss_after", "iou_after"):
        assert run.document[name] == without.document[name]


@pytest.mark.parametrize("kind", ["inverse", "affine"])
def test_a_map_of_a_known_kind_helps_nearly_as_much_as_depth(maps, chair, refine, kind):
    plain = ("initial.ply", "mask.png", "--symmetry", "none", "--prior", "none", "-o")
    refine(*plain, "mask.ply")
    run = refine(*plain, "kind.ply", "--depth", f"{kind}.png", "--depth-kind", kind)
    assert f"{kind}.png: the map of kind {kind} is fitted to the cloud: " in run.err
    mask, mended = (chair.error(read_cloud(f"{name}.ply").points) for name in ("mask", "kind"))
    assert mended < 0.85 * mask


def test_a_map_is_used_as_told(maps, refine):
    words = ("initial.ply", "mask.png", "--depth", "inverse.png", "--depth-kind", "z", "--json")
    run = refine(*words, "--accept-doubtful")
    # The sentence about the distance of the maps speaks of "the maps".
    assert not any(re.search(r"the map\b", text) for text in run.document["warnings"])
    alone = refine("initial.ply", "mask.png", "-o", "alone.ply", "--json")
    assert run.document["iou_after"] < alone.document["iou_after"]


def test_a_negative_map_is_read_if_its_kind_is_told(maps, refine):
    words = ("initial.ply", "mask.png", "--depth", "inverse.npy")
    assert "expected 0 (unknown) or more, or another --depth-kind" in refine(*words).refusal
    assert "is fitted to the cloud" in refine(*words, "--depth-kind", "inverse").err


def test_a_manifest_gives_a_kind_to_each_map(maps, tso):
    rows = ["cloud,mask,depth,depth-kind,output"]
    rows += [f"initial.ply,mask.png,inverse.png,{kind},{kind}.ply" for kind in ("auto", "inverse")]
    Path("items.csv").write_text("\n".join(rows))
    assert tso("batch", "items.csv", "-o", "out").code == 0
    first, second = (read_cloud(f"out/{kind}.ply").points for kind in ("auto", "inverse"))
    assert not np.array_equal(first, second)


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


def test_a_cloud_that_is_refined_with_its_photo_keeps_its_colours(painted, refine):
    run = refine("cloud.ply", "mask.png", "--image", "photo.png", "-o", "out.ply")
    assert run.code == 0
    assert np.array_equal(read_cloud("out.ply").colours(), read_cloud("cloud.ply").colours())


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
