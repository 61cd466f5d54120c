"""The record of `tso bench speed` as tables and chart."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...plots.style import COLOURS, INK, PALE, page
from ...plots.table import Cell
from ..study import Cases, Record, Table

Label = Callable[[Record], str]
MARKERS = "osD^vP*Xh"


def machine_line(record: Record) -> str:
    """Where and with what the record was made."""
    settings = record["settings"]
    machine = settings["machine"]
    versions = ", ".join(
        f"{name} {version}" for name, version in settings["versions"].items() if version
    )
    installed = ", ".join(
        f"{megabytes:,} MB {what}" for what, megabytes in settings["installed_MB"].items()
    )
    measured = f"seed {settings['seed']}, {record['seconds']:.0f} s"
    return f"{machine['cpu']}, {machine['cores']} cores; {versions}; installed: {installed}; {measured}"


def tables(record: Record) -> list[Table]:
    """Of whatever was measured; the last says what was left out, and where the record was made."""

    def of(what: str) -> Cases:
        return [r for r in record["cases"] if r["what"] == what and r["seconds"]]

    objects, batches = ([r for r in of(what) if "preset" in r] for what in ("object", "batch"))
    commands = [
        [
            r["name"],
            *(f"{r['seconds'][key]:.2f}" for key in ("median", "low", "high")),
            f"{r['over_import_torch']:.2f}",
        ]
        for r in of("command")
    ]
    large = [
        [
            r["name"],
            r["points"],
            f"{r['seconds']['median']:.2f}",
            f"{r['over_import_torch']:.1f}",
            r["peak_MiB"],
        ]
        for r in of("large")
        if r["points"]
    ]
    left_out: dict[str, list[str]] = {}
    for r in record["cases"]:
        if "left_out" in r:
            left_out.setdefault(f"{r['what']}, {r['name']}: {r['left_out']}", []).append(_size(r))
    measured = [
        Table(["", "median", "low", "high", "x `import torch`"], commands, "whole processes: s"),
        Table(
            ["", "points or faces", "s", "x `import torch`", "peak, MiB"],
            large,
            "large files, whole processes",
        ),
        _pivot(
            "one object: ms (x `import torch`)",
            objects,
            lambda r: f"{_ms(r)} ({_digits(r['over_import_torch'])}x)",
        ),
        _table("the default, phase by phase: ms", {_scene(r): _phases(r) for r in of("phases")}),
        _table(
            "of these: ms",
            {_scene(r): _in_ms(r["of_these"]) for r in of("phases") if "of_these" in r},
        ),
        _pivot(
            "many objects: ms each (x `import torch`, x one `refine`)",
            batches,
            lambda r: f"{_ms(r)} ({r['over_import_torch']:.3f}x, {r['over_refine']:.2f}x)",
            lambda r: f"{r['preset']}, {_size(r)}: {r['name']}",
            lambda r: f"processes: {r['processes']}",
        ),
        *(
            _pivot(
                f"{title}, value and gradient: ms (x tso's)",
                of(what),
                lambda r: f"{_ms(r)} ({_digits(r['over_tso'])}x)",
            )
            for title, what in (("silhouette", "silhouette"), ("Chamfer to the start", "chamfer"))
        ),
        Table(
            ["left out", "points"], [[label, ", ".join(sizes)] for label, sizes in left_out.items()]
        ),
        Table(["measured on"], [[machine_line(record)]]),
    ]
    return [table for table in measured if table.rows]


def _phases(record: Record) -> dict[str, Cell]:
    whole = {"all": record["seconds"]["median"], "first call": record["first"]}
    return _in_ms(record["phases"] | whole) | {"peak, MiB": record["peak_MiB"]}


def _in_ms(seconds: dict[str, float]) -> dict[str, Cell]:
    return {name: _digits(1e3 * value) for name, value in seconds.items()}


def _scene(record: Record) -> str:
    return _size(record) + ", compiled" * (record.get("form") == "compiled")


def _size(record: Record) -> str:
    side, views = record["side"], record.get("views", 1)
    return (
        f"{record['points']:,}"
        + (f"@{side}" if side else "")
        + (f", {views} views" if views > 1 else "")
    )


def _ms(record: Record) -> str:
    return _digits(1e3 * record["seconds"]["median"])


def _digits(value: float) -> str:
    """Three digits, without powers of ten."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _pivot(
    title: str,
    records: Cases,
    cell: Label,
    row: Label = lambda r: str(r["name"]),
    column: Label = _size,
) -> Table:
    """A table of cells; ``row`` and ``column`` are their labels, by default a name and a size."""
    cells: dict[str, dict[str, Cell]] = {}
    for record in records:
        cells.setdefault(row(record), {})[column(record)] = cell(record)
    return _table(title, cells)


def _table(title: str, cells: dict[str, dict[str, Cell]]) -> Table:
    """Of cells by the labels of row and column."""
    columns = list(dict.fromkeys(label for values in cells.values() for label in values))
    return Table(
        ["", *columns],
        [[label, *map(values.get, columns)] for label, values in cells.items()],
        title,
    )


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """A panel for each part of which sizes grow: medians and quartiles of each contestant; `import torch` as a level."""
    measured = [r for r in record["cases"] if r["seconds"] and r.get("form") != ""]
    panels = [
        (title, rows)
        for what, title in PANELS.items()
        if (rows := [r for r in measured if r["what"] == what])
    ]
    with page(path, overwrite, (max(7.0, 5.6 * len(panels)), 5.0)) as figure:
        for number, (title, rows) in enumerate(panels, 1):
            axis = figure.add_subplot(1, len(panels), number)
            axis.set(title=title, xlabel="points", ylabel="ms", xscale="log", yscale="log")
            _draw_lines(axis, rows)
            axis.legend(
                loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2, frameon=False, fontsize=8
            )
        figure.suptitle(machine_line(record).partition(";")[0], fontsize=11, color=INK)


def _draw_lines(axis: Any, records: Cases) -> None:
    series = [r for r in records if r["points"] and r.get("views", 1) == 1]
    for i, name in enumerate(dict.fromkeys(r["name"] for r in series)):
        rows = [r for r in series if r["name"] == name]
        colour, sizes = (
            [*COLOURS, "#8c6d31", "#7f7f7f", "#9467bd"][i % 9],
            [r["points"] for r in rows],
        )
        low, median, high = (
            [1e3 * r["seconds"][key] for r in rows] for key in ("low", "median", "high")
        )
        axis.plot(
            sizes,
            median,
            label=name,
            color=colour,
            marker=MARKERS[i % 9],
            markersize=5,
            linewidth=1.4 if i else 2.5,
        )
        axis.fill_between(sizes, low, high, color=colour, alpha=0.15, linewidth=0)
    for r in records:
        if not r["points"]:
            axis.axhline(1e3 * r["seconds"]["median"], label=r["name"], color=PALE, linestyle="--")
    ticks = dict.fromkeys((r["points"], r["side"]) for r in series)
    axis.set_xticks(
        [n for n, _ in ticks],
        [f"{n:,}" + (f"\n{side}²" if side else "") for n, side in ticks],
        fontsize=8,
    )
    axis.minorticks_off()
    axis.yaxis.set_major_formatter(lambda value, _: f"{value:g}")


PANELS = {
    "object": "one object, in process",
    "silhouette": "silhouette and cross-entropy, value and gradient",
    "chamfer": "Chamfer to the start, a step, value and gradient",
}
