"""Charts of study records."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...io.output import atomic_output, check_output
from ...plots.style import BETTER, INK, WORSE


def draw_points_study(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Chamfer after / before of every case by category, with means, beside IoU before and after.

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=[3, 2])
    rng = np.random.default_rng(0)
    categories = list(record["summary"])
    for i, category in enumerate(categories):
        cases = [case for case in record["cases"] if case["category"] == category]
        ratios = np.array([case["ratio"] for case in cases])
        x = i + rng.uniform(-0.22, 0.22, len(cases))
        left.scatter(x, ratios, s=14, c=np.where(ratios > 1.0, WORSE, BETTER), alpha=0.75, linewidths=0)
        mean = record["summary"][category]["mean_ratio"]
        left.plot([i - 0.32, i + 0.32], [mean, mean], color=INK, linewidth=2)
        for case in cases:
            right.plot([2 * i, 2 * i + 1], [case["iou_before"], case["iou_after"]], color=BETTER, alpha=0.2, linewidth=0.8)
        means = [record["summary"][category][key] for key in ("iou_before", "iou_after")]
        right.plot([2 * i, 2 * i + 1], means, color=INK, linewidth=2, marker="o", markersize=4)
    left.axhline(1.0, color=INK, linewidth=0.8, linestyle="--")
    summary = record["summary"]
    labels = [f"{name}\n{summary[name]['cases']} shapes\nmean {summary[name]['mean_ratio']:.3f}" for name in categories]
    left.set_xticks(range(len(categories)), labels)
    left.set_xlim(-0.5, len(categories) - 0.5)
    left.set_ylabel("Chamfer to the truth, after / before")
    left.set_title("below 1 is better; a dot is a shape")
    right.set_xticks([2 * i + 0.5 for i in range(len(categories))], categories)
    right.set_ylabel("IoU of silhouette and mask")
    right.set_title("before to after, mean in black")
    for axis in (left, right):
        axis.spines[["top", "right"]].set_visible(False)
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=110)


def draw_examples_study(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Chamfer before and after of each example and mode.

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = record["examples"]
    figure = Figure(figsize=(8.0, 0.7 + 0.42 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    for i, row in enumerate(rows):
        before, after = 1e3 * row["chamfer_before"], 1e3 * row["chamfer_after"]
        axis.plot([before, after], [i, i], color=BETTER if after <= before else WORSE, linewidth=2)
        axis.plot(before, i, "o", color="white", markeredgecolor=INK, markersize=7)
        axis.plot(after, i, "o", color=BETTER if after <= before else WORSE, markersize=7)
        axis.annotate(f"x {row['ratio']:.3f}", (max(before, after), i), xytext=(9, 0), textcoords="offset points", va="center")
    axis.set_yticks(range(len(rows)), [f"{row['example']}, {row['mode']}" for row in rows])
    axis.invert_yaxis()
    axis.margins(x=0.15)
    axis.set_xlim(left=0.0)
    axis.set_xlabel("Chamfer to the target x1000 (white before, filled after; squared, mean, both directions)")
    axis.spines[["top", "right"]].set_visible(False)
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=110)
