"""What tests of studies share: the shipped shapes as a split, small networks and material."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tso_cli.io.checkpoints import save_network
from tso_cli.network import model as networks
from tso_cli.network.model import NetworkConfig, build_network
from tso_lab.studies.material import Material

from ..training import make_thin

MESHES = Path(__file__).parents[2] / "examples" / "meshes"
TRAIN = ["car/qreal_SUV", "car/qbasic_BasicCar", "car/qreal_NormalCar1", "chair/q19_Chair"]
TRAIN += ["chair/q17_Chair", "airplane/qplane_SmallPlane", "airplane/qplane_Private_plane"]
VALIDATION = ["car/qreal_Cop", "car/qpublic_Taxi", "chair/kfurn_chair"]
TEST = ["airplane/qplane_Military_Airplane", "car/qbasic_RaceCar", "chair/kfurn_chairRounded"]
SMALL = partial(Material, views=(8, 5), size=32, mean_steps=30)
"""Few and small pictures, a mean shape of few steps."""


def write_split(folder: Path, **parts: list[str]) -> Path:
    """A split file of the shipped shapes."""
    path = folder / "split.json"
    path.write_text(json.dumps(parts))
    return path


def thin_checkpoint(
    folder: Path, monkeypatch: pytest.MonkeyPatch, points: int, **settings: object
) -> Path:
    """A network of the paper's layers with few channels, untrained."""
    make_thin(monkeypatch)
    monkeypatch.setattr(networks, "LATENT", 8)
    path = folder / "thin.safetensors"
    config = NetworkConfig(points=points, **settings)  # type: ignore[arg-type]
    save_network(path, build_network(points, seed=0), config, overwrite=True)
    return path


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def holding(record: dict) -> list[bool]:
    return [claim["holds"] for claim in record["claims"]]


def timeless(value: Any) -> Any:
    """Without what a clock decides."""
    if isinstance(value, dict):
        return {key: timeless(item) for key, item in value.items() if "seconds" not in key}
    return [timeless(item) for item in value] if isinstance(value, list) else value
