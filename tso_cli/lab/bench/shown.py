"""The record of `tso lab speed` as tables and chart."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...plots.style import COLOURS, INK, PALE, page
from ...plots.table import Cell
from ..study import Cases, Record, Table

Label = Callable[[Record], str]
MARKERS = "osD^vP*Xh"
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
        lambda r: f"{_ms(r)} ({r['over_import_torch']:.3f}x, {r['over_refine']:.2f}x)",
        lambda r: f"{r['preset']}, {_size(r)}: {r['name']}",
        lambda r: f"processes: {r['processes']}",
    )
    losses = {"silhouette": "silhouette", "chamfer": "Chamfer to the start"}
    measured = [
        Table(["", "median", "low", "high", "x `import torch`"], commands, "whole processes: s"),
        Table(large_header, large, "large files, whole processes"),
        _table("one object: ms (x `import torch`)", objects),
        _table("the default, phase by phase: ms", {_scene(r): _phases(r) for r in of("phases")}),
        _table("many objects: ms each (x `import torch`, x one `refine`)", batches),
        *(
            _table(
                f"{title}, value and gradient: ms (x tso's)",
                _pivot(of(what), lambda r: _over(r, r["over_tso"])),
            )
            for what, title in losses.items()
        ),
        Table(["measured on"], [[machine_line(record)]]),
    ]
    return [table for table in measured if table.rows]


def _phases(record: Record) -> dict[str, Cell]:
    whole = {"all": record["seconds"]["median"], "first call": record["first"]}
    times = {name: _digits(1e3 * value) for name, value in (record["phases"] | whole).items()}
    return {**times, "peak, MiB": record["peak_MiB"]}


def _scene(record: Record) -> str:
    return _size(record) + (", compiled" if record.get("form") == "compiled" else "")


def _size(record: Record) -> str:
    side, views = record["side"], record.get("views", 1)
    pixels = f"@{side}" if side else ""
    return f"{record['points']:,}{pixels}" + (f", {views} views" if views > 1 else "")


def _ms(record: Record) -> str:
    return _digits(1e3 * record["seconds"]["median"])


def _over(record: Record, ratio: float) -> str:
    return f"{_ms(record)} ({_digits(ratio)}x)"


def _digits(value: float) -> str:
    """Three digits, without powers of ten."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _pivot(
    records: Cases, cell: Label, row: Label = lambda r: str(r["name"]), column: Label = _size
) -> dict[str, dict[str, Cell]]:
    """Cells by the labels of row and column, by default a name and a size."""
    cells: dict[str, dict[str, Cell]] = {}
    for record in records:
        cells.setdefault(row(record), {})[column(record)] = cell(record)
    return cells


def _table(title: str, cells: dict[str, dict[str, Cell]]) -> Table:
    columns = list(dict.fromkeys(label for values in cells.values() for label in values))
    rows = [[label, *map(values.get, columns)] for label, values in cells.items()]
    return Table(["", *columns], rows, title)


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """A panel for each part with growing sizes: medians and quartiles; dashed: `import torch`."""
    measured = [r for r in record["cases"] if r["seconds"] and r.get("form") != ""]
    panels = {title: [r for r in measured if r["what"] == what] for what, title in PANELS.items()}
    panels = {title: rows for title, rows in panels.items() if rows}
    legend = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.17), "ncols": 2}
    with page(path, overwrite, (max(7.0, 5.6 * len(panels)), 5.0)) as figure:
        for number, (title, rows) in enumerate(panels.items(), 1):
            axis = figure.add_subplot(1, len(panels), number)
            axis.set(title=title, xlabel="points", ylabel="ms", xscale="log", yscale="log")
            _draw_lines(axis, rows)
            axis.legend(**legend, frameon=False, fontsize=8)
        figure.suptitle(machine_line(record).partition(";")[0], fontsize=11, color=INK)


def _draw_lines(axis: Any, records: Cases) -> None:
    series = [r for r in records if r["points"] and r.get("views", 1) == 1]
    colours = [*COLOURS, "#8c6d31", "#7f7f7f", "#9467bd"]
    for i, name in enumerate(dict.fromkeys(r["name"] for r in series)):
        rows = [r for r in series if r["name"] == name]
        sizes = [r["points"] for r in rows]
        low, median, high = (
            [1e3 * r["seconds"][k] for r in rows] for k in ("low", "median", "high")
        )
        style = {"color": colours[i % 9], "marker": MARKERS[i % 9], "markersize": 5}
        axis.plot(sizes, median, label=name, linewidth=1.4 if i else 2.5, **style)
        axis.fill_between(sizes, low, high, color=colours[i % 9], alpha=0.15, linewidth=0)
    for r in records:
        if not r["points"]:
            axis.axhline(1e3 * r["seconds"]["median"], label=r["name"], color=PALE, linestyle="--")
    ticks = dict.fromkeys((r["points"], r["side"]) for r in series)
    labels = [f"{n:,}" + (f"\n{side}²" if side else "") for n, side in ticks]
    axis.set_xticks([n for n, _ in ticks], labels, fontsize=8)
    axis.minorticks_off()
    axis.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
