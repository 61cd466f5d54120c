"""`tso compile`: the first run's waiting, at a time of one's own choice."""

from __future__ import annotations

import time

import click

from . import options


@click.command("compile")
def command() -> None:
    """Compile the loops of large refinements now, once, for all runs.

    A refinement of many points runs compiled loops where they are on disk. Where they are not, and compiling them would take
    longer than they save, it leaves the work to plain torch, and says so; training and batches of many clouds compile what they
    need. This takes some ten seconds. The machine code is kept beside the package, or in the user's cache folder
    (NUMBA_CACHE_DIR, if set); another version of tso, of the compiler or of Python needs it again.
    """
    begun = time.perf_counter()
    from ..refinement.api import compile_loops

    compile_loops()
    options.log(f"tso: the loops are compiled ({time.perf_counter() - begun:.0f} s)")
