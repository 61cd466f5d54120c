"""The chart of `tso lab stability`: a row for each axis, from green over amber to red."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...plots.style import INK, PALE, page
from ..studies.refining import DEFAULT
from ..studies.summary import grouped
from ..study import Record
from .knees import AXIS, WORSE, fails, warns

# Largest ratio -> colour and its name: better, hardly changed, worse, far worse.
SHADES = {
    0.7: ("#1a9850", "to 0.7"),
    0.95: ("#91cf60", "to 0.95"),
    WORSE: ("#d9ef8b", f"to {WORSE:g}, as before"),
    1.5: ("#fdae61", "to 1.5"),
    3.0: ("#f46d43", "to 3"),
    np.inf: ("#d73027", "above"),
}
ROW_HEIGHT = 0.18
"""Inches."""


def draw(path: Path, record: Record, overwrite: bool) -> None:
    """By the default preset: cells of levels coloured by the median ratio; triangles: warnings."""
    axes = grouped([row for row in record["cases"] if row["variant"] == DEFAULT], "axis")
    columns = max(len(rows) for rows in axes.values())
    groups = [AXIS[name].group for name in axes]
    height = 1.15 + ROW_HEIGHT * (len(axes) + len(set(groups)))
    title = {"fontsize": 8, "weight": "bold", "ha": "right", "va": "center", "color": INK}
    with page(path, overwrite, (10.5, height), dpi=100) as figure:
        axis = figure.subplots()
        y, ticks = -1.0, []
        for i, rows in enumerate(axes.values()):
            if i == 0 or groups[i] != groups[i - 1]:
                y += 1.0
                axis.text(-0.55, y, groups[i], **title)
            y += 1.0
            ticks.append(y)
            for x, row in enumerate(rows):
                _draw_cell(axis, x, y, row)
        axis.set_yticks(ticks, [AXIS[name].label for name in axes], fontsize=7)
        axis.set(xlim=(-0.5, columns - 0.5), ylim=(y + 0.6, -0.6), xticks=[])
        axis.tick_params(left=False)
        axis.spines[["left", "bottom"]].set_visible(False)
        _draw_legend(figure)


def _draw_cell(axis: Any, x: float, y: float, row: Record) -> None:
    refused = row["refused"] > 0.5
    ratio = np.inf if row["median"] is None else row["median"]
    shade = next(colour for limit, (colour, _) in SHADES.items() if ratio <= limit)
    axis.barh(y, 0.96, 0.86, x - 0.48, color=PALE if refused else shade, linewidth=0)
    ink = "white" if not refused and (ratio > 3.0 or ratio <= 0.7) else INK
    level = AXIS[row["axis"]].at(row["level"]).split(" ")[0]
    axis.text(x - 0.44, y, level, fontsize=6, va="center", color=ink)
    if not refused:
        text = f"{ratio:.2f}" if ratio < 10.0 else f"{ratio:.0f}"
        weight = "bold" if fails(row) else "normal"
        style = {"fontsize": 6.5, "va": "center", "ha": "right", "weight": weight}
        axis.text(x + 0.30, y, text, color=ink, **style)
    if warns(row):
        axis.scatter(x + 0.39, y, s=16, marker="^", color=ink, linewidths=0)


def _draw_legend(figure: Any) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Patch(color=colour, label=name) for colour, name in SHADES.values()]
    handles.append(Patch(color=PALE, label="refused by most"))
    handles.append(Line2D([], [], color=INK, marker="^", ls="", label="tso warns"))
    title = "from harmless to hopeless: level, and median Chamfer distance after / before"
    style = {"frameon": False, "fontsize": 8, "title_fontsize": 9}
    place = {"loc": "outside upper center", "ncols": 8}
    figure.legend(handles=handles, title=title, **place, **style)
