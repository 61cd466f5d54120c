"""The record of `tso bench speed` as tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ...plots.table import Cell, text_table

Record = dict[str, Any]
Records = Sequence[Record]


@dataclass(frozen=True)
class Section:
    """A table of what was measured under ``name``."""

    name: str
    title: str
    header: list[str]
    rows: list[list[Cell]]


def speed_table(record: Record) -> str:
    """All tables, what was left out, the targets, and the machine."""
    parts = [f"{section.title}\n{text_table(section.header, section.rows)}" for section in sections(record)]
    if left_out := left_out_lines(record["records"]):
        parts.append("left out:\n" + "\n".join(f"  {line}" for line in left_out))
    if record["claims"]:
        claims = [f"target {'met' if c['holds'] else 'missed'}: {c['claim']} ({c['found']})" for c in record["claims"]]
        parts.append("\n".join(claims))
    parts.append(machine_line(record))
    return "\n\n".join(parts)


def machine_line(record: Record) -> str:
    """Where and with what the record was made."""
    machine = record["machine"]
    on = f"{machine['gpu']}, {machine['cpu']}" if machine["gpu"] else machine["cpu"]
    versions = ", ".join(f"{name} {version}" for name, version in record["versions"].items() if version)
    threads = f"{record['threads']} thread{'s' if record['threads'] > 1 else ''}"
    run = f"seed {record['seed']}, {record['seconds']:.0f} s"
    return f"{on}, {machine['cores']} cores, {threads}, {record['device']}; {versions}; {run}"


def left_out_lines(records: Records) -> list[str]:
    """Contestants without a measurement, and why."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for record in records:
        if reason := record.get("left_out"):
            size = "" if reason == "not installed" else f" ({_size(record)})"
            reasons.setdefault((record["what"], record["name"]), []).append(reason + size)
    return [f"{what}, {name}: {'; '.join(dict.fromkeys(lines))}" for (what, name), lines in reasons.items()]


def sections(record: Record) -> list[Section]:
    """The tables of whatever was measured."""
    records = [r for r in record["records"] if r["seconds"]]

    def of(*whats: str) -> Records:
        return [r for r in records if r["what"] in whats]

    peaks = [r for r in records if r["peak_memory_bytes"] is not None]
    tables = [
        _pivot("silhouette", "silhouette, forward and backward: ms (x tso's)", of("silhouette"), _ms_and("over_tso")),
        _pivot("chamfer", "Chamfer to the start, a step: ms (x tso's)", of("chamfer"), _ms_and("over_tso")),
        _pivot("memory", "peak memory of a call: MiB", peaks, _mib, lambda r: f"{r['what']}: {r['name']}", _points),
        _pivot("terms", "value and gradient: ms (x the projector)", of("terms"), _ms_and("over_projector")),
        _pivot("step", "a step in points mode: ms (share of the whole)", of("step"), _ms_and_share),
        _pivot("network", "a step in the network modes: ms", of("step, encoder", "step, encoder-decoder"), _ms, _what, _name),
        Section(
            "batch",
            "clouds of 1,024 points, all steps and what is around them",
            ["preset", "call", "clouds", "ms a cloud", "clouds a second", "x `refine`"],
            [
                [r["preset"], r["name"], f"{r['batch']}", _ms(r), _digits(r["clouds_per_second"]), f"{r['times_refine']:.1f}x"]
                for r in of("batch")
            ],
        ),
        _pivot("threads", "on more threads: ms (times quicker)", of("threads"), _ms_and("over_first"), _work, _threads),
        Section(
            "training",
            "training: images a second",
            ["supervision", "precision", "", "images/s", "added", "waits for data"],
            [
                [_what(r), r["precision"], r["name"], _digits(r["images_per_second"]), *_shares(r)]
                for r in of("training, points", "training, masks")
            ],
        ),
        Section(
            "start-up",
            "whole processes: s",
            ["", "median", "low", "high"],
            [[r["name"], *(f"{r['seconds'][key]:.2f}" for key in ("median", "low", "high"))] for r in of("start-up")],
        ),
    ]
    return [table for table in tables if table.rows]


def _name(record: Record) -> str:
    return str(record["name"])


def _what(record: Record) -> str:
    """The mode or supervision, named in "what" behind the comma."""
    return str(record["what"].partition(", ")[2])


def _size(record: Record) -> str:
    return f"{record['points']:,}" + (f"@{record['side']}" if record["side"] else "")


def _points(record: Record) -> str:
    return f"{record['points']:,}"


def _work(record: Record) -> str:
    return f"{record['name']}, {_size(record)}"


def _threads(record: Record) -> str:
    return f"{record['threads']} thread{'s' if record['threads'] > 1 else ''}"


def _ms(record: Record) -> str:
    return _digits(1e3 * record["seconds"]["median"])


def _mib(record: Record) -> str:
    return f"{record['peak_memory_bytes'] / 2**20:,.1f}"


def _shares(record: Record) -> list[str]:
    """What projector and losses add, and how long the network waits: said of a whole step."""
    return [f"{100 * record['added']:.0f} %", f"{100 * record['waiting']:.1f} %"] if record["name"] == "step" else ["", ""]


def _digits(value: float) -> str:
    """Three digits, without powers of ten."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _ms_and(ratio: str) -> Callable[[Record], str]:
    return lambda record: _ms(record) + (f" ({_digits(record[ratio])}x)" if ratio in record else "")


def _ms_and_share(record: Record) -> str:
    return f"{_ms(record)} ({100.0 * record['share']:.0f} %)"


def _pivot(
    name: str,
    title: str,
    records: Records,
    cell: Callable[[Record], str],
    row: Callable[[Record], str] = _name,
    column: Callable[[Record], str] = _size,
) -> Section:
    columns = list(dict.fromkeys(map(column, records)))
    cells: dict[str, dict[str, str]] = {}
    for record in records:
        cells.setdefault(row(record), {})[column(record)] = cell(record)
    return Section(name, title, ["", *columns], [[label, *map(values.get, columns)] for label, values in cells.items()])
