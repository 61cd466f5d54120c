"""Targets for the speed, and whether a record meets them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

Records = Sequence[dict[str, Any]]
# (claim, measured, whether the target is met)
Judged = Iterator[tuple[str, str, bool]]
SMALL, MIDDLE, LARGE = (1024, 64), (16384, 256), (1_000_000, 1024)


def claims(records: Records) -> list[dict[str, Any]]:
    """{"claim", "found", "holds"} of every target that the records allow to judge."""
    judges = (_silhouette, _growth, _chamfer, _terms, _network, _batch, _start_up)
    return [{"claim": claim, "found": found, "holds": holds} for judge in judges for claim, found, holds in judge(records)]


def _seconds(records: Records, what: str, size: tuple[int, int | None]) -> dict[str, float]:
    return {
        record["name"]: record["seconds"]["median"]
        for record in records
        if record["what"] == what and record["seconds"] and (record["points"], record["side"]) == size
    }


def _silhouette(records: Records) -> Judged:
    # The fastest kernel is measured first.
    ours = next((record["name"] for record in records if record["what"] == "silhouette"), "")
    factors = {(size, f"scatter {window}"): 4 for size in (SMALL, MIDDLE) for window in ("9x9", "7x7")} | {
        (MIDDLE, "exact"): 30
    }
    for (size, name), factor in factors.items():
        seconds = _seconds(records, "silhouette", size)
        if ours in seconds and name in seconds:
            ratio = seconds[name] / seconds[ours]
            at = f"{size[0]:,} points at {size[1]}x{size[1]}"
            yield f"{at}: {ours} at least {factor}x faster than {name}", f"{ratio:.1f}x", ratio >= factor
    seconds = _seconds(records, "silhouette", SMALL)
    if {"windowed", "scatter 9x9"} <= set(seconds):
        ratio = seconds["scatter 9x9"] / seconds["windowed"]
        yield "1,024 points: what one refinement takes, windowed, no slower than scatter 9x9", f"{ratio:.2f}x", ratio >= 1.0
    for record in records:
        if (record["what"], record["name"], record["points"], record["side"]) == ("silhouette", ours, *LARGE):
            median = record["seconds"]["median"]
            yield "1,000,000 points at 1,024x1,024 in under 2 s", f"{median:.2f} s", median < 2.0


def _growth(records: Records) -> Judged:
    rows = [record for record in records if record["what"] == "silhouette" and record["seconds"]]
    times = [(record["points"], record["seconds"]["median"]) for record in rows if record["name"] == rows[0]["name"]]
    if len(times) > 1:
        sizes, seconds = np.log(times).T
        slope = float(np.polyfit(sizes, seconds, 1)[0])
        yield "silhouette: cost grows with slope <= 1.1 in log-log, points and pixels together", f"{slope:.2f}", slope <= 1.1


def _chamfer(records: Records) -> Judged:
    seconds = _seconds(records, "chamfer", (16384, None))
    trees = [value for name, value in seconds.items() if name.startswith("two k-d trees a step")]
    if trees:
        ratio = min(trees) / seconds["tso"]
        yield "Chamfer of 16,384 points at least 5x faster than two k-d trees a step", f"{ratio:.1f}x", ratio >= 5.0


def _terms(records: Records) -> Judged:
    rows = [record for record in records if record["what"] == "terms"]
    if rows:
        worst = max(rows, key=lambda record: record["over_projector"])
        found = f"{worst['name']}, {worst['points']:,} points: {worst['over_projector']:.2f}x"
        yield "no term costs more than 3x the projector", found, worst["over_projector"] <= 3.0


def _network(records: Records) -> Judged:
    for mode in ("encoder", "encoder-decoder"):
        added = next((record["added"] for record in records if record["what"] == f"step, {mode}"), None)
        if added is not None:
            claim = f"{mode}: projector and losses add at most 30 % to the bare network's step"
            yield claim, f"{100.0 * added:.0f} %", added <= 0.3


def _batch(records: Records) -> Judged:
    rows = [record for record in records if record["what"] == "batch" and record["name"] == "refine_batch"]
    for preset in dict.fromkeys(record["preset"] for record in rows):
        largest = max((record for record in rows if record["preset"] == preset), key=lambda record: record["batch"])
        size, ratio, least = largest["batch"], largest["times_refine"], 1.0 if largest["device"] == "cpu" else 5.0
        claim = f"{preset}: {size} clouds in one call at least {least:.0f}x the throughput of {size} calls"
        yield claim, f"{ratio:.1f}x the throughput", ratio >= least


def _start_up(records: Records) -> Judged:
    seconds = {record["name"]: record["seconds"]["median"] for record in records if record["what"] == "start-up"}
    refine, large = "tso refine --mode points", "tso refine --mode points, 16,384 points"
    for name in ("tso --version", "tso --help"):
        if {name, "python"} <= set(seconds):
            over = seconds[name] - seconds["python"]
            yield f"{name} under 0.15 s above bare Python", f"{over:.2f} s", over < 0.15
    if {refine, "import torch"} <= set(seconds):
        taken, allowed = seconds[refine], 1.25 * seconds["import torch"] + 0.2
        claim = "tso refine --mode points at most 1.25x `import torch` plus 0.2 s"
        yield claim, f"{taken:.2f} of {allowed:.2f} s", taken <= allowed
    for size, name in (("1,024", refine), ("16,384", large)):
        if {name, f"{name}, first"} <= set(seconds):
            ratio = seconds[f"{name}, first"] / seconds[name]
            yield f"{size} points: the first run ever under 2x any other", f"{ratio:.2f}x", ratio < 2.0
