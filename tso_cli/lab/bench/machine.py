"""The machine and the versions that a measurement was made with."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from ...version import __version__

PROCESSORS = Path("/proc/cpuinfo")


def machine() -> dict[str, Any]:
    """Processor, cores and platform."""
    lines = PROCESSORS.read_text().splitlines() if PROCESSORS.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    cpu = next(names, platform.processor() or platform.machine())
    return {"cpu": cpu, "cores": os.cpu_count(), "platform": platform.platform(terse=True)}


def versions() -> dict[str, str | None]:
    """Versions of tso and of the packages that decide its speed; None for a missing one."""
    result: dict[str, str | None] = {"tso": __version__, "python": platform.python_version()}
    for package in ("torch", "numpy", "numba", "scipy"):
        try:
            result[package] = version(package)
        except PackageNotFoundError:
            result[package] = None
    return result
