"""The base network: a photo in, a cloud out. Layers as in tables 1 and 2 of the paper's supplement."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn

LATENT = 128
IMAGE_SIZE = 64
FRAMES = ("view", "canonical")
SUPERVISIONS = ("points", "masks", "joint")
# (output channels, filter size, stride) of the twelve convolutions; 64x64 shrinks to 4x4.
CONVOLUTIONS = (
    (32, 3, 1),
    (32, 3, 1),
    (64, 3, 2),
    (64, 3, 1),
    (64, 3, 1),
    (128, 3, 2),
    (128, 3, 1),
    (128, 3, 1),
    (256, 3, 2),
    (256, 3, 1),
    (256, 3, 1),
    (512, 5, 2),
)


@dataclass(frozen=True)
class NetworkConfig:
    """What must be known to use a trained network; it travels inside the checkpoint.

    Parameters
    ----------
    points : N, size of the predicted cloud.
    image_size : side of the input image in pixels; always 64.
    frame : "view" (x right, y up, z toward the viewer) or "canonical" (the frame of the objects).
    sigma_sq : variance of the projection kernel, px^2 of a 64x64 mask (sigma^2).
    crop_share : share of the input's side that the object's box takes up; 0: the input keeps its size, and clouds are in the
        scale of the training set instead of longest side 1 (see `network_input`).
    background : "black", "white" or "keep".
    training_set : what it was trained on, in words.
    supervision : "points" (3D, PSGN-FC), "masks" (2D) or "joint".
    seed, steps : of the training run.
    version : of tso.
    settings : every other setting of the training run.
    """

    points: int = 1024
    image_size: int = IMAGE_SIZE
    frame: str = "view"
    sigma_sq: float = 0.4
    crop_share: float = 0.9
    background: str = "black"
    training_set: str = ""
    supervision: str = "points"
    seed: int = 0
    steps: int = 0
    version: str = ""
    settings: dict[str, Any] = field(default_factory=dict)


class Encoder(nn.Module):
    """Image [B, 3, 64, 64] -> latent vector [B, 128]."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        channels = 3
        for out, size, stride in CONVOLUTIONS:
            layers += [nn.Conv2d(channels, out, size, stride, padding=size // 2), nn.ReLU()]
            channels = out
        self.convolutions = nn.Sequential(*layers)
        self.latent = nn.Linear(channels * 4 * 4, LATENT)

    def forward(self, images: Tensor) -> Tensor:
        return self.latent(self.convolutions(images).flatten(1))


class Decoder(nn.Module):
    """Latent vector [B, 128] -> points [B, N, 3], each coordinate in (-1, 1)."""

    def __init__(self, points: int = 1024) -> None:
        super().__init__()
        self.points = points
        self.layers = nn.Sequential(
            nn.Linear(LATENT, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, points * 3)
        )

    def forward(self, latent: Tensor) -> Tensor:
        return torch.tanh(self.layers(latent)).view(-1, self.points, 3)


class BaseNetwork(nn.Module):
    """Encoder and decoder: images [B, 3, 64, 64] float in [0, 1] -> points [B, N, 3] in a cube of side 2."""

    def __init__(self, encoder: Encoder, decoder: Decoder) -> None:
        super().__init__()
        self.encoder = encoder
        self.decoder = decoder

    def forward(self, images: Tensor) -> Tensor:
        return self.decoder(self.encoder(images))


def build_network(points: int = 1024, seed: int = 0) -> BaseNetwork:
    """A new network, initialised from ``seed`` alone (the global random state is neither read nor changed)."""
    # Built without memory first, so that torch does not draw weights from its global generator.
    with torch.device("meta"):
        network = BaseNetwork(Encoder(), Decoder(points))
    network = network.to_empty(device="cpu")
    initialise(network, torch.Generator().manual_seed(seed))
    return network


def initialise(network: BaseNetwork, generator: torch.Generator) -> None:
    """He initialisation: weights of variance 2 / fan-in before a ReLU, 1 / fan-in elsewhere, biases zero.

    torch's own default has a sixth of that variance, so each of the fifteen layers would shrink the signal, and on the
    way back the gradient, by 2.4: measured, the first convolution's gradient is 100,000 times smaller than the last
    layer's and the output differs by 2e-7 from one image to the next, so that training at a rate of 5e-5 starts blind.
    """
    linear_output = (network.encoder.latent, network.decoder.layers[-1])
    with torch.no_grad():
        for module in network.modules():
            if isinstance(module, (nn.Conv2d, nn.Linear)):
                fan_in = module.weight[0].numel()
                gain = 1.0 if module in linear_output else math.sqrt(2.0)
                module.weight.normal_(0.0, gain / math.sqrt(fan_in), generator=generator)
                if module.bias is not None:
                    module.bias.zero_()
