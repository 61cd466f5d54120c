"""The machine and the versions that a measurement was made with."""

from __future__ import annotations

import os
import platform
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch

from ...version import __version__


def machine(device: torch.device) -> dict[str, Any]:
    """Processor, cores, memory, GPU and platform."""
    return {
        "cpu": _processor(),
        "cores": os.cpu_count(),
        "memory_bytes": _memory(),
        "gpu": torch.cuda.get_device_name(device) if device.type == "cuda" else None,
        "platform": platform.platform(terse=True),
    }


def versions() -> dict[str, str | None]:
    """Versions of tso and of the packages that decide its speed; None for a missing one."""
    result: dict[str, str | None] = {"tso": __version__, "python": platform.python_version()}
    for package in ("torch", "numpy", "numba", "scipy"):
        try:
            result[package] = version(package)
        except PackageNotFoundError:
            result[package] = None
    return result


def _processor() -> str:
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _memory() -> int | None:
    with suppress(AttributeError, ValueError, OSError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return None
