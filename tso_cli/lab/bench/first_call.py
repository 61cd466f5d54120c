"""One call of `refine` in a fresh process: ``python -m tso_cli.lab.bench.first_call FILE``, a pickle of its arguments."""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path

from ...refinement import refine
from .timing import timed


def peak_memory() -> int:
    """The most that this process held so far, in bytes, with Python and all libraries; 0 where Linux does not say."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM")), 0)


if __name__ == "__main__":
    points, views, config, form = pickle.loads(Path(sys.argv[1]).read_bytes())
    seconds = timed(lambda: refine(points, views, config=config), form)()
    print(json.dumps({"seconds": seconds, "peak_memory_bytes": peak_memory()}))
