"""Whether a refinement runs in numpy or in loops that numba compiles.

Importing numba and loading machine code takes half a second, compiling ten: the loops run where the work, which a refinement
states by `planned`, repays the first, and the machine code is on disk or the work repays the second as well. The choice depends
on the work and the disk alone, so that a run can be repeated.
"""

from __future__ import annotations

import functools
import importlib
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# Seconds that numpy takes longer for a step of a cloud by one view, and for each point of it; seconds that loading and
# compiling the loops take.
PER_VIEW, PER_POINT = 0.3e-3, 1.5e-6
LOADING, COMPILING = 0.5, 10.0

_plan: ContextVar[Callable[[], bool] | None] = ContextVar("plan", default=None)


@contextmanager
def planned(views: int, points: int, seconds: float = math.inf) -> Iterator[None]:
    """Inside, compiled loops run if they pay for all of this work. The outermost of nested plans counts.

    ``views`` is how often a cloud is compared with a view in all (clouds x views x steps), ``points`` the points in all these.
    ``seconds`` is how long all may take: loading the loops must leave half of them.
    Warns where the work is left to numpy because no machine code is on disk.
    """
    if _plan.get() is not None:
        yield
        return
    # Decided when first asked: looking on the disk takes an import.
    saved = min(PER_VIEW * views + PER_POINT * points, 0.5 * seconds)
    token = _plan.set(functools.cache(functools.partial(_pays, saved)))
    try:
        yield
    finally:
        _plan.reset(token)


def use_compiled() -> bool:
    """Whether compiled loops run here."""
    pays = _plan.get()
    return pays is not None and pays()


def _pays(seconds: float) -> bool:
    """Whether the ``seconds`` that compiled loops save exceed those of loading them, and of compiling if none are on disk."""
    if seconds < LOADING or not importable("numba"):
        return False
    if seconds >= LOADING + COMPILING or _on_disk():
        return True
    warnings.warn(
        "no compiled loops on disk, numpy does this work; `tso compile` makes them once",
        stacklevel=2,
    )
    return False


def _on_disk() -> bool:
    from .jit import on_disk
    from .losses_numba import _cross_entropy, _pixels_to_points
    from .mask_chamfer_numba import _mask_chamfer
    from .nearest_numba import _compare_all
    from .points_numba import (
        chamfer,
        farthest_points,
        gather,
        nearest_few,
        nearest_in_grid,
        sort_into_grid,
        spread,
    )
    from .splat_numba import _add, _gather

    of_points = (
        chamfer,
        farthest_points,
        gather,
        nearest_few,
        nearest_in_grid,
        sort_into_grid,
        spread,
    )
    return on_disk(
        _mask_chamfer, _compare_all, *of_points, _add, _gather, _cross_entropy, _pixels_to_points
    )


@functools.cache
def importable(name: str) -> bool:
    """Whether the module can be imported; warns with the reason where it cannot."""
    try:
        importlib.import_module(name)
    except ImportError as error:
        # a numpy newer than numba knows, for one
        reason = (str(error).splitlines() or ["no reason given"])[0]
        warnings.warn(
            f"compiled loops are not used, which is slower: {name} cannot be imported ({reason})",
            stacklevel=2,
        )
        return False
    return True
