"""The chart of the study of the base network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...io.output import atomic_output, check_output

LABELS = {
    "network": "network",
    "nearest": "nearest training shape",
    "mean_aligned": "mean shape, aligned",
    "mean_view": "mean shape, view",
}
COLOURS = ("#0072b2", "#999999", "#cccccc", "#e5e5e5")


def draw_network_study(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Chamfer of the network and of its three rivals, by category, on validation and test shapes.

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(record["summary"]), sharey=True, squeeze=False)[0]
    for axis, (part, summary) in zip(axes, record["summary"].items(), strict=True):
        for j, (name, label) in enumerate(LABELS.items()):
            for i, own in enumerate(summary.values()):
                value = 1e3 * own[name]
                bar = axis.bar(i + 0.2 * (j - 1.5), value, 0.19, color=COLOURS[j], label=label if i == 0 else None)
                axis.bar_label(bar, fmt="%.1f", fontsize=7, padding=2)
        axis.set_xticks(range(len(summary)), [f"{name}\n{own['shapes']} shapes" for name, own in summary.items()])
        axis.set_title(part)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("Chamfer to the truth x1000, mean")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", frameon=False, ncols=4)
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=110)
