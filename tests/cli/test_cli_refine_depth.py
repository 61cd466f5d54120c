"""`tso refine --depth` on a shipped example, with a depth map made of its target."""

import shutil

import numpy as np
import pytest
from PIL import Image

from tso_cli.evaluation.metrics import chamfer
from tso_cli.io.cameras import read_cameras
from tso_cli.io.clouds import read_cloud
from tso_cli.io.images import read_mask

from .run import CHAIR, errors, tso


def depth_map():
    """[H, W] depths of the target's nearest points, each drawn 9 px wide; 0 where there is none."""
    camera = read_cameras(CHAIR / "camera.json")[0].camera
    (columns, rows), depth = (part.T for part in camera.project(read_cloud(CHAIR / "target.ply").points))
    nearest = np.full((camera.height, camera.width), np.inf)
    for by_row in range(-4, 5):
        for by_column in range(-4, 5):
            row, column = rows.round().astype(int) + by_row, columns.round().astype(int) + by_column
            inside = (row >= 0) & (row < camera.height) & (column >= 0) & (column < camera.width)
            np.minimum.at(nearest, (row[inside], column[inside]), depth[inside])
    return np.where(np.isfinite(nearest) & (read_mask(CHAIR / "mask.png") > 0.5), nearest, 0.0)


@pytest.fixture
def chair(tmp_path, monkeypatch):
    shutil.copytree(CHAIR, tmp_path / "chair")
    monkeypatch.chdir(tmp_path)
    Image.fromarray((1e4 * depth_map()).round().astype(np.uint16)).save("depth.png")
    return tmp_path


def run(*words):
    return tso("refine", "chair/initial.ply", "chair/mask.png", *words)


def test_a_depth_map_takes_off_a_quarter_more_than_the_mask_alone(chair, capsys):
    for name, words in {"mask": (), "depth": ("--depth", "depth.png", "--depth-scale", "0.0001")}.items():
        assert run("-o", f"{name}.ply", "--symmetry", "none", *words) == 0
    assert "depth-scale" not in capsys.readouterr().err
    target = read_cloud(CHAIR / "target.ply").points
    mask, depth = (chamfer(read_cloud(f"{name}.ply").points, target).chamfer for name in ("mask", "depth"))
    assert depth < 0.75 * mask


def test_a_depth_map_in_another_unit_is_warned_of(chair, capsys):
    assert run("--check", "--depth", "depth.png") == 0
    assert "is --depth-scale right?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--depth", "small.png"), "small.png: is 8x8, the mask chair/mask.png is 256x256"),
        (("--depth", "depth.png", "--depth", "depth.png"), "found 2 depth maps for 1 masks, expected one for each or none"),
        (("--depth", "chair/image.png"), "is a picture of mode RGB, expected a depth map of one grey channel"),
        (("--depth", "none.png"), "none.png: does not exist"),
        (("--depth-scale", "0.001"), "--depth-scale 0.001 says nothing without a depth map, expected --depth FILE"),
        (("--depth", "depth.png", "--preset", "paper"), "--depth is for --mode points --preset best"),
        (("--depth", "depth.png", "--camera", "fit"), "--depth needs a camera whose distance is known, found --camera fit"),
        (("--depth", "depth.png", "--mode", "latent"), "--depth is for --mode points --preset best"),
    ],
)
def test_a_depth_map_that_does_not_fit_gets_one_line_and_writes_nothing(chair, capsys, words, message):
    Image.fromarray(np.full((8, 8), 9, np.uint16)).save("small.png")
    assert run(*words) == 2
    (error,) = errors(capsys)
    assert message in error
    assert not (chair / "initial.refined.ply").exists()
