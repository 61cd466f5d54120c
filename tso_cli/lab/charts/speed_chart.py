"""The chart of `tso bench speed`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ...plots.style import COLOURS, INK, PALE, page
from .speed_table import machine_line

Record = dict[str, Any]
Records = Sequence[Record]
Panel = Callable[[Any, Records], None]
MARKERS = "osD^vP*Xh"


def draw_speed(path: Path, record: Record, overwrite: bool = False) -> None:
    """A panel for each part that was measured but training: lines where sizes grow, dots elsewhere.

    Raises InputError if ``path`` cannot be written to.
    """
    measured = [r for r in record["records"] if r["seconds"]]
    panels = [(panel, rows) for what, panel in PANELS.items() if (rows := [r for r in measured if r["what"] == what])]
    columns = min(3, len(panels)) or 1
    rows_of_panels = -(-len(panels) // columns) or 1
    with page(path, overwrite, (max(7.0, 5.6 * columns), 0.4 + 4.6 * rows_of_panels)) as figure:
        axes = figure.subplots(rows_of_panels, columns, squeeze=False).flatten()
        for axis in axes[len(panels) :]:
            axis.remove()
        for axis, (panel, rows) in zip(axes, panels, strict=False):
            panel(axis, rows)
            axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2, frameon=False, fontsize=8)
        figure.suptitle(machine_line(record).partition(";")[0], fontsize=11, color=INK)


def _lines(title: str) -> Panel:
    """Each contestant's median and quartiles over the number of points; `import torch`, if there, as a level."""

    def panel(axis: Any, records: Records) -> None:
        series = [r for r in records if r["points"] and r.get("views", 1) == 1 and r.get("call") != "first"]
        for i, name in enumerate(dict.fromkeys(r["name"] for r in series)):
            rows = [r for r in series if r["name"] == name]
            colour, sizes = [*COLOURS, "#8c6d31", "#7f7f7f", "#9467bd"][i % 9], [r["points"] for r in rows]
            low, median, high = ([1e3 * r["seconds"][key] for r in rows] for key in ("low", "median", "high"))
            axis.plot(sizes, median, label=name, color=colour, marker=MARKERS[i % 9], markersize=5, linewidth=1.4 if i else 2.5)
            axis.fill_between(sizes, low, high, color=colour, alpha=0.15, linewidth=0)
        for r in records:
            if not r["points"]:
                axis.axhline(1e3 * r["seconds"]["median"], label=r["name"], color=PALE, linestyle="--")
        axis.set(title=title, xlabel="points", ylabel="ms", xscale="log", yscale="log")
        ticks = dict.fromkeys((r["points"], r["side"]) for r in series)
        axis.set_xticks([n for n, _ in ticks], [f"{n:,}" + (f"\n{side}²" if side else "") for n, side in ticks], fontsize=8)
        axis.minorticks_off()
        axis.yaxis.set_major_formatter(lambda value, _: f"{value:g}")

    return panel


def _dots(title: str, label: Callable[[Record], str], series: Callable[[Record], str]) -> Panel:
    """A row for each label, from the top down, with a dot for each series: its median."""

    def panel(axis: Any, records: Records) -> None:
        labels = list(dict.fromkeys(map(label, records)))
        for i, name in enumerate(dict.fromkeys(map(series, records))):
            rows = [r for r in records if series(r) == name]
            values = [1e3 * r["seconds"]["median"] for r in rows]
            places = [labels.index(label(r)) for r in rows]
            axis.plot(values, places, MARKERS[i % 9], color=COLOURS[i % 6], label=name, markersize=6, alpha=0.8)
        axis.set_yticks(range(len(labels)), labels, fontsize=8)
        axis.set_ylim(len(labels) - 0.5, -0.5)
        axis.grid(axis="both", color=PALE, linewidth=0.5, alpha=0.6)
        axis.set(title=title, xlabel="ms", xscale="log")
        axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")

    return panel


PANELS: dict[str, Panel] = {
    "command": _dots(
        "whole processes", lambda r: r["name"].removesuffix(", first run"), lambda r: f"{r.get('call', 'steady')} run"
    ),
    "object": _lines("one object, in process"),
    "parts": _dots("parts of the default preset", lambda r: r["name"], lambda r: f"{r['points']:,} points, {r['form']}"),
    "batch": _dots(
        "many objects, ms each",
        lambda r: r["name"],
        lambda r: f"{r['preset']}, processes: {r['processes']}" if "preset" in r else r["name"],
    ),
    "silhouette": _lines("silhouette and cross-entropy, value and gradient"),
    "chamfer": _lines("Chamfer to the start, a step, value and gradient"),
}
