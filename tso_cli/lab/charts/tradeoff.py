"""Speed against accuracy: what each variant costs, and what it leaves of the error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ...plots.style import COLOURS, INK, PALE, page

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")


@dataclass(frozen=True)
class Tradeoff:
    """Variants of one object type: label -> (seconds, mean of Chamfer after / before).

    ``floor`` : the ratio of the truth sampled anew."""

    title: str
    variants: Mapping[str, tuple[float, float]]
    floor: float | None = None


def draw_tradeoffs(path: Path, panels: list[Tradeoff], overwrite: bool) -> None:
    """A panel for each object type, seconds logarithmic; at most eight variants.

    Raises InputError if ``path`` cannot be written to.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    labels = list(dict.fromkeys(label for panel in panels for label in panel.variants))[: len(MARKERS)]
    with page(path, overwrite, (2.3 * len(panels), 3.3), dpi=100) as figure:
        axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        for axis, panel in zip(axes, panels, strict=True):
            for number, label in enumerate(labels):
                if label in panel.variants:
                    colour = COLOURS[number % len(COLOURS)]
                    axis.plot(*panel.variants[label], MARKERS[number], color=colour, markersize=8, alpha=0.85, label=label)
            if panel.floor is not None:
                axis.axhline(panel.floor, color=PALE, linestyle=":")
            axis.axhline(1.0, color=INK, linewidth=0.8, zorder=0)
            axis.set_xscale("log")
            low, high = axis.get_xlim()
            middle, half = (low * high) ** 0.5, max((high / low) ** 0.5, 2.2)
            axis.set_xlim(middle / half, middle * half)
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.set_title(panel.title, fontsize=10)
            axis.tick_params(labelsize=8)
        axes[0].set_ylim(bottom=0.0)
        axes[0].set_ylabel("mean of Chamfer after / before", fontsize=9)
        figure.supxlabel("median seconds an object, one CPU thread; dotted: the truth, sampled anew", fontsize=9)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False, fontsize=8)
