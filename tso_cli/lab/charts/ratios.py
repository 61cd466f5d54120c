"""Panels of Chamfer after / before: a dot for each case, a bar for their mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...plots.style import BETTER, INK, WORSE, page

ROW_HEIGHT = 0.15
"""Inches."""


@dataclass(frozen=True)
class Panel:
    """``rows`` : label -> Chamfer after / before of each case. ``references`` : label -> a dashed bar, the paper's."""

    title: str
    rows: Mapping[str, Sequence[float] | np.ndarray]
    references: Mapping[str, float] = field(default_factory=dict)


def draw_ratios(path: Path, grid: Sequence[Sequence[Panel]], overwrite: bool) -> None:
    """Panels in rows that share their labels; a case that got worse is red, the line is at 1."""
    labels = [list(dict.fromkeys(label for panel in row for label in panel.rows)) for row in grid]
    heights = [0.5 + ROW_HEIGHT * len(names) for names in labels]
    columns = max(map(len, grid))
    rng = np.random.default_rng(0)
    with page(path, overwrite, (2.5 + 2.4 * columns, 0.4 + sum(heights)), dpi=100) as figure:
        axes = figure.subplots(len(grid), columns, squeeze=False, height_ratios=heights)
        for axis in axes.flat:
            axis.set_yticks([])
        for row, names, panels in zip(axes, labels, grid, strict=True):
            for axis, panel in zip(row, panels, strict=False):
                for label, ratios in panel.rows.items():
                    y, values = names.index(label), np.asarray(ratios)
                    spread = y + rng.uniform(-0.25, 0.25, len(values))
                    axis.scatter(values, spread, s=8, c=np.where(values > 1.0, WORSE, BETTER), alpha=0.5, linewidths=0)
                    axis.plot([values.mean()] * 2, [y - 0.36, y + 0.36], color=INK, linewidth=2)
                    if label in panel.references:
                        axis.plot([panel.references[label]] * 2, [y - 0.36, y + 0.36], color=INK, linewidth=1, linestyle=":")
                axis.axvline(1.0, color=INK, linewidth=0.8, zorder=0)
                axis.set_title(panel.title, fontsize=9)
                axis.set_ylim(len(names) - 0.5, -0.5)
                axis.tick_params(labelsize=8)
            for axis in row[len(panels) :]:
                axis.set_xticks([])
            row[0].set_yticks(range(len(names)), names, fontsize=7)
        figure.supxlabel("Chamfer after / before of each case, and their mean", fontsize=9)
