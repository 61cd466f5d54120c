"""What moves a prediction: the network's weights, or the vector between its halves (torch)."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim.adam import adam

from .. import device as devices
from ..cloud.cloud import Cloud, ControlledCloud
from ..errors import InputError
from ..geometry.arrays import Array
from ..network.model import BaseNetwork


class NetworkParameters:
    """Weights of a copy of the network, or the latent vector between its halves, moved by Adam.

    Attributes
    ----------
    cloud : the prediction.
    """

    def __init__(
        self, network: BaseNetwork | None, image: Any, mode: str, device: str, learning_rate: float
    ) -> None:
        if network is None or image is None:
            raise InputError(f"mode {mode} needs a network and an image")
        self.device = devices.resolve(device)
        network = copy.deepcopy(network).float().to(self.device).eval().requires_grad_(False)
        self._input = torch.as_tensor(image, dtype=torch.float32, device=self.device).unsqueeze(0)
        self._predict: nn.Module = network
        if mode == "latent":
            # The encoder runs once; a step is then the decoder alone.
            self._input = network.encoder(self._input).requires_grad_()
            self._predict = network.decoder
            trained = [self._input]
        else:
            part = network.encoder if mode == "encoder" else network
            trained = list(part.requires_grad_(True).parameters())
        self._optimiser = TorchAdam(trained, learning_rate)
        with torch.no_grad():
            prediction = self._predict(self._input)[0]
        cloud = Cloud(prediction, "the network's prediction", predicted=True)
        self.cloud: ControlledCloud = cloud.controlled()

    def points(self) -> Array:
        """The predicted cloud [N, 3], normalised as it was at the start."""
        self._prediction = self._predict(self._input)[0]
        prediction: Array = self._prediction.detach().cpu().numpy().astype(np.float64)
        return self.cloud.normalise(prediction)

    def step(self, gradient: Array) -> None:
        """One step of the trained numbers, by the gradient [N, 3] at the last `points`."""
        prediction = self._prediction
        by_prediction = torch.as_tensor(gradient / self.cloud.scale).to(prediction)
        trained = self._optimiser.parameters
        self._optimiser.apply(torch.autograd.grad(prediction, trained, by_prediction))


class TorchAdam:
    """Adam with torch's defaults: betas (0.9, 0.999), eps 1e-8.

    The first ``torch.optim.Optimizer`` imports torch's compiler, which takes 0.9 s. The function
    underneath does not. Its fused form is two to five times faster, and equal up to rounding.
    """

    def __init__(self, parameters: list[Tensor], learning_rate: float) -> None:
        self.parameters = parameters
        self._learning_rate = learning_rate
        self._means = [torch.zeros_like(p) for p in parameters]
        self._squares = [torch.zeros_like(p) for p in parameters]
        # Other devices lack the fused form in some supported releases of torch.
        self._fused = all(p.device.type in ("cpu", "cuda") for p in parameters)
        self._steps = [
            torch.zeros((), device=p.device if self._fused else "cpu") for p in parameters
        ]

    @torch.no_grad()
    def apply(self, grads: Sequence[Tensor]) -> None:
        """One step, given the gradient by each parameter."""
        grads = [_laid_out_as(p, grad) for p, grad in zip(self.parameters, grads, strict=True)]
        settings: dict[str, Any] = dict(
            amsgrad=False, beta1=0.9, beta2=0.999, weight_decay=0.0, eps=1e-8, maximize=False
        )
        moments = self._means, self._squares
        adam(
            self.parameters,
            grads,
            *moments,
            [],
            self._steps,
            fused=self._fused,
            lr=self._learning_rate,
            **settings,
        )


def _laid_out_as(parameter: Tensor, grad: Tensor) -> Tensor:
    """``grad`` with the strides of the parameter.

    The fused form would misread a gradient that autograd expanded or transposed.
    """
    return grad if grad.stride() == parameter.stride() else torch.empty_like(parameter).copy_(grad)
