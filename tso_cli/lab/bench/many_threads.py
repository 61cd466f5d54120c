"""What more CPU threads bring: the same work on one and on all cores, by turns."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

from ...silhouette.chamfer import ChamferToInitial
from . import silhouette
from .loop import HALFWAY, many_clouds
from .material import projection, trajectory
from .timing import Setting, Work, gradient, threads

LARGE = (65536, 512)
CLOUDS = 64


def measure(
    setting: Setting, size: tuple[int, int] = LARGE, clouds: int = CLOUDS, counts: Sequence[int] | None = None
) -> list[dict[str, Any]]:
    """Seconds of one large cloud's silhouette and Chamfer distance, and of a batch of clouds, on each number of threads.

    ``counts`` of threads are by default one and all cores. "over_first" is how many times quicker than on the first of them. A
    GPU has no such threads, and no records.
    """
    if setting.device.type != "cpu":
        return []
    counts = sorted({1, os.cpu_count() or 1}) if counts is None else counts
    count, side = size
    setting.report(f"threads {', '.join(map(str, counts))}")
    kernel = silhouette.kernels(setting.device)[0]
    iterate = trajectory(count, setting.device, setting.seed, HALFWAY)
    works: list[tuple[str, Work, dict[str, Any]]] = [
        (
            f"silhouette, {kernel}",
            silhouette.work(kernel, projection(count, side, setting.device, setting.seed)),
            {"points": count, "side": side},
        ),
        ("Chamfer to the start", gradient(ChamferToInitial(iterate[0]), iterate[-1]), {"points": count}),
        (f"refine_batch of {clouds}", many_clouds(setting, clouds), {"points": 1024, "side": 256, "batch": clouds}),
    ]
    records = []
    for name, work, at in works:
        timings = setting.race({str(number): _on(number, work) for number in counts})
        first = timings[str(counts[0])].median
        records += [
            setting.record("threads", name, timing, **at, threads=int(number), over_first=first / timing.median)
            for number, timing in timings.items()
        ]
    return records


def _on(count: int, work: Work) -> Work:
    def run() -> None:
        with threads(count):
            work()

    return run
