"""What is asked of the speed, and whether it holds in a record: wins and losses alike."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

Records = Sequence[dict[str, Any]]
# (claim, what was found, whether it holds)
Found = Iterator[tuple[str, str, bool]]
SMALL, MIDDLE, LARGE = (1024, 64), (16384, 256), (1_000_000, 1024)


def claims(records: Records) -> list[dict[str, Any]]:
    """{"claim", "found", "holds"} of everything asked that the records tell of."""
    judges: tuple[Callable[[Records], Found], ...] = (
        _silhouette,
        _large,
        _growth,
        _chamfer,
        _terms,
        _network,
        _batch,
        _start_up,
    )
    return [{"claim": claim, "found": found, "holds": holds} for judge in judges for claim, found, holds in judge(records)]


def _seconds(records: Records, what: str, size: tuple[int, int | None], *names: str) -> list[float]:
    return [
        record["seconds"]["median"]
        for record in records
        if record["what"] == what
        and record["seconds"]
        and (record["points"], record["side"]) == size
        and record["name"] in names
    ]


def _own(records: Records) -> str:
    """The program's fastest kernel: the first that was measured."""
    return next((record["name"] for record in records if record["what"] == "silhouette"), "")


def _silhouette(records: Records) -> Found:
    own = _own(records)
    for size, name, wanted in (
        (SMALL, "scatter 9x9", 4),
        (SMALL, "scatter 7x7", 4),
        (MIDDLE, "scatter 9x9", 4),
        (MIDDLE, "scatter 7x7", 4),
        (MIDDLE, "exact", 30),
    ):
        ours, theirs = _seconds(records, "silhouette", size, own), _seconds(records, "silhouette", size, name)
        if ours and theirs:
            ratio = theirs[0] / ours[0]
            at = f"{size[0]:,} points at {size[1]}x{size[1]}"
            yield f"{at}: {own} at least {wanted}x faster than {name}", f"{ratio:.1f}x", ratio >= wanted
    for size in (SMALL, MIDDLE):
        ours = _seconds(records, "silhouette", size, own)
        arithmetic = _seconds(records, "limit", size, "arithmetic")
        if ours and arithmetic:
            ratio = ours[0] / arithmetic[0]
            largest = max(_seconds(records, "limit", size, "arithmetic", "scatter", "memory"))
            told = f"{ratio:.1f}x; {ours[0] / largest:.1f}x the largest bound"
            yield f"{size[0]:,} points: within 4x of the arithmetic limit", told, ratio <= 4.0
    # What "auto" takes for one small cloud, whose refinement does not pay for loading the compiled loops.
    ours, theirs = _seconds(records, "silhouette", SMALL, "windowed"), _seconds(records, "silhouette", SMALL, "scatter 9x9")
    if ours and theirs:
        ratio = theirs[0] / ours[0]
        yield "1,024 points: what one refinement takes, windowed, no slower than scatter 9x9", f"{ratio:.2f}x", ratio >= 1.0


def _large(records: Records) -> Found:
    for record in records:
        own = record["what"] == "silhouette" and record["name"] == _own(records) and record["seconds"]
        if own and (record["points"], record["side"]) == LARGE:
            seconds, peak = record["seconds"]["median"], record["peak_memory_bytes"]
            found = f"{seconds:.2f} s" + (f", {peak / 2**20:.0f} MiB" if peak is not None else "")
            holds = seconds < 2.0 and (peak or 0) < 2**30
            yield "1,000,000 points at 1,024x1,024 in under 2 s and 1 GiB", found, holds


def _growth(records: Records) -> Found:
    for by in ("points", "pixels"):
        found = next((record for record in records if record["what"] == f"growth, {by}"), None)
        if found:
            told = f"{found['slope']:.2f}, between neighbouring sizes at most {found['steepest']:.2f}"
            yield f"cost against {by} grows with slope <= 1.1 in log-log", told, found["slope"] <= 1.1


def _chamfer(records: Records) -> Found:
    ours = _seconds(records, "chamfer", (16384, None), "tso")
    trees = _seconds(records, "chamfer", (16384, None), "two k-d trees a step, 1 worker", "two k-d trees a step, all workers")
    if ours and trees:
        ratio = min(trees) / ours[0]
        yield "Chamfer of 16,384 points at least 5x faster than two k-d trees a step", f"{ratio:.1f}x", ratio >= 5.0


def _terms(records: Records) -> Found:
    found = [record for record in records if record["what"] == "terms"]
    if found:
        worst = max(found, key=lambda record: record["over_projector"])
        told = f"{worst['name']}, {worst['points']:,} points: {worst['over_projector']:.2f}x"
        yield "no term costs more than 3x the projector", told, worst["over_projector"] <= 3.0


def _network(records: Records) -> Found:
    for mode in ("encoder", "encoder-decoder"):
        found = next((record for record in records if record["what"] == f"step, {mode}"), None)
        if found:
            claim = f"{mode}: projector and losses add at most 30 % to the bare network's step"
            yield claim, f"{100.0 * found['added']:.0f} %", found["added"] <= 0.3


def _batch(records: Records) -> Found:
    found = [record for record in records if record["what"] == "batch" and record["name"] == "refine_batch"]
    for preset in dict.fromkeys(record["preset"] for record in found):
        record = max((r for r in found if r["preset"] == preset), key=lambda r: r["batch"])
        size, ratio, least = record["batch"], record["times_refine"], 1.0 if record["device"] == "cpu" else 5.0
        told = f"{ratio:.1f}x the throughput"
        yield f"{preset}: {size} clouds in one call at least {least:.0f}x the throughput of {size} calls", told, ratio >= least


def _start_up(records: Records) -> Found:
    found = {record["name"]: record["seconds"]["median"] for record in records if record["what"] == "start-up"}
    refine = found.get("tso refine --mode points")
    for name in ("tso --version", "tso --help"):
        if name in found and "python" in found:
            over = found[name] - found["python"]
            yield f"{name} under 0.15 s above bare Python", f"{over:.2f} s", over < 0.15
    if refine and "import torch" in found:
        allowed = 1.25 * found["import torch"] + 0.2
        yield (
            "tso refine --mode points at most 1.25x `import torch` plus 0.2 s",
            f"{refine:.2f} of {allowed:.2f} s",
            refine <= allowed,
        )
    for size, name in (("1,024", "tso refine --mode points"), ("16,384", "tso refine --mode points, 16,384 points")):
        warm, first = found.get(name), found.get(f"{name}, first")
        if warm and first:
            yield f"{size} points: the first run ever under 2x any other", f"{first / warm:.2f}x", first < 2.0 * warm
