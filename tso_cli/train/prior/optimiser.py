"""The optimiser of a prior: Muon for the matrices, AdamW for all other weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from ...errors import TsoError
from ...prior.network import OUTPUTS

# Learning rates at their highest. Muon makes all directions of a step equally long; its rate is in
# the unit of AdamW's (Liu et al., 2025, "Muon is scalable for LLM training").
MATRIX_RATE, OTHER_RATE = 0.006, 1.2e-3
WEIGHT_DECAY = 0.02
LONGEST_GRADIENT = 1.0  # a longer gradient is shortened to this length
# Weights of the first and the last layers are no maps between hidden features: AdamW suits them.
NO_MATRICES = ("map1", *OUTPUTS)
MUON_SINCE = (2, 9)  # versions of torch


class Optimiser:
    """Steps of ``weights``, which are changed in place."""

    def __init__(self, weights: Mapping[str, Tensor]) -> None:
        if not hasattr(torch.optim, "Muon"):
            raise TsoError(
                f"the installed torch is {torch.__version__}, expected "
                f"{'.'.join(map(str, MUON_SINCE))} or later to train a prior"
            )
        self._weights = weights
        # Kernels of convolutions as matrices that share their memory.
        self._matrices = {
            name: weight.detach().flatten(1).requires_grad_()
            for name, weight in weights.items()
            if weight.ndim > 1 and name not in NO_MATRICES
        }
        self._others = {
            name: weight.detach().requires_grad_()
            for name, weight in weights.items()
            if name not in self._matrices
        }
        self._muon = torch.optim.Muon(
            self._matrices.values(),
            lr=MATRIX_RATE,
            weight_decay=WEIGHT_DECAY,
            adjust_lr_fn="match_rms_adamw",
        )
        self._adam = torch.optim.AdamW(
            self._others.values(), lr=OTHER_RATE, weight_decay=WEIGHT_DECAY, fused=True
        )

    def step(self, gradients: Sequence[Tensor], rate: float) -> None:
        """One step along ``gradients`` of the weights; ``rate`` is a share of the highest rates."""
        for name, gradient in zip(self._weights, gradients, strict=True):
            if name in self._matrices:
                self._matrices[name].grad = gradient.flatten(1)
            else:
                self._others[name].grad = gradient
        every = [*self._matrices.values(), *self._others.values()]
        torch.nn.utils.clip_grad_norm_(every, LONGEST_GRADIENT)
        for optimiser, highest in ((self._muon, MATRIX_RATE), (self._adam, OTHER_RATE)):
            for group in optimiser.param_groups:
                group["lr"] = highest * rate
            optimiser.step()

    def state(self, steps: int) -> dict[str, Tensor]:
        """KIND.NAME -> what the optimiser remembers of a weight; zeros before the first step."""
        tensors = {}
        for name, matrix in self._matrices.items():
            kept = self._muon.state[matrix].get("momentum_buffer") if steps else None
            kept = torch.zeros_like(matrix) if kept is None else kept
            tensors[f"momentum.{name}"] = kept.reshape(self._weights[name].shape)
        for name, weight in self._others.items():
            for kind in ("exp_avg", "exp_avg_sq"):
                kept = self._adam.state[weight].get(kind) if steps else None
                tensors[f"{kind}.{name}"] = torch.zeros_like(weight) if kept is None else kept
        return tensors

    def restore(self, tensors: Mapping[str, Tensor], steps: int) -> None:
        """Go on after ``steps`` steps; ``tensors`` by the names of `state`."""
        for name, matrix in self._matrices.items():
            kept = tensors[f"momentum.{name}"].to(matrix).reshape(matrix.shape).clone()
            self._muon.state[matrix] = {"momentum_buffer": kept}
        for name, weight in self._others.items():
            kinds = ("exp_avg", "exp_avg_sq")
            self._adam.state[weight] = {
                "step": torch.tensor(float(steps), device=weight.device),
                **{kind: tensors[f"{kind}.{name}"].to(weight).clone() for kind in kinds},
            }
