"""The chart of the study of sigma^2: error curves, and projections beside the mask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...io.output import atomic_output, check_output

INK = "#333333"
# Safe for colour-blind readers.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")


@dataclass(frozen=True, eq=False)
class Projections:
    """A shape's mask [H, W] in [0, 1] and projections of the true cloud: what each is called -> [H, W]."""

    shape: str
    mask: NDArray[np.float32]
    silhouettes: dict[str, NDArray[np.float32]]


def draw_sigma_study(path: Path, record: dict[str, Any], overwrite: bool = False, maps: Sequence[Projections] = ()) -> None:
    """L1 error over sigma^2 by category, its best and the paper's choice; below, for each of ``maps`` a row of pictures.

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = 1 + max((len(row.silhouettes) for row in maps), default=0)
    figure = Figure(figsize=(max(7.5, 1.6 * columns), 4.2 + 1.75 * len(maps)), layout="constrained")
    FigureCanvasAgg(figure)
    above: Any = figure
    if maps:
        parts: Any = figure.subfigures(2, 1, height_ratios=[4.2, 1.75 * len(maps)])
        above, below = parts
        _draw_maps(below.subplots(len(maps), columns, squeeze=False), maps)
    _draw_curves(above.subplots(), record)
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=110)


def _draw_curves(axis: Any, record: dict[str, Any]) -> None:
    sigmas = record["settings"]["sigma_sq"]
    categories = [name for name in record["summary"] if name != "all"]
    for i, name in enumerate(categories):
        own, colour = record["summary"][name], COLOURS[i % len(COLOURS)]
        axis.plot(sigmas, own["l1"], color=colour, linewidth=2, label=f"{name}, {own['shapes']} shapes")
        axis.plot(sigmas, own["missing"], color=colour, linewidth=0.9, linestyle="--")
        axis.plot(sigmas, own["stray"], color=colour, linewidth=0.9, linestyle=":")
        axis.plot(own["best"], own["l1_at_best"], "o", color=colour, markersize=7)
        if own["paper"] is not None:
            axis.plot(own["paper"], own["l1_at_paper"], "D", color="white", markeredgecolor=colour, markersize=8)
    axis.set_xscale("log")
    axis.set_xticks(sigmas[::2], [f"{sigma_sq:g}" for sigma_sq in sigmas[::2]])
    axis.set_xticks([], minor=True)
    axis.set_ylim(bottom=0.0)
    axis.set_xlabel("sigma^2 (px^2 at 64x64)")
    axis.set_ylabel("mean |silhouette - mask|")
    axis.set_title("dot: best, diamond: the paper's; dashed: what is missing, dotted: what is stray", fontsize=10)
    axis.legend(frameon=False, loc="upper center")
    axis.spines[["top", "right"]].set_visible(False)


def _draw_maps(axes: Any, maps: Sequence[Projections]) -> None:
    for i, (row, own) in enumerate(zip(axes, maps, strict=True)):
        pictures = [("mask", own.mask), *own.silhouettes.items()]
        for axis, (title, picture) in zip(row, pictures, strict=True):
            axis.imshow(picture, cmap="gray", vmin=0.0, vmax=1.0, interpolation="nearest")
            if i == 0:
                axis.set_title(title, fontsize=9, color=INK)
            axis.set_xticks([])
            axis.set_yticks([])
        row[0].set_ylabel(own.shape.replace("/", "\n")[:40], fontsize=7)
