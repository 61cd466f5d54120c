"""When the compiled loops are used: the one rule, for every kernel that has a compiled form."""

from __future__ import annotations

import functools
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
    return points.shape[0] * points.shape[1] >= POINTS_WORTH_COMPILING and _importable()


@functools.cache
def _importable() -> bool:
    try:
        import numba  # noqa: F401
    except ImportError as error:
        # a numpy newer than numba knows, for one
        reason = (str(error).splitlines() or ["no reason given"])[0]
        warnings.warn(f"compiled loops are not used, which is slower: numba cannot be imported ({reason})", stacklevel=2)
        return False
    return True
