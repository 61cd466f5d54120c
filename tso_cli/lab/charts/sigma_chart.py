"""The chart of the study of sigma^2: error curves, and projections beside the mask."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...plots.style import COLOURS, page
from ..packing import unpack
from ..study import Record


def draw_sigma(path: Path, record: Record, overwrite: bool = False) -> None:
    """L1 error over sigma^2 by category, its best and the paper's choice; below, the projections of one shape of each.

    Raises InputError if ``path`` cannot be written to.
    """
    maps = record.get("maps", {})
    columns = max((len(pictures) for pictures in maps.values()), default=0)
    heights = [4.2, *[1.75] * len(maps)]
    with page(path, overwrite, (max(7.5, 1.6 * columns), sum(heights))) as figure:
        parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        _draw_curves(parts[0].subplots(), record)
        for part, (shape, pictures) in zip(parts[1:], maps.items(), strict=True):
            part.suptitle(shape, fontsize=8)
            for axis, (title, picture) in zip(part.subplots(1, columns), pictures.items(), strict=True):
                axis.imshow(unpack(picture), cmap="gray", vmin=0.0, vmax=1.0, interpolation="nearest")
                axis.set_title(title, fontsize=8)
                axis.set(xticks=[], yticks=[])


def _draw_curves(axis: Any, record: Record) -> None:
    sigmas = record["settings"]["sigma_sq"]
    categories = [(name, row) for name, row in record["summary"].items() if name != "all"]
    for i, (name, row) in enumerate(categories):
        colour = COLOURS[i % len(COLOURS)]
        axis.plot(sigmas, row["l1"], color=colour, linewidth=2, label=f"{name}, {row['shapes']} shapes")
        axis.plot(sigmas, row["missing"], color=colour, linewidth=0.9, linestyle="--")
        axis.plot(sigmas, row["stray"], color=colour, linewidth=0.9, linestyle=":")
        axis.plot(row["best"], row["l1_at_best"], "o", color=colour, markersize=7)
        if row["paper"] is not None:
            axis.plot(row["paper"], row["l1_at_paper"], "D", color="white", markeredgecolor=colour, markersize=8)
    axis.set_xscale("log")
    axis.set_xticks(sigmas[::2], [f"{sigma_sq:g}" for sigma_sq in sigmas[::2]])
    axis.set_xticks([], minor=True)
    axis.set_ylim(bottom=0.0)
    axis.set_xlabel("sigma^2 (px^2 at 64x64)")
    axis.set_ylabel("mean |silhouette - mask|")
    axis.set_title("dot: best, diamond: the paper's; dashed: what is missing, dotted: what is stray", fontsize=10)
    axis.legend(frameon=False, loc="upper center")
