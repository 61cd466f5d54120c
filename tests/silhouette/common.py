"""A mask, and the value and gradient of a loss."""

from __future__ import annotations

import torch

SIGMA_SQ = 0.4


def disc(size: int = 64, radius: float = 12.0) -> torch.Tensor:
    axis = torch.arange(size, dtype=torch.float64) - (size - 1) / 2.0
    return ((axis[:, None] ** 2 + axis[None] ** 2) < radius**2).double()


def value_and_gradient(loss, points: torch.Tensor) -> tuple[float, torch.Tensor]:
    leaf = points.clone().requires_grad_()
    value = loss(leaf)
    value.backward()
    assert leaf.grad is not None
    return value.item(), leaf.grad
