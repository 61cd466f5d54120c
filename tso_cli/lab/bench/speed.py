"""All measurements in one record."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from ...errors import InputError
from . import chamfer, loop, many_threads, memory, network_forms, profile, silhouette, training
from .claims import claims
from .machine import machine, rates, versions
from .timing import Setting, threads

START_UPS = 5
# Peak memory is measured at this size and at the largest: a process for each takes three seconds.
REMEMBERED = 16384
CONVENTION = {
    "seconds": "wall clock; median and quartiles (low, high) of the runs, contestants of one size by turns in one process",
    "silhouette": "from projected points to the gradient by them of sums and cross-entropy, one picture, float32, "
    "sigma^2 0.4 px^2; the scatters without the pull of pixels that no window reaches",
    "limit": "taps (N x 9 x 9) x multiply-adds (forward 1, backward 2) over the rate measured in the same run; scatter: the "
    "forward ones over the rate of load, multiply-add and store; memory: bytes that must be moved over the rate of a copy",
    "profile": "the stages of the compiled silhouette called alone; an empty function is torch's own cost of a derivative",
    "growth": "slope: of a line through log seconds over log size (points, or pixels); steepest: between neighbouring sizes",
    "chamfer": "one step, value and gradient, mean over every tenth of the 50 steps of a refinement; what is built once apart",
    "terms": "value and gradient of each term; the projector is points to sums of the silhouette and back",
    "step": "one step of points mode and of the network modes, and its parts",
    "network forms": "forward and backward of the network on one image in other layouts and precisions; Adam for its weights",
    "batch": "one cloud, all of `refine`: all steps, preparation and judgement; seconds of a call over the clouds in it",
    "start-up": "a whole process; low and high are the quickest and the slowest",
    "threads": "the same work on one thread and on all cores, by turns; over_first: how many times quicker than on the first",
    "training": "a step of 16 images without the optimiser; the bare network's forward and backward beside it; waiting: share "
    "of such steps in which the network waits for a batch that threads prepare ahead; roofline: images a second by the "
    "multiply-adds of forward and backward, at the rate of a large matrix product or convolution in the same precision, the "
    "higher of the two",
    "peak_memory_bytes": "growth of the most that was resident, one call in a fresh process (CUDA: of what was allocated)",
}


def _silhouette(setting: Setting, records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    found = {record["name"]: record["per_second"] for record in records if record["what"] == "rate"}
    return silhouette.measure(setting, found) + profile.measure(setting) + silhouette.growth(setting)


def _start_up(setting: Setting, _: list[dict[str, Any]]) -> list[dict[str, Any]]:
    from .start_up import start_up

    setting.report("start-up")
    return [setting.record("start-up", record["name"]) | record for record in start_up(START_UPS)]


PARTS: dict[str, Callable[[Setting, list[dict[str, Any]]], list[dict[str, Any]]]] = {
    "limit": lambda setting, _: rates(setting),
    "silhouette": _silhouette,
    "chamfer": lambda setting, _: chamfer.measure(setting),
    "terms": lambda setting, _: loop.terms(setting),
    "step": lambda setting, _: loop.points_step(setting) + loop.network_steps(setting) + network_forms.measure(setting),
    "batch": lambda setting, _: loop.batch(setting),
    "threads": lambda setting, _: many_threads.measure(setting),
    "training": lambda setting, _: training.measure(setting),
    "start-up": _start_up,
}


def speed(setting: Setting, only: Sequence[str] = ()) -> dict[str, Any]:
    """Measure the ``only`` parts, all of them where none is named.

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
    wanted = set(only or PARTS)
    if "silhouette" in wanted:
        wanted.add("limit")
    records: list[dict[str, Any]] = []
    with threads(setting.threads):
        for name, part in PARTS.items():
            if name in wanted:
                records += part(setting, records)
    for what in memory.MEASURED:
        own = [record for record in records if record["what"] == what and record["runs"]]
        largest = max((record["points"] for record in own), default=0)
        memory.add_peaks([record for record in own if record["points"] in (REMEMBERED, largest)], setting)
    return {
        "bench": "speed",
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
