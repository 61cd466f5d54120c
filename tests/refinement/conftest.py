"""The shipped examples."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from tso_cli.geometry.camera import Camera
from tso_cli.geometry.view import View
from tso_cli.io.cameras import read_camera
from tso_cli.io.clouds import read_cloud
from tso_cli.io.images import read_mask

EXAMPLES = Path(__file__).parents[2] / "examples"


class Example(NamedTuple):
    points: np.ndarray
    mask: np.ndarray
    camera: Camera
    target: np.ndarray

    @property
    def view(self) -> View:
        return View(self.mask, self.camera, name="mask.png")


def example(name: str) -> Example:
    """Start, mask, camera and true cloud of a shipped example."""
    folder = EXAMPLES / name
    mask = read_mask(folder / "mask.png")
    camera = read_camera(folder / "camera.json", mask.shape[1], mask.shape[0])
    return Example(read_cloud(folder / "initial.ply").points, mask, camera, read_cloud(folder / "target.ply").points)


@pytest.fixture(scope="session")
def chair() -> Example:
    return example("chair")
