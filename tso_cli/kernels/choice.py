"""Which form of a kernel is used: the one rule, for every kernel that has a compiled form or one for GPUs."""

from __future__ import annotations

import functools
import importlib
import warnings

import torch
from torch import Tensor

# Importing the compiler and loading compiled code takes half a second to a second, once in a process. Fifty steps (a
# refinement) win back more than that from this many points a step on; a training always has them.
POINTS_WORTH_COMPILING = 8192


def compiled_pays(points: Tensor) -> bool:
    """Whether compiled loops are to be used on ``points`` [M, N, D]: M N is 8,192 or more, in float32 or float64 on the CPU.

    It depends on nothing else (neither on what ran before nor on the number of threads), so that a run can be repeated.
    """
    if points.device.type != "cpu" or points.dtype not in (torch.float32, torch.float64):
        return False
    return points.shape[0] * points.shape[1] >= POINTS_WORTH_COMPILING and _importable("numba")


def whole_batches(tensor: Tensor) -> bool:
    """Whether a batch is worked on as one, with nothing read back: everywhere but on the CPU, where trees know shorter ways."""
    return tensor.device.type != "cpu"


def triton_runs(points: Tensor) -> bool:
    """Whether Triton kernels are used on ``points``: float32 on a GPU, where triton can be imported.

    Builds of torch for GPUs bring triton with them. It is no dependency of this package, and is not imported on the CPU.
    """
    return points.device.type == "cuda" and points.dtype == torch.float32 and _importable("triton")


@functools.cache
def _importable(name: str) -> bool:
    try:
        importlib.import_module(name)
    except ImportError as error:
        # a numpy newer than numba knows, for one
        reason = (str(error).splitlines() or ["no reason given"])[0]
        warnings.warn(f"compiled loops are not used, which is slower: {name} cannot be imported ({reason})", stacklevel=2)
        return False
    return True
