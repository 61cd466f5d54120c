"""The chart of `tso bench stability`: a row for each axis, from green over amber to red, with where the tool speaks up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...plots.style import INK, PALE, page
from ..studies.refining import DEFAULT
from ..studies.summary import grouped
from ..study import Record
from .knees import AXIS, WORSE, fails, speaks

# Colours by the ratio, each up to that one: better, hardly changed, worse, far worse.
SHADES = {
    0.7: "#1a9850",
    0.95: "#91cf60",
    WORSE: "#d9ef8b",
    1.5: "#fdae61",
    3.0: "#f46d43",
    np.inf: "#d73027",
}
NAMES = ("to 0.7", "to 0.95", f"to {WORSE:g}, as before", "to 1.5", "to 3", "above")
ROW = 0.18
"""Inches."""


def draw(path: Path, record: Record, overwrite: bool) -> None:
    """By the default preset: cells of levels coloured by the median ratio, and the knee in words."""
    axes = grouped([row for row in record["cases"] if row["variant"] == DEFAULT], "axis")
    knees = record["knees"][DEFAULT]
    columns = max(len(rows) for rows in axes.values())
    groups = [AXIS[name].group for name in axes]
    with page(
        path, overwrite, (13.0, 1.15 + ROW * (len(axes) + len(set(groups)))), dpi=100
    ) as figure:
        axis = figure.subplots()
        y, ticks = -1.0, []
        for i, (name, rows) in enumerate(axes.items()):
            if i == 0 or groups[i] != groups[i - 1]:
                y += 1.0
                axis.text(
                    -0.55,
                    y,
                    groups[i],
                    fontsize=8,
                    weight="bold",
                    ha="right",
                    va="center",
                    color=INK,
                )
            y += 1.0
            ticks.append(y)
            for x, row in enumerate(rows):
                _draw_cell(axis, x, y, row)
            axis.text(columns - 0.4, y, knees[name]["words"], fontsize=7, va="center", color=INK)
        labels = [f"{name}, {AXIS[name].unit}" if AXIS[name].unit else name for name in axes]
        axis.set_yticks(ticks, labels, fontsize=7)
        axis.set(xlim=(-0.5, columns + 4.6), ylim=(y + 0.6, -0.6), xticks=[])
        axis.tick_params(left=False)
        axis.spines[["left", "bottom"]].set_visible(False)
        _draw_legend(figure, axis)


def _draw_cell(axis: Any, x: float, y: float, row: Record) -> None:
    refused = row["refused"] > 0.5
    ratio = np.inf if row["median"] is None else row["median"]
    colour = PALE if refused else next(shade for limit, shade in SHADES.items() if ratio <= limit)
    axis.barh(y, 0.96, 0.86, x - 0.48, color=colour, linewidth=0)
    light = "white" if not refused and (ratio > 3.0 or ratio <= 0.7) else INK
    text = "" if refused else f"{ratio:.2f}" if ratio < 10.0 else f"{ratio:.0f}"
    axis.text(
        x - 0.44,
        y,
        AXIS[row["axis"]].at(row["level"]).split(" ")[0],
        fontsize=6,
        va="center",
        color=light,
    )
    axis.text(
        x + 0.30,
        y,
        text,
        fontsize=6.5,
        va="center",
        ha="right",
        color=light,
        weight="bold" if fails(row) else "normal",
    )
    if speaks(row):
        axis.scatter(x + 0.39, y, s=16, marker="^", color=light, linewidths=0)


def _draw_legend(figure: Any, axis: Any) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [
        Patch(color=shade, label=name) for shade, name in zip(SHADES.values(), NAMES, strict=True)
    ]
    handles += [
        Patch(color=PALE, label="refused by most"),
        Line2D([], [], color=INK, marker="^", ls="", label="speaks up"),
    ]
    title = "from harmless to hopeless: level, and median Chamfer distance after / before"
    figure.legend(
        handles=handles,
        loc="outside upper center",
        ncols=8,
        frameon=False,
        fontsize=8,
        title=title,
        title_fontsize=9,
    )
