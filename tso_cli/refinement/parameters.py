"""What moves: the points of clouds, or the weights or the latent vector of the network that predicts one."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..errors import InputError
from ..geometry.points import as_points, bounding_box_normalisation
from .surface import Surface

if TYPE_CHECKING:
    from ..network.model import BaseNetwork

Array = NDArray[np.float64]


class Cloud:
    """A cloud in the units of its file, and its normalisation to longest side 1; or a mesh, of which samples move.

    Attributes
    ----------
    given : [V, 3] float64, what the cloud was made of.
    surface : that of a mesh, or None.
    initial : [N, 3] float64, what moves: the points given, or the samples of the surface.
    centre [3], scale : (X - centre) / scale is normalised.
    colours : [N, 3] float32 in [0, 1], or None.
    """

    def __init__(self, points: Any, name: str, colours: Any = None, faces: Any = None) -> None:
        if isinstance(points, Tensor):
            points = points.detach().cpu().numpy()
        if isinstance(faces, Tensor):
            faces = faces.detach().cpu().numpy()
        self.given: Array = as_points(points, name)
        self.surface = None if faces is None else Surface.of(self.given, faces, name)
        self.initial = self.surface.samples if self.surface else self.given
        self.centre, self.scale = bounding_box_normalisation(self.initial, name)
        self.colours = None if colours is None else _as_colours(colours, len(self.given), name)
        if self.surface and self.colours is not None:
            self.colours = self.surface.at(self.colours.astype(np.float64)).astype(np.float32)

    def normalised(self) -> Array:
        """[N, 3]."""
        normalised: Array = (self.initial - self.centre) / self.scale
        return normalised

    def carried(self, ways: Array) -> Carried:
        """What comes of the points given where what moves goes ``ways`` [N or more, 3], in units of the longest side."""
        ways = ways[: len(self.initial)]
        followed = ways
        if self.surface:
            followed = self.surface.followed(ways)
            ways = self.surface.at(followed)
        # What did not move keeps every bit of the input.
        points = self.given + self.scale * followed
        return Carried(points, self._judged(points), ways)

    @property
    def judged(self) -> Array:
        """[S, 3], what stands for it where it is judged: the points, or many drawn from the surface."""
        return self._judged(self.given)

    def _judged(self, points: Array) -> Array:
        return self.surface.drawn(points) if self.surface else points


@dataclass(frozen=True, eq=False)
class Carried:
    """The end of a cloud's way.

    Attributes
    ----------
    points : [V, 3] the points given, moved.
    judged : [S, 3] what stands for it where it is judged, as `Cloud.judged`.
    ways : [N, 3] how far, in units of the longest side.
    """

    points: Array
    judged: Array
    ways: Array


def _as_colours(colours: Any, count: int, name: str) -> NDArray[np.float32]:
    if isinstance(colours, Tensor):
        colours = colours.detach().cpu().numpy()
    try:
        array = np.asarray(colours)
        found: NDArray[np.float32] = array.astype(np.float32)
    except (TypeError, ValueError):
        raise InputError(f"{name}: the colours are no array of numbers, expected [{count}, 3]") from None
    if found.shape != (count, 3):
        raise InputError(f"{name}: the colours have shape {list(found.shape)}, expected [{count}, 3]")
    if array.dtype == np.uint8:
        found = found / np.float32(255.0)
    if not (found.min() >= 0.0 and found.max() <= 1.0):
        raise InputError(f"{name}: the colours span {found.min():g} to {found.max():g}, expected 0 to 1, or uint8")
    return found


class PointParameters:
    """The points of B clouds move.

    Attributes
    ----------
    parameters : one tensor [B, N, 3], N the size of the largest cloud; what lies behind a smaller one is 0.
    counts : [B] sizes of the clouds.
    """

    def __init__(self, clouds: Sequence[Cloud], device: torch.device) -> None:
        self.counts = torch.tensor([len(cloud.initial) for cloud in clouds])
        padded = np.zeros((len(clouds), int(self.counts.max()), 3), np.float32)
        for row, cloud in zip(padded, clouds, strict=True):
            row[: len(cloud.initial)] = cloud.normalised()
        self.parameters = [torch.tensor(padded, device=device, requires_grad=True)]

    def forward(self) -> Tensor:
        """The clouds [B, N, 3] as they are now."""
        return self.parameters[0]


class NetworkParameters:
    """A copy of the network moves, or the latent vector between its halves, and with it the cloud it predicts from the image.

    Attributes
    ----------
    cloud : the prediction.
    parameters : what ``mode`` moves: weights, or one tensor [1, 128]. counts : [1].
    """

    def __init__(self, network: BaseNetwork | None, image: Any, mode: str, device: torch.device) -> None:
        if network is None or image is None:
            raise InputError(f"mode {mode} needs a network and an image")
        network = copy.deepcopy(network).float().to(device).eval().requires_grad_(False)
        given = torch.as_tensor(image, dtype=torch.float32, device=device).unsqueeze(0)
        self._predict: nn.Module = network
        if mode == "latent":
            # The picture is looked at once: a step is then the decoder alone.
            given = network.encoder(given).requires_grad_()
            self._predict = network.decoder
            self.parameters: list[Tensor] = [given]
        else:
            moving = network.encoder if mode == "encoder" else network
            self.parameters = list(moving.requires_grad_(True).parameters())
        self._given = given
        with torch.no_grad():
            predicted = self._predict(given)[0]
        self.cloud = Cloud(predicted, "the network's prediction")
        self.counts = torch.tensor([len(self.cloud.initial)])
        self._centre = torch.as_tensor(self.cloud.centre, dtype=torch.float32, device=device)

    def forward(self) -> Tensor:
        """The cloud [1, N, 3] that the network predicts now, normalised as it was at the start."""
        cloud: Tensor = (self._predict(self._given) - self._centre) / self.cloud.scale
        return cloud
