"""Which form of a kernel is used: the one rule, for every kernel that has a compiled form or one for GPUs."""

from __future__ import annotations

import functools
import importlib
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch
from torch import Tensor

# Importing the compiler and loading compiled code takes half a second to a second, once in a process. Fifty steps (a
# refinement) win back more than that from this many points a step on; a training always has them.
POINTS_WORTH_COMPILING = 8192
# The same for work that is known beforehand, in seconds of one core: what plain torch takes longer for a picture of a cloud and
# for each point in it (measured: 3.1, 7.8 and 31 ms a step for 1,024, 4,096 and 16,384 points), and what loading (0.3 to 0.6)
# and compiling take. On a slower machine all of them are larger.
PER_PICTURE, PER_POINT = 1.2e-3, 1.8e-6
LOADING, COMPILING = 0.5, 10.0
TO_COMPILE = "tso compile"


@contextmanager
def planned(pictures: int, points: int) -> Iterator[None]:
    """Inside, compiled loops are used if they pay for this much work, whatever the size of its parts.

    What is not on disk yet must be compiled first, which takes many times longer than to load it: less work than that is left
    to plain torch, with a warning that says how to compile beforehand. Of plans within plans the outermost counts.

    Parameters
    ----------
    pictures : how often a cloud is drawn and compared in all: clouds x views x steps.
    points : how many points are in these pictures in all.
    """
    if _plan.get() is not None:
        yield
        return
    token = _plan.set(_Plan(PER_PICTURE * pictures + PER_POINT * points))
    try:
        yield
    finally:
        _plan.reset(token)


class _Plan:
    def __init__(self, saved: float) -> None:
        self._saved = saved

    @functools.cached_property
    def compiled(self) -> bool:
        """Asked for on the CPU alone; looking on the disk takes an import."""
        if self._saved < LOADING or not _importable("numba"):
            return False
        if self._saved >= LOADING + COMPILING or _on_disk():
            return True
        warnings.warn(f"no compiled loops on disk, plain torch does this work; `{TO_COMPILE}` makes them once", stacklevel=2)
        return False


_plan: ContextVar[_Plan | None] = ContextVar("plan", default=None)


def _on_disk() -> bool:
    from . import (
        mask_bce_numba as compiled_mask,
    )
    from . import (
        mask_chamfer_numba as compiled_pull,
    )
    from . import (
        projection_numba as compiled_projection,
    )
    from . import (
        static_chamfer_numba as compiled_static,
    )
    from .jit import kept

    return kept(compiled_mask._run, compiled_projection._project, compiled_static._search, compiled_pull._pull)


def use_numba(points: Tensor) -> bool:
    """Whether compiled loops are to be used on ``points`` [M, N, D], in float32 or float64 on the CPU.

    Inside `planned` they are if they pay for all that is planned, else if M N is 8,192 or more. It depends on nothing
    else but what is on disk (neither on what ran before in the process nor on the number of threads), so that a run can be
    repeated.
    """
    if points.device.type != "cpu" or points.dtype not in (torch.float32, torch.float64):
        return False
    if (plan := _plan.get()) is not None:
        return plan.compiled
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
