"""The measurement of speed: all parts in one record, and the study that shows it."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from ...errors import InputError
from ...version import __version__
from ..charts.speed_chart import draw_speed
from ..charts.speed_table import tables
from ..study import Study
from . import chamfer, refinement, silhouette, start_up
from .claims import claims
from .timing import Setting, threads

CONVENTION = {
    "seconds": "wall clock; median and quartiles (low, high) of the runs, contestants of one size by turns in one process",
    "silhouette": "from projected points to the gradient by them of sums and cross-entropy, one picture, float32, "
    "sigma^2 0.4 px^2; the scatters without the term for mask pixels that no window reaches",
    "chamfer": "one step, value and gradient, mean over every tenth of the 50 steps of a refinement; what is built once apart",
    "terms": "value and gradient of each term; the projector is points to sums of the silhouette and back",
    "step": "one step of the network modes, beside forward, backward and Adam of the bare network",
    "batch": "one cloud, all of `refine`: all steps, preparation and judgement; seconds of a call over the clouds in it",
    "start-up": "a whole process; low and high are the quickest and the slowest",
}
PARTS: dict[str, Callable[[Setting], list[dict[str, Any]]]] = {
    "silhouette": silhouette.measure,
    "chamfer": chamfer.measure,
    "terms": lambda setting: [*refinement.terms(setting, 1024, 64), *refinement.terms(setting, 16384, 256)],
    "step": lambda setting: [
        *refinement.network_step(setting, "encoder"),
        *refinement.network_step(setting, "encoder-decoder"),
    ],
    "batch": refinement.batch,
    "start-up": start_up.measure,
}


def speed(setting: Setting, only: Sequence[str] = ()) -> dict[str, Any]:
    """Measure the parts named in ``only``; all of them where it is empty.

    Returns
    -------
    {"bench": "speed", "machine", "versions", "threads", "device", "seed", "seconds" in all, "convention", "claims", "records"};
    every record is flat and holds "what", "name", "points", "side", "batch", "device", "threads", "seconds" ("median", "low",
    "high"; None where it was left out, which "left_out" explains) and "runs".

    Raises InputError for a device other than the CPU or CUDA.
    """
    if setting.device.type not in ("cpu", "cuda"):
        raise InputError(f"--device {setting.device}: expected cpu or cuda, speed is measured on no other")
    begun = time.perf_counter()
    with threads(setting.threads):
        records = [record for name, part in PARTS.items() if name in (only or PARTS) for record in part(setting)]
    return {
        "bench": "speed",
        "command": "tso bench speed" + (" --full" if setting.full else ""),
        "machine": machine(setting.device),
        "versions": {
            "tso": __version__,
            "python": platform.python_version(),
            **{package: version(package) for package in ("torch", "numpy", "numba", "scipy")},
        },
        "threads": setting.threads,
        "device": str(setting.device),
        "seed": setting.seed,
        "seconds": time.perf_counter() - begun,
        "convention": CONVENTION,
        "claims": claims(records),
        "records": records,
    }


def machine(device: torch.device) -> dict[str, Any]:
    """Processor, cores, memory, GPU and platform."""
    processor, memory = platform.processor() or platform.machine(), None
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), processor)
    with suppress(AttributeError, ValueError, OSError):
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return {
        "cpu": processor,
        "cores": os.cpu_count(),
        "memory_bytes": memory,
        "gpu": torch.cuda.get_device_name(device) if device.type == "cuda" else None,
        "platform": platform.platform(terse=True),
    }


STUDY = Study(
    name="speed",
    about="How fast is it, beside other ways and other packages?",
    options=(),
    run=speed,
    tables=tables,
    draw=draw_speed,
    reading="Contestants for the same work take turns in one process. Trust ratios before times: two runs on a shared machine "
    "differ by up to half.",
)
