"""`tso compile`: compile the loops with numba ahead of the first run that needs them."""

from __future__ import annotations

import time

import click

from ..errors import TsoError
from ..io.output import reason
from . import options

ANOTHER_FOLDER = "set NUMBA_CACHE_DIR to a folder that can be written"


@click.command("compile")
def command() -> None:
    """Compile the loops for large clouds now, once for all later runs.

    Large refinements run faster in compiled loops. If the loops are not compiled yet, a refinement
    that is too short to repay about ten seconds of compiling runs in numpy, and prints a warning.
    Longer refinements, batches of many clouds and trainings compile the loops that they need.

    The machine code is stored next to the package, or in the user's cache folder if the package
    cannot be written to; the variable NUMBA_CACHE_DIR names another folder, which must be one that
    can be written to. The code stays valid until tso, numba or Python changes.
    """
    begun = time.perf_counter()
    from ..kernels.dispatch import importable, kept, switched_off, unwritable
    from ..refinement.api import compile_loops

    if not importable("numba"):
        raise TsoError("numba cannot be imported, expected it: it compiles the loops")
    if switched_off():
        raise TsoError(
            "numba is switched off (NUMBA_DISABLE_JIT), expected it on; numpy does the work"
        )
    if fault := unwritable():
        raise TsoError(
            f"{fault[0]}: NUMBA_CACHE_DIR names it, but it cannot be written ({reason(fault[1])}); "
            f"{ANOTHER_FOLDER}"
        )
    if kept()[0] is None:
        raise TsoError(
            "the compiled loops cannot be kept: neither the folder of the package nor the user's "
            f"cache folder can be written, expected one; {ANOTHER_FOLDER}"
        )
    compile_loops()
    folder, found, of_all = kept()
    if found < of_all:
        raise TsoError(
            f"{folder}: holds {found} of {of_all} compiled loops, expected all; make room there, "
            f"or {ANOTHER_FOLDER}"
        )
    options.log(
        f"tso: {found} loops are compiled and kept in {folder} "
        f"({time.perf_counter() - begun:.0f} s)"
    )
