"""Which form of a kernel runs on tensors, for training.

1. Compiled loops (numba) run on float32 and float64 tensors on the CPU, in batches of at least
   8,192 points.
2. Triton (experimental) runs on float32 tensors on a GPU, if it can be imported.
3. Plain torch runs in all other cases.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .dispatch import importable, usable

# Smaller batches are about as fast in plain torch, and need no compilation.
POINTS_WORTH_COMPILING = 8192


def use_numba(points: Tensor) -> bool:
    """Whether compiled loops run on ``points`` [M, N, D]."""
    if points.device.type != "cpu" or points.dtype not in (torch.float32, torch.float64):
        return False
    return points.shape[0] * points.shape[1] >= POINTS_WORTH_COMPILING and usable()


def triton_runs(points: Tensor) -> bool:
    """Whether Triton kernels run on ``points``."""
    return points.device.type == "cuda" and points.dtype == torch.float32 and importable("triton")


def called(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call ``function``, which takes and returns arrays, with tensors, on torch's threads."""
    arrays = (a.detach().contiguous().numpy() if isinstance(a, Tensor) else a for a in arguments)
    results = function(*arrays, threads=torch.get_num_threads())
    if isinstance(results, tuple):
        return tuple(map(torch.from_numpy, results))
    return torch.from_numpy(results)


class PrecomputedGradient(torch.autograd.Function):
    """``value`` [M] as a function of ``variable`` [M, ., .] whose derivative is ``gradient``."""

    @staticmethod
    def forward(ctx: Any, variable: Tensor, value: Tensor, gradient: Tensor) -> Tensor:
        ctx.save_for_backward(gradient)
        return value.to(variable)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        (gradient,) = ctx.saved_tensors
        return grad_outputs[0].view(-1, 1, 1) * gradient, None, None
