"""`tso compile`: compile the loops with numba ahead of the first run that needs them."""

from __future__ import annotations

import time

import click

from . import options


@click.command("compile")
def command() -> None:
    """Compile the loops for large clouds now, once for all later runs.

    Large refinements run faster in compiled loops. If the loops are not compiled yet, a refinement
    that is too short to repay about ten seconds of compiling runs in numpy, and prints a warning.
    Longer refinements, batches of many clouds and trainings compile the loops that they need.

    The machine code is stored next to the package, or in the user's cache folder if the package
    cannot be written to; the variable NUMBA_CACHE_DIR names another folder. It stays valid until
    tso, numba or Python changes.
    """
    begun = time.perf_counter()
    from ..refinement.api import compile_loops

    compile_loops()
    options.log(f"tso: the loops are compiled ({time.perf_counter() - begun:.0f} s)")
