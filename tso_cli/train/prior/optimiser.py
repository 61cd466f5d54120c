"""The optimiser of a prior: Muon for the matrices, AdamW for all other weights."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from ...device import has_bfloat16
from ...prior.network import OUTPUTS

# Learning rates at their highest. Muon makes all directions of a step equally long; its rate is in
# the unit of AdamW's (Liu et al., 2025, "Muon is scalable for LLM training").
MATRIX_RATE, OTHER_RATE = 0.006, 1.2e-3
WEIGHT_DECAY, MOMENTUM = 0.02, 0.95
LONGEST_GRADIENT = 1.0  # a longer gradient is shortened to this length
# Weights of the first and the last layers are no maps between hidden features: AdamW suits them.
NO_MATRICES = ("map1", *OUTPUTS)
# Coefficients and steps of Newton and Schulz's iteration (Jordan, 2024, "Muon").
CUBIC, STEPS = (3.4445, -4.7750, 2.0315), 5


class Optimiser:
    """Steps of ``weights``, which are changed in place."""

    def __init__(self, weights: Mapping[str, Tensor]) -> None:
        self._weights = weights
        fast = all(has_bfloat16(weight.device) for weight in weights.values())
        self._dtype = torch.bfloat16 if fast else torch.float32
        # Kernels of convolutions as matrices that share their memory.
        self._matrices = {
            name: weight.detach().flatten(1)
            for name, weight in weights.items()
            if weight.ndim > 1 and name not in NO_MATRICES
        }
        self._momenta = {name: torch.zeros_like(m) for name, m in self._matrices.items()}
        self._others = {
            name: weight.detach().requires_grad_()
            for name, weight in weights.items()
            if name not in self._matrices
        }
        self._adam = torch.optim.AdamW(
            self._others.values(), lr=OTHER_RATE, weight_decay=WEIGHT_DECAY, fused=True
        )

    @torch.no_grad()
    def step(self, gradients: Sequence[Tensor], rate: float) -> None:
        """One step along ``gradients`` of the weights; ``rate`` is a share of the highest rates."""
        of_weight = dict(zip(self._weights, gradients, strict=True))
        names = [*self._matrices, *self._others]
        norm = torch.nn.utils.get_total_norm([of_weight[name] for name in names])
        shorter = (LONGEST_GRADIENT / (norm + 1e-6)).clamp(max=1.0)
        for name, matrix in self._matrices.items():
            gradient, momentum = of_weight[name].flatten(1) * shorter, self._momenta[name]
            momentum.lerp_(gradient, 1 - MOMENTUM)
            update = orthogonal(gradient.lerp(momentum, MOMENTUM), self._dtype)
            matrix.mul_(1 - MATRIX_RATE * rate * WEIGHT_DECAY)
            matrix.add_(update, alpha=-MATRIX_RATE * rate * 0.2 * math.sqrt(max(matrix.shape)))
        for name, weight in self._others.items():
            weight.grad = of_weight[name] * shorter
        self._adam.param_groups[0]["lr"] = OTHER_RATE * rate
        self._adam.step()

    def state(self, steps: int) -> dict[str, Tensor]:
        """KIND.NAME -> what the optimiser remembers of a weight; zeros before the first step."""
        tensors = {
            f"momentum.{name}": momentum.reshape(self._weights[name].shape)
            for name, momentum in self._momenta.items()
        }
        for name, weight in self._others.items():
            for kind in ("exp_avg", "exp_avg_sq"):
                kept = self._adam.state[weight].get(kind) if steps else None
                tensors[f"{kind}.{name}"] = torch.zeros_like(weight) if kept is None else kept
        return tensors

    def restore(self, tensors: Mapping[str, Tensor], steps: int) -> None:
        """Go on after ``steps`` steps; ``tensors`` by the names of `state`."""
        for name, momentum in self._momenta.items():
            momentum.copy_(tensors[f"momentum.{name}"].reshape(momentum.shape))
        for name, weight in self._others.items():
            kinds = ("exp_avg", "exp_avg_sq")
            self._adam.state[weight] = {
                "step": torch.tensor(float(steps), device=weight.device),
                **{kind: tensors[f"{kind}.{name}"].to(weight).clone() for kind in kinds},
            }


def orthogonal(matrix: Tensor, dtype: torch.dtype) -> Tensor:
    """About the orthogonal factor of the polar decomposition of a ``matrix`` [M, N], as ``dtype``.

    torch.optim.Muon computes the same, but always in bfloat16. On a processor without arithmetic of
    bfloat16 that takes a hundred times as long, and four fifths of a step.
    """
    tall, factor = matrix.size(0) > matrix.size(1), matrix.to(dtype)
    factor = factor.T if tall else factor
    factor = factor / factor.norm().clamp(min=1e-7)
    a, b, c = CUBIC
    for _ in range(STEPS):
        gram = factor @ factor.T
        factor = torch.addmm(factor, torch.addmm(gram, gram, gram, beta=b, alpha=c), factor, beta=a)
    return factor.T if tall else factor
