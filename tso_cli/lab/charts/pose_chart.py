"""The chart of the study of poses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...io.output import atomic_output, check_output
from .accuracy_chart import COLOURS, INK


def draw_pose_study(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """For each cloud, how many of the cases are found within so many degrees, and within them by one of the answers (dashed).

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    for number, name in enumerate(record["summary"]):
        cases = [case for case in record["cases"] if case["cloud"] == name]
        for key, dashes in (("degrees", "-"), ("answers", "--")):
            degrees = np.sort([case[key] for case in cases])
            share = np.arange(1, len(degrees) + 1) / len(degrees)
            label = name if key == "degrees" else None
            axis.step([0.0, *degrees, 180.0], [0.0, *share, 1.0], dashes, where="post", color=COLOURS[1 + number], label=label)
    axis.axvline(15.0, color=INK, linewidth=0.8, zorder=0)
    axis.set_xlim(0.0, 180.0)
    axis.set_xticks([0, 15, 30, 60, 90, 120, 150, 180])
    axis.set_xlabel("degrees from the true rotation (dashed: of the nearest of the answers)", fontsize=9)
    axis.set_ylabel("share of the cases", fontsize=9)
    axis.tick_params(labelsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=100)
