"""Speed against accuracy: what each variant costs, and what it leaves of the error."""

from __future__ import annotations

from pathlib import Path

from ...plots.style import COLOURS, INK, PALE, page
from ..study import Record

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")


def draw_tradeoffs(path: Path, groups: Record, overwrite: bool) -> None:
    """A panel for each category of the summary of accuracy, seconds logarithmic; at most eight variants.

    Raises InputError if ``path`` cannot be written to.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    with page(path, overwrite, (2.3 * len(groups), 3.3), dpi=100) as figure:
        axes = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
        for axis, (category, group) in zip(axes, groups.items(), strict=True):
            for number, (label, row) in enumerate(group["variants"].items()):
                place, colour = (row["median_seconds"], row["mean_ratio"]), COLOURS[number % len(COLOURS)]
                axis.plot(*place, MARKERS[number], color=colour, markersize=8, alpha=0.85, label=label)
            axis.axhline(group["before"]["floor_ratio"], color=PALE, linestyle=":")
            axis.axhline(1.0, color=INK, linewidth=0.8, zorder=0)
            axis.set_xscale("log")
            low, high = axis.get_xlim()
            middle, half = (low * high) ** 0.5, max((high / low) ** 0.5, 2.2)
            axis.set_xlim(middle / half, middle * half)
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.set_title(category, fontsize=10)
            axis.tick_params(labelsize=8)
        axes[0].set_ylim(bottom=0.0)
        axes[0].set_ylabel("mean of Chamfer after / before", fontsize=9)
        figure.supxlabel("median seconds an object, one CPU thread; dotted: the truth, sampled anew", fontsize=9)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False, fontsize=8)
