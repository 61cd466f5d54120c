"""`tso refine --depth` on a shipped example, with a depth map made of its target."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tso_cli.cli import main
from tso_cli.evaluation.metrics import chamfer
from tso_cli.io.cameras import read_cameras
from tso_cli.io.clouds import read_cloud
from tso_cli.io.images import read_mask

CHAIR = Path(__file__).parents[2] / "examples" / "chair"


def depth_map() -> np.ndarray:
    """[H, W] depths of the target's nearest points, each drawn 9 px wide; 0 where there is none."""
    camera = read_cameras(CHAIR / "camera.json")[0].camera
    (columns, rows), depth = (part.T for part in camera.project(read_cloud(CHAIR / "target.ply").points))
    found = np.full((camera.height, camera.width), np.inf)
    for by_row in range(-4, 5):
        for by_column in range(-4, 5):
            row, column = rows.round().astype(int) + by_row, columns.round().astype(int) + by_column
            kept = (row >= 0) & (row < camera.height) & (column >= 0) & (column < camera.width)
            np.minimum.at(found, (row[kept], column[kept]), depth[kept])
    return np.where(np.isfinite(found) & (read_mask(CHAIR / "mask.png") > 0.5), found, 0.0)


@pytest.fixture
def chair(tmp_path, monkeypatch):
    shutil.copytree(CHAIR, tmp_path / "chair")
    monkeypatch.chdir(tmp_path)
    Image.fromarray((1e4 * depth_map()).round().astype(np.uint16)).save("depth.png")
    return tmp_path


def run(*words: str) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(["refine", "chair/initial.ply", "chair/mask.png", *words])
    return stopped.value.code


def test_a_depth_map_takes_off_a_quarter_more_than_the_mask_alone(chair, capsys):
    common = ("--symmetry", "none", "--json")
    assert run("-o", "mask.ply", *common) == 0
    assert run("-o", "depth.ply", "--depth", "depth.png", "--depth-scale", "0.0001", *common) == 0
    np.save("depth.npy", depth_map())
    assert run("-o", "array.ply", "--depth", "depth.npy", *common) == 0
    out = capsys.readouterr()
    assert "depth-scale" not in out.err
    assert out.out.count('"version"') == 3
    json.loads(out.out.split("\n}\n")[0] + "\n}")
    target = read_cloud(CHAIR / "target.ply").points
    mask, depth, array = (chamfer(read_cloud(f"{name}.ply").points, target).chamfer for name in ("mask", "depth", "array"))
    assert depth < 0.75 * mask
    assert array == pytest.approx(depth, rel=0.05)


def test_a_depth_map_in_another_unit_is_warned_of(chair, capsys):
    assert run("--check", "--depth", "depth.png") == 0
    assert "is --depth-scale right?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
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
def test_a_depth_map_that_does_not_fit_gets_one_line_and_writes_nothing(chair, capsys, words, said):
    Image.fromarray(np.full((8, 8), 9, np.uint16)).save("small.png")
    assert run(*words) == 2
    err = [line for line in capsys.readouterr().err.splitlines() if "warning" not in line]
    assert len(err) == 1
    assert said in err[0]
    assert not (chair / "initial.refined.ply").exists()
