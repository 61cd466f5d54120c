"""The base network, which predicts a cloud from a photo.

Tables 1 and 2 of the paper's supplement list its layers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn

from ..option import opt
from . import Background, Frame, Supervision

LATENT = 128
IMAGE_SIZE = 64
# (output channels, filter size, stride) of each layer. An image of 64x64 shrinks to 4x4.
CONVOLUTIONS = (
    (32, 3, 1), (32, 3, 1), (64, 3, 2), (64, 3, 1), (64, 3, 1), (128, 3, 2),
    (128, 3, 1), (128, 3, 1), (256, 3, 2), (256, 3, 1), (256, 3, 1), (512, 5, 2),
)  # fmt: skip


@dataclass(frozen=True)
class NetworkConfig:
    """What a checkpoint says about its network.

    points : N, size of the predicted cloud.
    image_size : side of the input image in pixels; always 64.
    frame : "view" (x right, y up, z toward the viewer) or "canonical" (the frame of the objects).
    sigma_sq : variance of the projection kernel, px^2 of a 64x64 mask.
    crop_share, background : arguments of `network_input`. With a share of 0, clouds have the scale
        of the training set instead of longest side 1.
    supervision : "points" (3D, PSGN-FC), "masks" (2D) or "joint".
    training_set, seed, steps, settings : of the training.
    version : of tso.
    """

    points: int = opt(1024, least=1, most=1_000_000)  # a larger number can only be damage
    image_size: int = opt(IMAGE_SIZE, least=IMAGE_SIZE, most=IMAGE_SIZE)
    frame: Frame = opt("view")
    sigma_sq: float = opt(0.4, above=0.0, most=1e6)
    crop_share: float = opt(0.9, least=0.0, most=1.0)
    background: Background = opt("black")
    training_set: str = opt("")
    supervision: Supervision = opt("points")
    seed: int = opt(0)
    steps: int = opt(0, least=0)
    version: str = opt("")
    settings: dict[str, Any] = field(default_factory=dict)


class Encoder(nn.Module):
    """Image [B, 3, 64, 64] -> latent vector [B, 128]."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        channels = 3
        for outputs, size, stride in CONVOLUTIONS:
            layers += [nn.Conv2d(channels, outputs, size, stride, padding=size // 2), nn.ReLU()]
            channels = outputs
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
            nn.Linear(LATENT, 256),
            nn.ReLU(),
            nn.Linear(256, 256),
            nn.ReLU(),
            nn.Linear(256, points * 3),
        )

    def forward(self, latent: Tensor) -> Tensor:
        return torch.tanh(self.layers(latent)).view(-1, self.points, 3)


class BaseNetwork(nn.Module):
    """Encoder and decoder: images [B, 3, 64, 64] in [0, 1] -> points [B, N, 3] in [-1, 1]^3."""

    def __init__(self, encoder: Encoder, decoder: Decoder) -> None:
        super().__init__()
        self.encoder = encoder
        self.decoder = decoder

    def forward(self, images: Tensor) -> Tensor:
        return self.decoder(self.encoder(images))


def build_network(points: int = 1024, seed: int = 0) -> BaseNetwork:
    """A new network with He initialisation from ``seed`` alone.

    The global random state of torch is neither read nor changed. Weights have variance 2 / fan-in
    before a ReLU and 1 / fan-in in other layers; biases are 0. Torch's default has a sixth of this
    variance. It shrinks the gradient by 2.4 in each layer: the first convolution gets 1e-5 of the
    gradient of the last layer, and outputs differ by 2e-7 between images. This is too little to
    start training at a rate of 5e-5.
    """
    # On the device "meta" torch draws no weights from the global generator.
    with torch.device("meta"):
        network = BaseNetwork(Encoder(), Decoder(points))
    network = network.to_empty(device="cpu")
    generator = torch.Generator().manual_seed(seed)
    before_no_relu = (network.encoder.latent, network.decoder.layers[-1])
    with torch.no_grad():
        for module in network.modules():
            if isinstance(module, (nn.Conv2d, nn.Linear)):
                gain = 1.0 if module in before_no_relu else math.sqrt(2.0)
                module.weight.normal_(
                    0.0, gain / math.sqrt(module.weight[0].numel()), generator=generator
                )
                if module.bias is not None:
                    module.bias.zero_()
    return network
