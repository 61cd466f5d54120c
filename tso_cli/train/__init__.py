"""Training the network that predicts a cloud from a photo."""

from __future__ import annotations

from .config import TrainConfig
from .loop import TrainResult, evaluate, network_config, start, train

__all__ = ["TrainConfig", "TrainResult", "evaluate", "network_config", "start", "train"]
