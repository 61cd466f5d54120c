"""A split of shipped shapes, and material that is rendered once."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path

import pytest

from tso_cli.lab.studies import judging, network

from ..training import make_thin
from .studying import write_split

TRAIN = [
    *(
        "car/qreal_SUV",
        "car/qbasic_BasicCar",
        "car/qreal_NormalCar1",
        "chair/q19_Chair",
        "chair/q17_Chair",
    ),
    *("airplane/qplane_SmallPlane", "airplane/qplane_Private_plane"),
]
VALIDATION = ["car/qreal_Cop", "car/qpublic_Taxi", "chair/kfurn_chair"]
TEST = ["airplane/qplane_Military_Airplane", "car/qbasic_RaceCar", "chair/kfurn_chairRounded"]
see, mean_shape = cache(judging.see), judging.mean_shape


@pytest.fixture(scope="session")
def split(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_split(
        tmp_path_factory.mktemp("split"), train=TRAIN, validation=VALIDATION, test=TEST
    )


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thin networks; few and small pictures, rendered once; a mean shape of few steps."""
    make_thin(monkeypatch)
    for name, value in (("TRAINING_VIEWS", 8), ("TEST_VIEWS", 5), ("SIZE", 32), ("see", see)):
        monkeypatch.setattr(judging, name, value)
    for module in (judging, network):
        monkeypatch.setattr(module, "mean_shape", partial(mean_shape, steps=30))
