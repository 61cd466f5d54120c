"""Masks and a network to run commands with."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.scenes import turned
from tso_cli import __version__
from tso_cli.io.cameras import CameraRecord, read_camera, write_cameras
from tso_cli.io.clouds import read_cloud


@pytest.fixture
def views(folder):
    """views.json and the three masks that it names: the chair from three sides, in three sizes."""
    from tso_cli.losses.silhouette import silhouette_of

    camera, target = read_camera("camera.json", 256, 256), read_cloud("target.ply").points
    records = []
    for name, degrees, size in (
        ("front.png", 0.0, (64, 64)),
        ("side.png", 80.0, (96, 80)),
        ("back.png", 200.0, (128, 128)),
    ):
        around = turned(camera, degrees).resized(*size)
        Image.fromarray((silhouette_of(target, around) * 255.0).astype(np.uint8)).save(name)
        records.append(CameraRecord(around, Path(name)))
    write_cameras(Path("views.json"), records)
    return [record.mask for record in records]


def save_untrained(path, frame="view"):
    """A small network; untrained, which is enough to run the modes."""
    from tso_cli.io.checkpoints import save_network
    from tso_cli.network.model import NetworkConfig, build_network

    save_network(
        path,
        build_network(points=128, seed=0),
        NetworkConfig(points=128, frame=frame, version=__version__),
    )
    return path


@pytest.fixture(scope="session")
def checkpoint(tmp_path_factory):
    """A view-aligned network."""
    return save_untrained(tmp_path_factory.mktemp("checkpoint") / "small.safetensors")
