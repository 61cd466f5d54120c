"""The chart of `tso bench speed`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ...plots.style import BETTER, COLOURS, INK, page
from .speed_table import machine_line

MARKERS = "osD^vP*Xh"
Records = Sequence[dict[str, Any]]
Panel = Callable[[Any, Records], None]


def draw_speed(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Kernels over sizes as lines; many clouds and whole processes as bars.

    Raises InputError if ``path`` cannot be written to.
    """
    measured = [r for r in record["records"] if r["seconds"]]
    panels = [(panel, rows) for what, panel in PANELS.items() if (rows := [r for r in measured if r["what"] == what])]
    columns = min(2, len(panels)) or 1
    rows_of_panels = -(-len(panels) // columns) or 1
    with page(path, overwrite, (max(7.0, 5.4 * columns), 0.4 + 4.6 * rows_of_panels)) as figure:
        axes = figure.subplots(rows_of_panels, columns, squeeze=False).flatten()
        for axis in axes[len(panels) :]:
            axis.remove()
        for axis, (panel, rows) in zip(axes, panels, strict=False):
            panel(axis, rows)
        figure.suptitle(machine_line(record).partition(";")[0], fontsize=11, color=INK)


def _lines(title: str) -> Panel:
    """A panel of each contestant's median and quartiles over the number of points."""

    def panel(axis: Any, records: Records) -> None:
        records = [r for r in records if "over_tso" in r]
        for i, name in enumerate(dict.fromkeys(r["name"] for r in records)):
            rows = [r for r in records if r["name"] == name]
            colour, sizes = [*COLOURS, "#8c6d31", "#7f7f7f", "#9467bd"][i % 9], [r["points"] for r in rows]
            low, median, high = ([1e3 * r["seconds"][key] for r in rows] for key in ("low", "median", "high"))
            axis.plot(sizes, median, label=name, color=colour, marker=MARKERS[i % 9], markersize=5, linewidth=1.4 if i else 2.5)
            axis.fill_between(sizes, low, high, color=colour, alpha=0.15, linewidth=0)
        axis.set(title=title, xlabel="points", ylabel="ms", xscale="log", yscale="log")
        ticks = dict.fromkeys((r["points"], r["side"]) for r in records)
        axis.set_xticks([n for n, _ in ticks], [_short(n) + (f"\n{side}²" if side else "") for n, side in ticks])
        axis.minorticks_off()
        axis.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2, frameon=False, fontsize=8)

    return panel


def _bars(title: str, label: str, name: Callable[[dict[str, Any]], str], value: str) -> Panel:
    """A panel of one bar a record, from the top down."""

    def panel(axis: Any, records: Records) -> None:
        values = [r["seconds"]["median"] if value == "seconds" else r[value] for r in records]
        bars = axis.barh(range(len(values)), values, color=BETTER, height=0.6)
        axis.bar_label(bars, [f"{v:.3g}" for v in values], padding=4, fontsize=8)
        axis.set_yticks(range(len(values)), [name(r) for r in records], fontsize=8)
        axis.set_xlim(0.0, 1.2 * max(values))
        axis.invert_yaxis()
        axis.set(title=title, xlabel=label)

    return panel


PANELS: dict[str, Panel] = {
    "silhouette": _lines("silhouette and cross-entropy, forward and backward"),
    "chamfer": _lines("Chamfer to the start, a step, value and gradient"),
    "batch": _bars(
        "many clouds", "clouds a second", lambda r: f"{r['name']} of {r['batch']}, {r['preset']}", "clouds_per_second"
    ),
    "start-up": _bars("whole processes", "seconds", lambda r: str(r["name"]), "seconds"),
}


def _short(count: int) -> str:
    """1024 -> 1,024; 65536 -> 65.5k; 1000000 -> 1M."""
    if count >= 1_000_000:
        return f"{count / 1e6:.3g}M"
    return f"{count:,}" if count < 10_000 else f"{count / 1e3:.3g}k"
