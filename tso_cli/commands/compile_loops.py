"""`tso compile`: compile the numba kernels ahead of the first run that needs them."""

from __future__ import annotations

import time

import click

from . import options


@click.command("compile")
def command() -> None:
    """Compile the kernels of large refinements now, once, for all runs.

    Without it, a refinement of many points that is too short to repay the compilation runs in plain torch, and says so;
    training and batches of many clouds compile what they need. Takes about ten seconds. The machine code is kept beside the
    package or in the user's cache folder (NUMBA_CACHE_DIR, if set) until tso, the compiler or Python changes.
    """
    begun = time.perf_counter()
    from ..refinement.api import compile_loops

    compile_loops()
    options.log(f"tso: the loops are compiled ({time.perf_counter() - begun:.0f} s)")
