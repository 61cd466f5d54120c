"""What tests of studies share: the shipped shapes as a split, a small network, and the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tso_cli.io.checkpoints import save_network
from tso_cli.network import model as networks
from tso_cli.network.model import NetworkConfig, build_network

from ..training import make_thin

MESHES = Path(__file__).parents[2] / "examples" / "meshes"


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


def holding(claims: list[dict]) -> list[bool]:
    return [claim["holds"] for claim in claims]


def timeless(value: Any) -> Any:
    """Without what a clock decides."""
    if isinstance(value, dict):
        return {key: timeless(item) for key, item in value.items() if "seconds" not in key}
    return [timeless(item) for item in value] if isinstance(value, list) else value
