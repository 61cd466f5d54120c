"""Targets for the speed, and whether a record meets them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from ..study import claim
from .timing import Record, Records


def claims(records: Records) -> list[dict[str, Any]]:
    """A claim for every target that the records allow to judge."""
    measured = [row | {"median": row["seconds"]["median"]} for row in records if row["seconds"]]

    def chosen(what: str, **fields: Any) -> list[Record]:
        return [row for row in measured if row["what"] == what and fields.items() <= row.items()]

    return [claim(*judged) for judged in _judged(chosen)]


def _judged(chosen: Callable[..., Records]) -> Iterator[tuple[str, bool, str]]:
    """(target, whether it is met, what was measured)."""
    seconds = {row["name"]: row["median"] for row in chosen("command")}
    for name in ("tso --version", "tso --help"):
        if name in seconds:
            more = seconds[name] - seconds["python"]
            yield f"{name}: at most 0.15 s more than bare Python", more <= 0.15, f"{more:.2f} s"
    for row in chosen("command", call="steady", points=1024):
        ratio = row["over_import_torch"]
        yield "tso refine of 1,024 points: at most 0.35 of `import torch`", ratio <= 0.35, f"{ratio:.2f}"
    for first in chosen("command", call="first"):
        (steady,) = chosen("command", call="steady", points=first["points"])
        ratio = first["median"] / steady["median"]
        yield f"tso refine of {first['points']:,} points: the first run under twice any other", ratio < 2.0, f"{ratio:.2f}x"

    for points, most in ((1024, 0.15), (16384, 0.25)):
        if rows := chosen("object", points=points, preset="best", views=1, call="steady"):
            ratio = min(row["over_import_torch"] for row in rows)
            yield f"one object of {points:,} points: at most {most} of `import torch`", ratio <= most, f"{ratio:.2f}"

    batches = [row for row in chosen("batch") if row.get("batch", 1) > 1]
    most_processes = max((row["processes"] for row in batches), default=1)
    for row in chosen("batch", preset="best", batch=64, processes=most_processes, busy=False):
        ratio = row["over_import_torch"]
        yield "an object in a batch of 64: at most 0.04 of `import torch`", ratio <= 0.04, f"{ratio:.3f}"
    for busy, most, target in (
        (False, 1.0, "a batch is never slower on all cores than on one"),
        (True, 1.5, "beside a busy neighbour a batch on all cores takes at most 1.5x one process"),
    ):
        taken = {(row["preset"], row["batch"], row["processes"]): row["median"] for row in batches if row["busy"] == busy}
        if ratios := [value / taken[preset, size, 1] for (preset, size, count), value in taken.items() if count > 1]:
            yield target, max(ratios) <= most, f"{max(ratios):.2f}x at worst"

    for what, points, peer, factor in (
        ("silhouette", 1024, "scatter 9x9", 4.0),
        ("silhouette", 16384, "scatter 9x9", 4.0),
        ("chamfer", 16384, "two k-d trees a step", 5.0),
    ):
        rows = chosen(what, points=points)
        ours, theirs = ([row["median"] for row in rows if row["name"].startswith(name)] for name in ("tso", peer))
        if ours and theirs:
            ratio = min(theirs) / min(ours)
            yield f"{what} of {points:,} points: at least {factor:g}x faster than {peer}", ratio >= factor, f"{ratio:.1f}x"
