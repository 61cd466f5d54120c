"""Training the network that predicts a cloud from a photo."""

from .config import TrainConfig
from .loop import TrainResult, evaluate, network_config, start, train
