"""Targets for the speed, and whether a record meets them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ..study import claim
from .timing import Record, Records

# (target, whether it is met, what was measured)
Judged = Iterator[tuple[str, bool, str]]


def claims(records: Records) -> list[dict[str, Any]]:
    """A claim for every target that the records allow to judge."""
    return [claim(*judged) for judge in (_command, _object, _batch, _kernels) for judged in judge(records)]


def _chosen(records: Records, what: str, **fields: Any) -> list[Record]:
    rows = (row for row in records if row["what"] == what and row["seconds"])
    return [row for row in rows if all(row.get(key) == value for key, value in fields.items())]


def _command(records: Records) -> Judged:
    rows = _chosen(records, "command")
    seconds = {row["name"]: row["seconds"]["median"] for row in rows}
    for name in ("tso --version", "tso --help"):
        if name in seconds:
            more = seconds[name] - seconds["python"]
            yield f"{name}: at most 0.15 s more than bare Python", more <= 0.15, f"{more:.2f} s"
    for row in _chosen(rows, "command", call="steady", points=1024):
        ratio = row["over_import_torch"]
        yield "tso refine of 1,024 points: at most 0.35 of `import torch`", ratio <= 0.35, f"{ratio:.2f}"
    for first in _chosen(rows, "command", call="first"):
        (steady,) = _chosen(rows, "command", call="steady", points=first["points"])
        ratio = first["seconds"]["median"] / steady["seconds"]["median"]
        yield f"tso refine of {first['points']:,} points: the first run under twice any other", ratio < 2.0, f"{ratio:.2f}x"


def _object(records: Records) -> Judged:
    for points, most in ((1024, 0.15), (16384, 0.25)):
        rows = _chosen(records, "object", points=points, preset="best", views=1, call="steady")
        if rows:
            ratio = min(row["over_import_torch"] for row in rows)
            yield f"one object of {points:,} points: at most {most} of `import torch`", ratio <= most, f"{ratio:.2f}"


def _batch(records: Records) -> Judged:
    rows = [row for row in _chosen(records, "batch") if row.get("batch", 1) > 1]
    most_processes = max((row["processes"] for row in rows), default=1)
    for row in _chosen(rows, "batch", preset="best", batch=64, processes=most_processes, busy=False):
        ratio = row["over_import_torch"]
        yield "an object in a batch of 64: at most 0.04 of `import torch`", ratio <= 0.04, f"{ratio:.3f}"
    for busy, most, target in (
        (False, 1.0, "a batch is never slower on all cores than on one"),
        (True, 1.5, "beside a busy neighbour a batch on all cores takes at most 1.5x one process"),
    ):
        seconds = {
            (row["preset"], row["batch"], row["processes"]): row["seconds"]["median"]
            for row in _chosen(rows, "batch", busy=busy)
        }
        ratios = [taken / seconds[preset, size, 1] for (preset, size, count), taken in seconds.items() if count > 1]
        if ratios:
            yield target, max(ratios) <= most, f"{max(ratios):.2f}x at worst"


def _kernels(records: Records) -> Judged:
    for what, points, peer, factor in (
        ("silhouette", 1024, "scatter 9x9", 4.0),
        ("silhouette", 16384, "scatter 9x9", 4.0),
        ("chamfer", 16384, "two k-d trees a step", 5.0),
    ):
        rows = _chosen(records, what, points=points)
        ours, theirs = ([row["seconds"]["median"] for row in rows if row["name"].startswith(name)] for name in ("tso", peer))
        if ours and theirs:
            ratio = min(theirs) / min(ours)
            yield f"{what} of {points:,} points: at least {factor:g}x faster than {peer}", ratio >= factor, f"{ratio:.1f}x"
