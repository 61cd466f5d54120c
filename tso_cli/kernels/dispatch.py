"""Whether a refinement runs in numpy or in loops that numba compiles.

Loading numba and the machine code takes half a second; compiling takes ten seconds. A refinement
states its work by `planned`. The compiled loops run

1. if this work and the earlier work of the process save more time than loading takes, and the
   machine code is on disk, or
2. if this work saves more time than loading and compiling take together.

The choice depends on the work and the disk alone, so that a run can be repeated.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import math
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from pathlib import Path


class Seconds:
    """Rough times on one thread; their order of magnitude decides."""

    # Saved by compiled loops when a cloud is compared with a view once, and for each point.
    PER_VIEW, PER_POINT = 0.3e-3, 1.5e-6
    TO_LOAD, TO_COMPILE = 0.5, 10.0


# The modules that define the loops of a refinement, or import the modules that do.
MODULES_OF_LOOPS = ("mask_chamfer_numba", "points_numba", "silhouette_numba")

# Seconds that compiled loops save, or would have saved, in all earlier work of this process.
_earlier = [0.0]
_plan: ContextVar[Callable[[], bool] | None] = ContextVar("plan", default=None)


@contextlib.contextmanager
def planned(views: int, points: int) -> Iterator[None]:
    """Inside, compiled loops run if they save time over the whole of this work.

    The outermost of nested plans counts.

    Parameters
    ----------
    views : clouds x views x steps, the number of times that a cloud is compared with a view.
    points : the sum of the clouds' points over all these comparisons.

    Warns if numpy does the work only because no machine code is on disk.
    """
    if _plan.get() is not None:
        yield
        return
    saved = Seconds.PER_VIEW * views + Seconds.PER_POINT * points
    # Decided at the first question, because a look at the disk imports numba.
    token = _plan.set(functools.cache(functools.partial(_pays, saved)))
    try:
        yield
    finally:
        _plan.reset(token)
        _earlier[0] += saved


@contextlib.contextmanager
def decided(compiled: bool) -> Iterator[None]:
    """Inside, compiled loops run or do not, as ``compiled`` says."""
    token = _plan.set(lambda: compiled)
    try:
        yield
    finally:
        _plan.reset(token)


def enough_to_load() -> tuple[int, int]:
    """Work for `planned` that is worth loading loops from disk, and not worth compiling them."""
    return math.ceil(Seconds.TO_LOAD / Seconds.PER_VIEW), 0


def use_compiled() -> bool:
    """Whether compiled loops run here."""
    pays = _plan.get()
    return pays is not None and pays()


def _pays(seconds: float) -> bool:
    """Whether compiled loops, which save ``seconds``, save more than it takes to get them."""
    if _earlier[0] + seconds < Seconds.TO_LOAD or not usable():
        return False
    if seconds >= Seconds.TO_LOAD + Seconds.TO_COMPILE or on_disk():
        return True
    warnings.warn(
        "found no compiled loops on disk, so numpy does this work; `tso compile` makes them once",
        stacklevel=2,
    )
    return False


def on_disk() -> bool:
    """Whether the machine code of all loops of a refinement is on disk."""
    if not usable():
        return False
    found, of_all = kept()[1:]
    return found == of_all


def kept() -> tuple[Path | None, int, int]:
    """Where machine code is kept, of how many loops of a refinement, and how many there are.

    The folder is None if none can be written.
    """
    for module in MODULES_OF_LOOPS:
        importlib.import_module(f".{module}", __package__)
    from .jit import folder_of_loops, loops_on_disk

    return folder_of_loops(), *loops_on_disk()


def unwritable() -> tuple[Path, OSError] | None:
    """The folder that the user names for machine code, if it cannot be written, and why.

    numba then takes another folder, and says nothing.
    """
    from numba import config

    if not (named := getattr(config, "CACHE_DIR", "")):
        return None
    folder = Path(named)
    try:
        with contextlib.suppress(FileExistsError):  # a file, which the next line is about
            folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return folder, error
    return None


def usable() -> bool:
    """Whether numba can compile loops; if it cannot be imported, warns and says why."""
    return importable("numba") and not switched_off()


def switched_off() -> bool:
    """Whether the user has switched numba off (NUMBA_DISABLE_JIT), which imports numba."""
    from numba import config

    return bool(getattr(config, "DISABLE_JIT", False))


@functools.cache
def importable(name: str) -> bool:
    """Whether the module can be imported; if it cannot, warns and says why."""
    try:
        importlib.import_module(name)
    except ImportError as error:
        # One known reason is a numpy that is newer than numba allows.
        reason = (str(error).splitlines() or ["no reason given"])[0]
        warnings.warn(
            f"compiled loops are not used, which is slower: {name} cannot be imported ({reason})",
            stacklevel=2,
        )
        return False
    return True
