"""What the figures were measured on, and how fast that machine multiplies and adds."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ...kernels.jit import compiled, share
from ...version import __version__
from .timing import Setting, Work

# Floats worked on in a sweep: 8 KiB, a quarter of a small first-level cache.
FLOATS = 2048
# Multiply-adds on each of them before it is put back.
CHAIN = 32
SWEEPS = 16000
# Side of the product, and bytes of the copy, that a GPU is measured by.
MATRIX, COPIED = 8192, 1 << 30


def machine(device: torch.device) -> dict[str, Any]:
    """Processor, memory and platform, in words and numbers."""
    gpu = torch.cuda.get_device_name(device) if device.type == "cuda" else None
    return {
        "cpu": _processor(),
        "cores": os.cpu_count(),
        "memory_bytes": _memory(),
        "gpu": gpu,
        "platform": platform.platform(terse=True),
    }


def versions() -> dict[str, str | None]:
    """Of the program and of what its speed hangs on; None where a package is missing."""
    found: dict[str, str | None] = {"tso": __version__, "python": platform.python_version()}
    for package in ("torch", "numpy", "numba", "scipy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = None
    return found


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _memory() -> int | None:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def rates(setting: Setting) -> list[dict[str, Any]]:
    """Records of how many float32 multiply-adds, and bytes, the device does in a second (`per_second`).

    On the CPU, by compiled loops on as many threads as the rest is measured with: "multiply-add" in registers, near the most
    there is (a library's convolution was seen a quarter above it); "load, multiply-add, store" on numbers in the first-level
    cache, which a sum over scattered windows cannot beat. On a GPU: "multiply-add" by the product of two float32 matrices of
    side 8,192, "copy" in bytes read and written.
    """
    if setting.device.type == "cuda":
        matrix = torch.ones(MATRIX, MATRIX, device=setting.device)
        source, goal = (torch.empty(COPIED // 4, device=setting.device) for _ in range(2))
        work: dict[str, Work] = {"multiply-add": lambda: matrix @ matrix, "copy": lambda: goal.copy_(source)}
        done = {"multiply-add": float(MATRIX) ** 3, "copy": 2.0 * COPIED}
    else:
        count = setting.threads
        start = torch.ones(count, FLOATS)
        many = count * (1 << 20)
        work = {
            "multiply-add": lambda: share(count, many, _in_registers, start, np.float32(0.5), np.float32(0.25)),
            "load, multiply-add, store": lambda: share(count, many, _in_cache, start, np.float32(1e-9)),
        }
        done = {
            "multiply-add": float(count * FLOATS * SWEEPS),
            "load, multiply-add, store": float(count * FLOATS * SWEEPS),
        }
    timings = setting.race(work)
    return [
        setting.record(
            "rate", name, timing, per_second=done[name] / timing.median, unit="B" if name == "copy" else "multiply-adds"
        )
        for name, timing in timings.items()
    ]


@compiled
def _in_registers(first, last, values, factor, shift):  # type: ignore[no-untyped-def]
    """SWEEPS x FLOATS multiply-adds, each number taken through CHAIN of them at a time.

    Four numbers side by side: a multiply-add waits for the one before it, but not for another number's.
    """
    step = FLOATS // 4
    for row in range(first, last):
        line = values[row]
        for _ in range(SWEEPS // CHAIN):
            for i in range(step):
                a, b, c, d = line[i], line[step + i], line[2 * step + i], line[3 * step + i]
                for _ in range(CHAIN):
                    a, b, c, d = a * factor + shift, b * factor + shift, c * factor + shift, d * factor + shift
                line[i], line[step + i], line[2 * step + i], line[3 * step + i] = a, b, c, d


@compiled
def _in_cache(first, last, values, factor):  # type: ignore[no-untyped-def]
    for row in range(first, last):
        line, other = values[row], np.ones(FLOATS, np.float32)
        for _ in range(SWEEPS):
            for i in range(FLOATS):
                line[i] += factor * other[i]
