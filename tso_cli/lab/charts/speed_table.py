"""The record of `tso bench speed` as tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ..study import Table

Record = dict[str, Any]
Records = Sequence[Record]
Label = Callable[[Record], str]


def machine_line(record: Record) -> str:
    """Where and with what the record was made."""
    machine = record["machine"]
    versions = ", ".join(f"{name} {version}" for name, version in record["versions"].items() if version)
    return f"{machine['cpu']}, {machine['cores']} cores; {versions}; seed {record['seed']}, {record['seconds']:.0f} s"


def tables(record: Record) -> list[Table]:
    """Of whatever was measured; the last says what was left out, and where the record was made."""

    def of(what: str) -> Records:
        return [r for r in record["records"] if r["what"] == what and r["seconds"]]

    objects, batches = ([r for r in of(what) if "preset" in r] for what in ("object", "batch"))
    commands = [[r["name"], *_quartiles(r), f"{r['over_import_torch']:.2f}"] for r in of("command")]
    left_out: dict[str, list[str]] = {}
    for r in record["records"]:
        if "left_out" in r:
            left_out.setdefault(f"{r['what']}, {r['name']}: {r['left_out']}", []).append(_size(r))
    measured = [
        Table(["", "median", "low", "high", "x `import torch`"], commands, "whole processes: s"),
        _pivot("one object: ms (x `import torch`)", objects, _ms_and("over_import_torch")),
        _pivot(
            "phases of one object, prepare + optimise + judge: ms",
            [r for r in objects if "phases" in r],
            lambda r: " + ".join(_digits(1e3 * r["phases"][phase]) for phase in ("prepare", "optimise", "judge")),
        ),
        _pivot(
            "peak memory of a process with one call: MiB",
            [r for r in objects if r.get("peak_memory_bytes")],
            lambda r: f"{r['peak_memory_bytes'] / 2**20:,.0f}",
        ),
        _pivot(
            "parts of the default preset: ms (share of a refinement)",
            of("parts"),
            lambda r: f"{_ms(r)} ({100.0 * r['of_refine']:.0f} %)",
            column=lambda r: f"{r['points']:,}, {r['form']}",
        ),
        _pivot(
            "many objects: ms each (x `import torch`, x one `refine`)",
            batches,
            lambda r: f"{_ms(r)} ({r['over_import_torch']:.3f}x, {r['over_refine']:.2f}x)",
            lambda r: f"{r['preset']}, {r['name']}",
            lambda r: f"processes: {r['processes']}",
        ),
        _pivot("silhouette, value and gradient: ms (x tso's)", of("silhouette"), _ms_and("over_tso")),
        _pivot("Chamfer to the start, value and gradient: ms (x tso's)", of("chamfer"), _ms_and("over_tso")),
        _pivot("training: images a second", of("training"), _images, column=lambda r: str(r["precision"])),
        Table(["left out", "points"], [[label, ", ".join(sizes)] for label, sizes in left_out.items()]),
        Table(["measured on"], [[machine_line(record)]]),
    ]
    return [table for table in measured if table.rows]


def _size(record: Record) -> str:
    views = record.get("views", 1)
    return (
        f"{record['points']:,}" + (f"@{record['side']}" if record["side"] else "") + (f", {views} views" if views > 1 else "")
    )


def _quartiles(record: Record) -> list[str]:
    return [f"{record['seconds'][key]:.2f}" for key in ("median", "low", "high")]


def _ms(record: Record) -> str:
    return _digits(1e3 * record["seconds"]["median"])


def _ms_and(ratio: str) -> Label:
    return lambda record: f"{_ms(record)} ({_digits(record[ratio])}x)"


def _images(record: Record) -> str:
    """Images a second; of a whole step also what projector and losses add, and the share of it that waits for data."""
    whole = record["name"].endswith("step")
    shares = f" ({100 * record['added']:+.0f} %, waits {100 * record['waiting']:.1f} %)" if whole else ""
    return _digits(record["images_per_second"]) + shares


def _digits(value: float) -> str:
    """Three digits, without powers of ten."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _pivot(title: str, records: Records, cell: Label, row: Label = lambda r: str(r["name"]), column: Label = _size) -> Table:
    """A table of cells; ``row`` and ``column`` are their labels, by default a name and a size."""
    cells: dict[str, dict[str, str]] = {}
    for record in records:
        cells.setdefault(row(record), {})[column(record)] = cell(record)
    columns = list(dict.fromkeys(label for values in cells.values() for label in values))
    return Table(["", *columns], [[label, *map(values.get, columns)] for label, values in cells.items()], title)
