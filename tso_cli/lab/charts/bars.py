"""Bars beside each other; hollow marks are the paper's figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...plots.style import COLOURS, INK, page

Groups = Mapping[str, Mapping[str, float]]
"""Label of a group -> label of a bar -> value."""


@dataclass(frozen=True)
class Bars:
    """One panel; ``paper`` : values for some of the bars."""

    title: str
    groups: Groups
    paper: Groups = field(default_factory=dict)


def draw_bars(path: Path, panels: Sequence[Bars], overwrite: bool = False) -> None:
    """A panel below the other, a row of bars for each group. Raises InputError if ``path`` cannot be written to."""
    heights = [0.6 + 0.7 * len(panel.groups) for panel in panels]
    with page(path, overwrite, (8.6, sum(heights)), dpi=100) as figure:
        axes = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
        for axis, panel in zip(axes, panels, strict=True):
            labels = list(dict.fromkeys(label for bars in panel.groups.values() for label in bars))
            height = 0.8 / len(labels)
            for j, label in enumerate(labels):
                places = np.arange(len(panel.groups)) + (j - (len(labels) - 1) / 2) * height
                values = [bars.get(label, np.nan) for bars in panel.groups.values()]
                bars = axis.barh(places, values, 0.9 * height, color=COLOURS[j % len(COLOURS)], label=label)
                axis.bar_label(bars, fmt="%.3g", fontsize=7, padding=8)
                theirs = [panel.paper.get(group, {}).get(label, np.nan) for group in panel.groups]
                axis.plot(theirs, places, "D", markerfacecolor="white", markeredgecolor=INK, markersize=4)
            axis.set_yticks(range(len(panel.groups)), list(panel.groups), fontsize=8)
            axis.invert_yaxis()
            axis.margins(x=0.1)
            axis.set_title(panel.title, fontsize=9)
            axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)
