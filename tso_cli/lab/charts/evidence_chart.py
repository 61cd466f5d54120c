"""The chart of the study of evidence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...io.output import atomic_output, check_output
from .accuracy_chart import COLOURS, INK, MARKERS

TITLES = {
    "framing": "The object in a larger photo",
    "depth": "Depth maps",
    "colours": "Photos of painted objects",
    "missing": "Objects of which a part is missing",
    "wrong": "Wrong views among four",
    "cameras": "Cameras that are off",
    "placing": "Where a prediction stands",
    "rates": "Learning rates of the network's variants",
    "meshes": "Starts that are meshes",
}


def draw_evidence_study(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """The mean Chamfer after / before of every row, by category, and the worst case of all; a panel a question and kind.

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = [(name, kind, found) for name, kinds in record["summary"].items() for kind, found in kinds.items()]
    # A category looks the same in all panels.
    known = list(dict.fromkeys(category for _, _, found in panels for category in found if category != "all"))
    heights = [1.0 + 0.24 * len(found["all"]) for _, _, found in panels]
    figure = Figure(figsize=(10.0, sum(heights)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(panels), 1, height_ratios=heights, squeeze=False)[:, 0]
    for axis, (name, kind, found) in zip(axes, panels, strict=True):
        rows = list(found["all"])
        for category, own in found.items():
            if category == "all":
                continue
            number = known.index(category)
            places = [row for row in rows if row in own]
            style = {"color": COLOURS[1 + number], "marker": MARKERS[number], "linestyle": "none", "alpha": 0.85}
            axis.plot([own[row]["mean_ratio"] for row in places], [rows.index(row) for row in places], label=category, **style)
        worst = [found["all"][row]["worst_ratio"] for row in rows]
        axis.plot(worst, range(len(rows)), linestyle="none", marker="|", color=INK, label="worst case")
        axis.axvline(1.0, color=INK, linewidth=0.8, zorder=0)
        axis.set_yticks(range(len(rows)), rows, fontsize=8)
        axis.invert_yaxis()
        axis.grid(axis="y", color="#eeeeee")
        axis.set_axisbelow(True)
        axis.tick_params(axis="x", labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_title(f"{TITLES[name]}; starts: {kind}", fontsize=10, color=INK, loc="left")
        axis.set_xlabel("Chamfer after / before", fontsize=8)
        axis.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=100)
