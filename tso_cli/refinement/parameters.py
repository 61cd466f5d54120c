"""What the optimiser moves: points, or a network's weights or latent vector."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import InputError
from ..network.model import BaseNetwork
from .cloud import Cloud


class PointParameters:
    """The points of B clouds.

    Attributes
    ----------
    parameters : one tensor [B, N, 3], N the size of the largest cloud; smaller ones are padded with 0.
    counts : [B] sizes of the clouds.
    """

    def __init__(self, clouds: Sequence[Cloud], device: torch.device) -> None:
        self.counts = torch.tensor([len(cloud.initial) for cloud in clouds])
        padded = np.zeros((len(clouds), int(self.counts.max()), 3), np.float32)
        for row, cloud in zip(padded, clouds, strict=True):
            row[: len(cloud.initial)] = cloud.normalised()
        self.parameters = [torch.tensor(padded, device=device, requires_grad=True)]

    def forward(self) -> Tensor:
        return self.parameters[0]


class NetworkParameters:
    """Weights of a copy of the network, or the latent vector between its halves.

    Attributes
    ----------
    cloud : the prediction. counts : [1], its size.
    parameters : the weights that ``mode`` names, or one tensor [1, 128].
    """

    def __init__(self, network: BaseNetwork | None, image: Any, mode: str, device: torch.device) -> None:
        if network is None or image is None:
            raise InputError(f"mode {mode} needs a network and an image")
        network = copy.deepcopy(network).float().to(device).eval().requires_grad_(False)
        self._input = torch.as_tensor(image, dtype=torch.float32, device=device).unsqueeze(0)
        self._predict: nn.Module = network
        if mode == "latent":
            # The encoder runs once; a step is then the decoder alone.
            self._input = network.encoder(self._input).requires_grad_()
            self._predict = network.decoder
            self.parameters: list[Tensor] = [self._input]
        else:
            moving = network.encoder if mode == "encoder" else network
            self.parameters = list(moving.requires_grad_(True).parameters())
        with torch.no_grad():
            prediction = self._predict(self._input)[0]
        self.cloud = Cloud(prediction, "the network's prediction")
        self.counts = torch.tensor([len(self.cloud.initial)])
        self._centre = torch.as_tensor(self.cloud.centre, dtype=torch.float32, device=device)

    def forward(self) -> Tensor:
        """The predicted cloud [1, N, 3], normalised as it was at the start."""
        cloud: Tensor = (self._predict(self._input) - self._centre) / self.cloud.scale
        return cloud
