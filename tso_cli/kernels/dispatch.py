"""Which form of a kernel runs: plain torch, numba loops on the CPU, or Triton on a GPU (experimental).

numba runs on float32 and float64 CPU tensors where that repays the import of its compiler, half a second: where a refinement
states so much work by `planned`, elsewhere for batches of 8,192 points. Work that would not repay compiling, ten seconds, needs
the machine code on disk. The choice depends on the work and the disk alone, so that a run can be repeated. Triton runs on
float32 tensors on a GPU where it can be imported. All else is plain torch.
"""

from __future__ import annotations

import functools
import importlib
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch
from torch import Tensor

POINTS_WORTH_COMPILING = 8192
# Seconds that plain torch takes longer on one core for a picture of a cloud, and for each point in it (measured: 3.1, 7.8 and
# 31 ms a step for 1,024, 4,096 and 16,384 points), and seconds that loading and compiling take.
PER_PICTURE, PER_POINT = 1.2e-3, 1.8e-6
LOADING, COMPILING = 0.5, 10.0

_plan: ContextVar[Callable[[], bool] | None] = ContextVar("plan", default=None)


@contextmanager
def planned(pictures: int, points: int) -> Iterator[None]:
    """Inside, numba runs if it pays for all of this work. The outermost of nested plans counts.

    ``pictures`` is how often a cloud is drawn in all (clouds x views x steps), ``points`` the points in all these. Warns where
    the work is left to plain torch because no machine code is on disk.
    """
    if _plan.get() is not None:
        yield
        return
    # Decided when first asked, on the CPU alone: looking on the disk takes an import.
    token = _plan.set(functools.cache(functools.partial(_pays, PER_PICTURE * pictures + PER_POINT * points)))
    try:
        yield
    finally:
        _plan.reset(token)


def _pays(seconds: float) -> bool:
    """Whether numba pays where it saves so many ``seconds``."""
    if seconds < LOADING or not _importable("numba"):
        return False
    if seconds >= LOADING + COMPILING or _on_disk():
        return True
    warnings.warn("no compiled loops on disk, plain torch does this work; `tso compile` makes them once", stacklevel=2)
    return False


def _on_disk() -> bool:
    from .jit import on_disk
    from .losses_numba import _cross_entropy
    from .mask_chamfer_numba import _mask_chamfer
    from .projection_numba import _project
    from .static_chamfer_numba import _search

    return on_disk(_cross_entropy, _mask_chamfer, _project, _search)


def use_numba(points: Tensor) -> bool:
    """Whether compiled loops run on ``points`` [M, N, D]."""
    if points.device.type != "cpu" or points.dtype not in (torch.float32, torch.float64):
        return False
    if (pays := _plan.get()) is not None:
        return pays()
    return points.shape[0] * points.shape[1] >= POINTS_WORTH_COMPILING and _importable("numba")


def whole_batches(tensor: Tensor) -> bool:
    """Whether a batch is worked on as one, with nothing read back: on a GPU. On the CPU, single clouds search faster."""
    return tensor.device.type != "cpu"


def triton_runs(points: Tensor) -> bool:
    """Whether Triton kernels run on ``points``."""
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
