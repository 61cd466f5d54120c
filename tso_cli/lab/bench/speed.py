"""All measurements in one record."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from ...errors import InputError
from . import chamfer, memory, refinement, silhouette, start_up, training
from .claims import claims
from .machine import machine, versions
from .timing import Setting, threads

CONVENTION = {
    "seconds": "wall clock; median and quartiles (low, high) of the runs, contestants of one size by turns in one process",
    "silhouette": "from projected points to the gradient by them of sums and cross-entropy, one picture, float32, "
    "sigma^2 0.4 px^2; the scatters without the term for mask pixels that no window reaches",
    "chamfer": "one step, value and gradient, mean over every tenth of the 50 steps of a refinement; what is built once apart",
    "terms": "value and gradient of each term; the projector is points to sums of the silhouette and back",
    "step": "one step of points mode and of the network modes, and its parts",
    "batch": "one cloud, all of `refine`: all steps, preparation and judgement; seconds of a call over the clouds in it",
    "start-up": "a whole process; low and high are the quickest and the slowest",
    "threads": "the same work on one thread and on all cores, by turns; over_first: how many times quicker than on the first",
    "training": "a step of 16 images without the optimiser; the bare network's forward and backward beside it; waiting: share "
    "of such steps in which the network waits for a batch that threads prepare ahead",
    "peak_memory_bytes": "growth of the most that was resident, one call in a fresh process (CUDA: of what was allocated)",
}
PARTS: dict[str, Callable[[Setting], list[dict[str, Any]]]] = {
    "silhouette": silhouette.measure,
    "chamfer": chamfer.measure,
    "terms": lambda setting: [*refinement.terms(setting, 1024, 64), *refinement.terms(setting, 16384, 256)],
    "step": lambda setting: [
        *refinement.points_step(setting, 1024),
        *refinement.points_step(setting, 16384),
        *refinement.network_step(setting, "encoder"),
        *refinement.network_step(setting, "encoder-decoder"),
    ],
    "batch": refinement.batch,
    "threads": refinement.more_threads,
    "training": training.measure,
    "start-up": start_up.measure,
}


def speed(setting: Setting, only: Sequence[str] = ()) -> dict[str, Any]:
    """Measure the parts named in ``only``; all of them where it is empty.

    Returns
    -------
    {"bench": "speed", "machine", "versions", "threads", "device", "seed", "seconds" in all, "convention", "claims", "records"};
    every record is flat and holds "what", "name", "points", "side", "batch", "device", "threads", "seconds" ("median", "low",
    "high"; None where it was left out, which "left_out" explains), "runs" and "peak_memory_bytes".

    Raises InputError for a device other than the CPU or CUDA.
    """
    if setting.device.type not in ("cpu", "cuda"):
        raise InputError(f"--device {setting.device}: expected cpu or cuda, speed is measured on no other")
    begun = time.perf_counter()
    with threads(setting.threads):
        records = [record for name, part in PARTS.items() if name in (only or PARTS) for record in part(setting)]
    memory.add_peaks(records, setting)
    return {
        "bench": "speed",
        "command": "tso bench speed" + (" --full" if setting.full else ""),
        "machine": machine(setting.device),
        "versions": versions(),
        "threads": setting.threads,
        "device": str(setting.device),
        "seed": setting.seed,
        "seconds": time.perf_counter() - begun,
        "convention": CONVENTION,
        "claims": claims(records),
        "records": records,
    }
