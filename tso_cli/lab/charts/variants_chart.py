"""The chart of the study of the variants."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...io.output import atomic_output, check_output

INK = "#333333"
# Safe for colour-blind readers.
COLOURS = {"encoder": "#0072b2", "encoder-decoder": "#d55e00", "points": "#009e73"}
LETTERS = {"encoder": "E", "encoder-decoder": "E and D", "points": "p"}
APART = 0.26


def draw_variants_study(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Chamfer after / before by variant and category beside the paper's, and the same of visible and occluded points.

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=[5, 4])
    _draw_ratios(left, record)
    _draw_groups(right, record)
    handles = [_line(colour, LETTERS[name]) for name, colour in COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", frameon=False, ncols=3)
    for axis in (left, right):
        axis.axhline(1.0, color=INK, linewidth=0.8, linestyle=":")
        axis.spines[["top", "right"]].set_visible(False)
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=110)


def _places(i: int) -> dict[str, float]:
    """Where the three variants of the i-th category stand."""
    return {name: i + APART * (j - 1) for j, name in enumerate(COLOURS)}


def _draw_ratios(axis: Any, record: dict[str, Any]) -> None:
    rng = np.random.default_rng(0)
    summary, paper = record["summary"], record["paper"]
    for i, category in enumerate(summary):
        cases = [case["capnet"] for case in record["cases"] if category in ("all", case["category"])]
        for name, x in _places(i).items():
            ratios = [_chamfer(case[name]) / _chamfer(case["before"]) for case in cases]
            spread = x + rng.uniform(-0.08, 0.08, len(ratios))
            axis.scatter(spread, ratios, s=7, color=COLOURS[name], alpha=0.35, linewidths=0)
            mean = summary[category]["capnet"][name]["ratio_of_means"]
            axis.plot([x - 0.11, x + 0.11], [mean, mean], color=COLOURS[name], linewidth=3)
            theirs = paper[name][2] / paper["before"][2]
            axis.plot([x - 0.11, x + 0.11], [theirs, theirs], color=INK, linewidth=1, linestyle=(0, (2, 1)))
    _label(axis, summary)
    # A single case far off would flatten what the means say.
    every = [
        _chamfer(case["capnet"][name]) / _chamfer(case["capnet"]["before"]) for case in record["cases"] for name in COLOURS
    ]
    low, high = np.percentile(every, [1, 99])
    axis.set_ylim(min(low, 0.93) - 0.02, max(high, 1.0) + 0.02)
    axis.set_ylabel("Chamfer after / before (paper's protocol)")
    outside = sum(not axis.get_ylim()[0] <= ratio <= axis.get_ylim()[1] for ratio in every)
    note = f"; {outside} dots outside" if outside else ""
    axis.set_title(f"line: ratio of the means, dashed: the paper's, dot: a view{note}", fontsize=10)


def _draw_groups(axis: Any, record: dict[str, Any]) -> None:
    summary = record["summary"]
    for i, category in enumerate(summary):
        for name, x in _places(i).items():
            own = summary[category]["capnet"][name]
            for key, shift, filled in (("visible", -0.05, True), ("occluded", 0.05, False)):
                if own[f"{key}_ratio"] is not None:
                    face = COLOURS[name] if filled else "white"
                    axis.plot(x + shift, own[f"{key}_ratio"], "o", color=face, markeredgecolor=COLOURS[name], markersize=7)
    _label(axis, summary)
    axis.set_ylabel("forward distance after / before")
    axis.set_title("points of the truth that the view sees (filled) and the others (white)", fontsize=10)


def _chamfer(distances: dict[str, Any]) -> float:
    return float(distances["forward"] + distances["backward"])


def _label(axis: Any, summary: dict[str, Any]) -> None:
    axis.set_xticks(range(len(summary)), [f"{name}\n{summary[name]['cases']} views" for name in summary])
    axis.set_xlim(-0.5, len(summary) - 0.5)


def _line(colour: str, label: str) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, linewidth=3, label=label)
