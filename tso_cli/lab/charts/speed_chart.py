"""The chart of `tso bench speed`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...plots.style import BETTER, COLOURS, INK, page
from .speed_table import machine_line

MARKERS = "osD^vP*Xh"
KERNELS = {
    "silhouette": "silhouette and cross-entropy, forward and backward",
    "chamfer": "Chamfer to the start, a step, value and gradient",
}
"""Part -> the title of its panel of lines."""
BARS = (
    (("batch",), "many clouds: clouds a second", "{name} of {batch}, {preset}", "clouds_per_second"),
    (("step", "step, encoder", "step, encoder-decoder"), "a step and its parts: ms", "{name}, {what}, {points:,}", "ms"),
    (("terms",), "losses: times the projector", "{name}, {points:,}", "over_projector"),
    (("threads",), "more threads: times quicker", "{name}\n{threads} threads", "over_first"),
    (("training, points", "training, masks"), "images a second", "{what}, {precision}\n{name}", "images_per_second"),
    (("start-up",), "whole processes: ms", "{name}", "ms"),
)
"""Parts, title of their panel of bars, label of a bar, and its value."""


def draw_speed(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """A panel for each part that was measured: lines where sizes grow, bars elsewhere.

    Raises InputError if ``path`` cannot be written to.
    """
    measured = [{**r, "ms": 1e3 * r["seconds"]["median"]} for r in record["records"] if r["seconds"]]
    lines = [(title, [r for r in measured if r["what"] == what and "over_tso" in r]) for what, title in KERNELS.items()]
    bars = [(title, label, value, [r for r in measured if r["what"] in whats]) for whats, title, label, value in BARS]
    lines, bars = [panel for panel in lines if panel[-1]], [panel for panel in bars if panel[-1]]
    columns = min(3, len(lines) + len(bars)) or 1
    rows = -(-(len(lines) + len(bars)) // columns) or 1
    with page(path, overwrite, (max(7.0, 5.4 * columns), 0.4 + 4.6 * rows)) as figure:
        axes = figure.subplots(rows, columns, squeeze=False).flatten()
        for axis in axes[len(lines) + len(bars) :]:
            axis.remove()
        for axis, (title, records) in zip(axes, lines, strict=False):
            _draw_lines(axis, title, records)
        for axis, (title, label, value, records) in zip(axes[len(lines) :], bars, strict=False):
            shown = [r for r in records if r.get("over_first") != 1.0]
            drawn = axis.barh(range(len(shown)), [r[value] for r in shown], color=BETTER, height=0.6)
            axis.bar_label(drawn, fmt="%.4g", padding=4, fontsize=8)
            axis.set_yticks(range(len(shown)), [label.format(**r) for r in shown], fontsize=8)
            axis.margins(x=0.15)
            axis.invert_yaxis()
            axis.set_title(title)
        figure.suptitle(machine_line(record).partition(";")[0], fontsize=11, color=INK)


def _draw_lines(axis: Any, title: str, records: Sequence[dict[str, Any]]) -> None:
    """Each contestant's median and quartiles over the number of points."""
    for i, name in enumerate(dict.fromkeys(r["name"] for r in records)):
        rows = [r for r in records if r["name"] == name]
        colour, sizes = [*COLOURS, "#8c6d31", "#7f7f7f", "#9467bd"][i % 9], [r["points"] for r in rows]
        low, median, high = ([1e3 * r["seconds"][key] for r in rows] for key in ("low", "median", "high"))
        axis.plot(sizes, median, label=name, color=colour, marker=MARKERS[i % 9], markersize=5, linewidth=1.4 if i else 2.5)
        axis.fill_between(sizes, low, high, color=colour, alpha=0.15, linewidth=0)
    axis.set(title=title, xlabel="points", ylabel="ms", xscale="log", yscale="log")
    ticks = dict.fromkeys((r["points"], r["side"]) for r in records)
    axis.set_xticks([n for n, _ in ticks], [f"{n:,}" + (f"\n{side}²" if side else "") for n, side in ticks], fontsize=7)
    axis.minorticks_off()
    axis.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2, frameon=False, fontsize=8)
