"""The chart of the study of accuracy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...io.output import atomic_output, check_output

INK, GREY, BETTER, WORSE = "#333333", "#888888", "#0072b2", "#d55e00"
# Safe for colour-blind readers; with the markers, many variants can be told apart.
COLOURS = ("#555555", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
TITLES = {
    "other": "from another shape's cloud",
    "near": "from a cloud near the truth",
    "cut": "from another shape's cloud, the border cuts the object",
    "right": "from the truth, sampled once more",
    "network": "from the network's prediction",
}
# Kinds whose seconds are shown; they differ little between the others. And those of them that come near their bounds.
TIMED = ("other", "network")
BOUNDED = ("other",)


def draw_accuracy_study(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Seconds against Chamfer after / before, a point for each variant, and every case's own ratio; a column a category.

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = [(kind, draw) for kind in record["summary"] for draw in (_seconds, _dots) if draw is _dots or kind in TIMED]
    columns = list(dict.fromkeys(category for own in record["summary"].values() for category in own))
    heights = [_height(len(_variants(record, kind)), draw is _seconds) for kind, draw in rows]
    width = 3.4 + 2.9 * max(len(columns), 2)
    figure = Figure(figsize=(width, sum(heights) + 0.75 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    parts = figure.subfigures(len(rows), 1, height_ratios=[height + 0.75 for height in heights], squeeze=False)[:, 0]
    for part, (kind, draw) in zip(parts, rows, strict=True):
        own = record["summary"][kind]
        every = part.subplots(1, len(columns), sharey=True, squeeze=False)[0]
        for axis in every[len(own) :]:
            axis.set_axis_off()
        axes = every[: len(own)]
        draw(axes, record, kind)
        for axis in axes:
            axis.spines[["top", "right"]].set_visible(False)
        what = "what a variant costs and gains" if draw is _seconds else "every case, and the mean"
        part.suptitle(f"{TITLES[kind]}: {what}", fontsize=11, color=INK, x=0.01, ha="left")
        if draw is _seconds:
            part.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", frameon=False, fontsize=8)
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=100)


def _height(variants: int, seconds: bool) -> float:
    """Inches. A chart of seconds has a legend of all variants beside it, the other a row for each."""
    return max(2.6, 0.17 * variants) if seconds else 0.5 + 0.22 * variants


def _variants(record: dict[str, Any], kind: str) -> list[str]:
    return list(next(iter(record["summary"][kind].values()))["variants"])


def _style(number: int) -> dict[str, Any]:
    return {"color": COLOURS[number % len(COLOURS)], "marker": MARKERS[(number + number // len(COLOURS)) % len(MARKERS)]}


def _seconds(axes: Any, record: dict[str, Any], kind: str) -> None:
    for axis, (category, group) in zip(axes, record["summary"][kind].items(), strict=True):
        for number, (name, own) in enumerate(group["variants"].items()):
            if own["median_seconds"] is not None:
                place = own["median_seconds"], own["mean_ratio"]
                axis.plot(*place, linestyle="none", markersize=8, alpha=0.85, label=name, **_style(number))
        for bound, dashes, label in (("floor", ":", "sampling floor"), ("in_plane", "--", "all but depth right")):
            value = group["before"].get(f"{bound}_ratio")
            if value is not None and kind in BOUNDED:
                axis.axhline(value, color=GREY, linewidth=1.2, linestyle=dashes, label=label, zorder=0)
        axis.axhline(1.0, color=INK, linewidth=0.8, zorder=0)
        axis.set_xscale("log")
        axis.set_title(category, fontsize=10)
        axis.set_xlabel("median seconds an object", fontsize=9)
        _plain_numbers(axis)
    if kind in BOUNDED:
        axes[0].set_ylim(bottom=0.0)
    axes[0].set_ylabel("mean of Chamfer after / before", fontsize=9)


def _plain_numbers(axis: Any) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_xlim()
    if high < 4.0 * low:
        middle = np.sqrt(low * high)
        axis.set_xlim(middle / 2.5, middle * 2.5)
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.tick_params(labelsize=8)


def _dots(axes: Any, record: dict[str, Any], kind: str) -> None:
    rng = np.random.default_rng(0)
    names = _variants(record, kind)
    for axis, (category, group) in zip(axes, record["summary"][kind].items(), strict=True):
        cases = [case for case in record["cases"] if (case["kind"], case["category"]) == (kind, category)]
        for row, name in enumerate(names):
            ratios = np.array([case["variants"][name]["chamfer"] / case["before"]["chamfer"] for case in cases])
            y = row + rng.uniform(-0.25, 0.25, len(ratios))
            axis.scatter(ratios, y, s=9, c=np.where(ratios > 1.0, WORSE, BETTER), alpha=0.5, linewidths=0)
            mean = group["variants"][name]["mean_ratio"]
            axis.plot([mean, mean], [row - 0.36, row + 0.36], color=INK, linewidth=2)
        axis.axvline(1.0, color=INK, linewidth=0.8, zorder=0)
        axis.set_title(f"{category}, {group['cases']} cases", fontsize=10)
        axis.set_xlim(0.0, max(1.05, axis.get_xlim()[1]))
        axis.set_xlabel("Chamfer after / before", fontsize=9)
        axis.tick_params(labelsize=8)
    axes[0].set_yticks(range(len(names)), names)
    axes[0].invert_yaxis()
