"""`tso refine --depth` on a shipped example, with a depth map made of its target."""

import numpy as np
import pytest
from PIL import Image

from tso_cli.evaluation.metrics import chamfer
from tso_cli.io.clouds import read_cloud


@pytest.fixture
def depth_map(folder, chair):
    """depth.png: depths of the target's nearest points, each drawn 9 px wide; 0 where there is none."""
    _, mask, camera, target = chair
    (columns, rows), depth = (part.T for part in camera.project(target))
    nearest = np.full(mask.shape, np.inf)
    for by_row, by_column in np.ndindex(9, 9):
        row, column = rows.round().astype(int) + by_row - 4, columns.round().astype(int) + by_column - 4
        inside = (row >= 0) & (row < camera.height) & (column >= 0) & (column < camera.width)
        np.minimum.at(nearest, (row[inside], column[inside]), depth[inside])
    depth = np.where(np.isfinite(nearest) & (mask > 0.5), nearest, 0.0)
    Image.fromarray((1e4 * depth).round().astype(np.uint16)).save("depth.png")


def test_a_depth_map_takes_off_a_quarter_more_than_the_mask_alone(depth_map, chair, refine):
    for name, words in {"mask": (), "depth": ("--depth", "depth.png", "--depth-scale", "0.0001")}.items():
        assert "depth-scale" not in refine("initial.ply", "mask.png", "-o", f"{name}.ply", "--symmetry", "none", *words).err
    mask, depth = (chamfer(read_cloud(f"{name}.ply").points, chair.target).chamfer for name in ("mask", "depth"))
    assert depth < 0.75 * mask


def test_a_depth_map_in_another_unit_is_warned_of(depth_map, refine):
    assert "is --depth-scale right?" in refine("initial.ply", "mask.png", "--check", "--depth", "depth.png").err
