"""What the tests of training share: data in memory and on disk, and `tso train` in this process."""

import numpy as np
import pytest

from tso_cli.datasets.rendered import writing
from tso_cli.train.data import TrainingData

from ..training import make_objects, make_thin


@pytest.fixture
def thin(monkeypatch):
    make_thin(monkeypatch)


@pytest.fixture(scope="module")
def data():
    return TrainingData(make_objects(), "three boxes")


def write(folder, item):
    """An object as `tso render` would have written it."""
    pictures = [(*view.load(), view.camera) for view in item.views]
    views = [(image, (mask * 255).astype(np.uint8), camera) for image, mask, camera in pictures]
    with writing(folder) as writer:
        writer.write(item.name, views, item.target(), item.target(), {"seed": 0})


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "boxes").mkdir()
    for item in make_objects(2):
        write(tmp_path / "boxes", item)
    return tmp_path / "boxes"


@pytest.fixture
def tso_train(thin, tmp_path, tso):
    """`tso train` on a data set for two short steps; of an option given twice the last counts."""
    common = ("-o", tmp_path / "base.safetensors", "--steps", 2, "--batch-size", 2, "--points", 32)
    return lambda data, *options: tso("train", data, *common, *options)
