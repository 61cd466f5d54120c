"""The chart of the study of poses."""

from __future__ import annotations

from pathlib import Path

from ...plots.style import COLOURS, INK, page
from ..study import Record


def draw_pose(path: Path, record: Record, overwrite: bool = False) -> None:
    """For each cloud the share of the cases within so many degrees; dashed: by the nearest of the answers.

    Raises InputError if ``path`` cannot be written to.
    """
    with page(path, overwrite, (9.0, 3.8), dpi=100) as figure:
        axis = figure.subplots()
        for cloud, colour in zip(record["summary"], COLOURS, strict=False):
            for key, dashes in (("degrees", "-"), ("answers", "--")):
                degrees = [case[key] for case in record["cases"] if case["cloud"] == cloud]
                label = cloud if key == "degrees" else None
                axis.ecdf(degrees, color=colour, linestyle=dashes, label=label)
        axis.axvline(15.0, color=INK, linewidth=0.8, zorder=0)
        axis.set_xlim(0.0, 180.0)
        axis.set_xticks([0, 15, 30, 60, 90, 120, 150, 180])
        axis.set_xlabel("degrees from the true rotation (dashed: of the nearest of the answers)")
        axis.set_ylabel("share of the cases")
        axis.legend(frameon=False, fontsize=8, loc="lower right")
