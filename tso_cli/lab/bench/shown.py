"""The record of `tso lab speed` as tables and chart."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from ..charts import digits, draw_bars
from ..study import Cases, Record, Table, crossed

Label = Callable[[Record], str]
Value = TypeVar("Value", str, float)
PANELS = {
    "object": "one object, in process",
    "silhouette": "silhouette and cross-entropy, value and gradient",
    "chamfer": "Chamfer to the start, a step, value and gradient",
}


def machine_line(record: Record) -> str:
    """Where and with what the record was made."""
    settings, machine = record["settings"], record["settings"]["machine"]
    found = settings["versions"].items()
    versions = ", ".join(f"{name} {version}" for name, version in found if version)
    sizes = ", ".join(f"{size:,} MB {what}" for what, size in settings["installed_MB"].items())
    measured = f"seed {settings['seed']}, {record['seconds']:.0f} s"
    return f"{machine['cpu']}, {machine['cores']} cores; {versions}; installed: {sizes}; {measured}"


def tables(record: Record) -> list[Table]:
    """A table of each part that was measured; the last says where the record was made."""

    def of(what: str, key: str = "what") -> Cases:
        return [r for r in record["cases"] if r["what"] == what and r["seconds"] and r.get(key)]

    commands = [
        [r["name"], *(f"{r['seconds'][key]:.2f}" for key in ("median", "low", "high"))]
        + [f"{r['over_import_torch']:.2f}"]
        for r in of("command")
    ]
    large = [
        [r["name"], r["points"], f"{r['seconds']['median']:.2f}", f"{r['over_import_torch']:.1f}"]
        + [r["peak_MiB"]]
        for r in of("large", "points")
    ]
    large_header = ["", "points or faces", "s", "x `import torch`", "peak, MiB"]
    objects = _pivot(of("object", "preset"), lambda r: _over(r, r["over_import_torch"]))
    batches = _pivot(
        of("batch", "preset"),
        lambda r: f"{_ms(r)} ({r['over_import_torch']:.3f}x)",
        lambda r: f"{r['preset']}, {_size(r)}: {r['name']}",
        lambda r: f"processes: {r['processes']}",
    )
    losses = {"silhouette": "silhouette", "chamfer": "Chamfer to the start"}
    measured = [
        Table(["", "median", "low", "high", "x `import torch`"], commands, "whole processes: s"),
        Table(large_header, large, "large files, whole processes"),
        crossed(objects, title="one object: ms (x `import torch`)"),
        crossed(batches, title="many objects: ms each (x `import torch`)"),
        *(
            crossed(
                _pivot(of(what), lambda r: _over(r, r["over_tso"])),
                title=f"{title}, value and gradient: ms (x tso's)",
            )
            for what, title in losses.items()
        ),
        Table(["measured on"], [[machine_line(record)]]),
    ]
    return [table for table in measured if table.rows]


def _size(record: Record) -> str:
    side, views = record["side"], record.get("views", 1)
    pixels = f"@{side}" if side else ""
    return f"{record['points']:,}{pixels}" + (f", {views} views" if views > 1 else "")


def _ms(record: Record) -> str:
    return digits(1e3 * record["seconds"]["median"])


def _over(record: Record, ratio: float) -> str:
    return f"{_ms(record)} ({digits(ratio)}x)"


def _pivot(
    records: Cases,
    cell: Callable[[Record], Value],
    row: Label = lambda r: str(r["name"]),
    column: Label = _size,
) -> dict[str, dict[str, Value]]:
    """Cells by the labels of row and column, by default a name and a size."""
    cells: dict[str, dict[str, Value]] = {}
    for record in records:
        cells.setdefault(row(record), {})[column(record)] = cell(record)
    return cells


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """A panel for each part with growing sizes: median milliseconds."""
    measured = [r for r in record["cases"] if r["seconds"] and r["points"] and r.get("form") != ""]
    panels = {
        f"{title}, ms": _pivot(
            [r for r in measured if r["what"] == what],
            lambda r: 1e3 * r["seconds"]["median"],
            _size,
            lambda r: str(r["name"]),
        )
        for what, title in PANELS.items()
    }
    draw_bars(path, {title: rows for title, rows in panels.items() if rows}, overwrite, log=True)
