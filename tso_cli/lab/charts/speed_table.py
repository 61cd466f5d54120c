"""The record of `tso bench speed` as tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ..study import Table

Record = dict[str, Any]
Records = Sequence[Record]


def machine_line(record: Record) -> str:
    """Where and with what the record was made."""
    machine = record["machine"]
    on = f"{machine['gpu']}, {machine['cpu']}" if machine["gpu"] else machine["cpu"]
    versions = ", ".join(f"{name} {version}" for name, version in record["versions"].items() if version)
    threads = f"{record['threads']} thread{'s' if record['threads'] > 1 else ''}"
    run = f"seed {record['seed']}, {record['seconds']:.0f} s"
    return f"{on}, {machine['cores']} cores, {threads}, {record['device']}; {versions}; {run}"


def left_out(records: Records) -> list[list[str]]:
    """Contestants without a measurement, and why."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for record in records:
        if reason := record.get("left_out"):
            size = "" if reason == "not installed" else f" ({_size(record)})"
            reasons.setdefault((record["what"], record["name"]), []).append(reason + size)
    return [[f"{what}, {name}", "; ".join(dict.fromkeys(lines))] for (what, name), lines in reasons.items()]


def tables(record: Record) -> list[Table]:
    """Of whatever was measured; the last says what was left out, and where the record was made."""
    records = [r for r in record["records"] if r["seconds"]]

    def of(*whats: str) -> Records:
        return [r for r in records if r["what"] in whats]

    measured = [
        _pivot("silhouette, forward and backward: ms (x tso's)", of("silhouette"), _ms_and("over_tso")),
        _pivot("Chamfer to the start, a step: ms (x tso's)", of("chamfer"), _ms_and("over_tso")),
        _pivot("value and gradient: ms (x the projector)", of("terms"), _ms_and("over_projector")),
        _pivot("a step: ms", of("step, encoder", "step, encoder-decoder"), _ms, "{what}", "{name}"),
        _pivot("1,024 points: ms a cloud (x `refine`'s rate)", of("batch"), _batch, "{preset}, {name}", "batch {batch}"),
        Table(
            ["", "median", "low", "high"],
            [[r["name"], *(f"{r['seconds'][key]:.2f}" for key in ("median", "low", "high"))] for r in of("start-up")],
            "whole processes: s",
        ),
        Table(["left out", "why"], left_out(record["records"])),
        Table(["measured on"], [[machine_line(record)]]),
    ]
    return [table for table in measured if table.rows]


def _size(record: Record) -> str:
    return f"{record['points']:,}" + (f"@{record['side']}" if record["side"] else "")


def _ms(record: Record) -> str:
    return _digits(1e3 * record["seconds"]["median"])


def _batch(record: Record) -> str:
    return f"{_ms(record)} ({record['times_refine']:.1f}x)"


def _digits(value: float) -> str:
    """Three digits, without powers of ten."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _ms_and(ratio: str) -> Callable[[Record], str]:
    return lambda record: _ms(record) + (f" ({_digits(record[ratio])}x)" if ratio in record else "")


def _pivot(
    title: str, records: Records, cell: Callable[[Record], str], row: str = "{name}", column: str | None = None
) -> Table:
    """A table of cells; ``row`` and ``column`` are templates of their labels, by default a column is a size."""
    cells: dict[str, dict[str, str]] = {}
    for record in records:
        label = column.format(**record) if column else _size(record)
        cells.setdefault(row.format(**record), {})[label] = cell(record)
    columns = list(dict.fromkeys(label for values in cells.values() for label in values))
    return Table(["", *columns], [[label, *map(values.get, columns)] for label, values in cells.items()], title)
