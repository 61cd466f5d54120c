"""Bars beside each other."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...plots.style import COLOURS, page

Rows = Mapping[str, Mapping[str, Mapping[str, float | None]]]
"""Title of a panel -> label of a group -> label of a bar -> value."""


def draw_bars(path: Path, panels: Rows, overwrite: bool = False) -> None:
    """A panel below the other, a group of bars for each row. Raises InputError if ``path`` cannot be written to."""
    from matplotlib import colormaps

    bars_of = {title: list(dict.fromkeys(bar for row in rows.values() for bar in row)) for title, rows in panels.items()}
    heights = [0.6 + (0.2 + 0.13 * len(bars_of[title])) * len(rows) for title, rows in panels.items()]
    with page(path, overwrite, (8.6, sum(heights)), dpi=100) as figure:
        axes = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
        for axis, (title, rows) in zip(axes, panels.items(), strict=True):
            labels = bars_of[title]
            colours = COLOURS if len(labels) <= len(COLOURS) else colormaps["viridis"](np.linspace(0.0, 0.95, len(labels)))
            height = 0.8 / len(labels)
            for j, label in enumerate(labels):
                places = np.arange(len(rows)) + (j - (len(labels) - 1) / 2) * height
                values = np.array([row.get(label) for row in rows.values()], dtype=float)
                bars = axis.barh(places, values, 0.9 * height, color=colours[j], label=label)
                axis.bar_label(bars, ["" if np.isnan(value) else f"{value:.3g}" for value in values], fontsize=7, padding=3)
            axis.set_yticks(range(len(rows)), list(rows), fontsize=8)
            axis.invert_yaxis()
            axis.margins(x=0.1)
            axis.set_title(title, fontsize=9)
            axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)
