"""Charts of the studies that train networks; hollow marks are the paper's figures.

All raise InputError if their path cannot be written.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...plots.style import BETTER, COLOURS, INK, PALE, WORSE, page
from ..packing import unpack
from ..study import Record

LABEL = "Chamfer x1000 (scaled by own box)"
VARIED = {"views": "masks of each object that supervise a step", "lambda": "lambda, weight of the affinity loss"}
PAPER: dict[str, Any] = {"marker": "D", "markerfacecolor": "white", "markeredgecolor": INK, "markersize": 5}


def _budget(record: Record, note: str = "unseen shapes") -> str:
    settings = record["settings"]
    return f"{settings['steps']} steps of {settings['batch_size']}, seed {settings['seed']}; {note}"


def draw_settings(path: Path, record: Record, overwrite: bool = False) -> None:
    """Chamfer of each setting by category, and the mean."""
    summary, paper = record["summary"], record["paper"]
    categories = [key for key in next(iter(summary.values())) if key != "mean"]
    with page(path, overwrite, (8.6, 1.5 + 0.55 * len(summary))) as figure:
        axis = figure.subplots()
        height = 0.8 / len(categories)
        marks = []
        for j, category in enumerate(categories):
            places = np.arange(len(summary)) + (j - (len(categories) - 1) / 2) * height
            axis.barh(places, [row[category] for row in summary.values()], height * 0.9, color=COLOURS[j], label=category)
            marks += [(paper[name].get(category), y) for name, y in zip(summary, places, strict=True) if name in paper]
        if marks:
            axis.plot(*np.array(marks, dtype=float).T, linestyle="", label="paper", **PAPER)
        for i, row in enumerate(summary.values()):
            end = (max(row[category] for category in categories), i)
            axis.annotate(f"mean {row['mean']:.2f}", end, xytext=(10, 0), textcoords="offset points", va="center")
        axis.set_yticks(range(len(summary)), list(summary))
        axis.invert_yaxis()
        axis.margins(x=0.15)
        axis.set_xlim(left=0.0)
        axis.set_xlabel(LABEL)
        axis.set_title(_budget(record))
        figure.legend(loc="outside lower center", ncols=len(categories) + 1, frameon=False)


def draw_lines(path: Path, record: Record, overwrite: bool = False) -> None:
    """Chamfer over what the study varies: a line for each row of the summary, single seeds, mean shapes, and the paper's."""
    columns = list(next(iter(record["summary"].values())))
    colours = dict(zip(record["summary"], COLOURS, strict=False))
    with page(path, overwrite, (7.6, 5.4)) as figure:
        axis = figure.subplots()
        for name, values in record["summary"].items():
            axis.plot(columns, list(values.values()), "o-", color=colours[name], label=name)
            for column, seeds in record.get("seeds", {}).get(name, {}).items():
                axis.plot([column] * len(seeds), seeds, "_", color=colours[name], markersize=10)
        for name, constant in record.get("constant", {}).items():
            axis.axhline(constant, color=colours[name], linewidth=0.8, linestyle=":", label=f"{name}, mean training shape")
        for name, values in record["paper"].items():
            if name in [*colours, *record["settings"]["shapes"]]:
                colour = colours.get(name, INK)
                axis.plot(list(values), list(values.values()), linestyle="--", color=colour, label=f"{name}, paper", **PAPER)
        axis.set_ylim(bottom=0.0)
        axis.set_xlabel(VARIED[record["study"]])
        axis.set_ylabel(LABEL)
        axis.set_title(_budget(record))
        figure.legend(loc="outside lower center", ncols=len(colours), frameon=False)


def draw_affinity(path: Path, record: Record, overwrite: bool = False) -> None:
    """The points of an unseen shape of each category over a mask that the network was not given, by setting."""
    summary = record["summary"]
    categories = list(next(iter(summary.values())))
    pictures = {(run["setting"], picture["category"]): picture for run in record["runs"] for picture in run["pictures"]}
    with page(path, overwrite, (0.6 + 2.4 * len(summary), 0.5 + 2.5 * len(categories))) as figure:
        axes = figure.subplots(len(categories), len(summary), squeeze=False)
        for row, category in zip(axes, categories, strict=True):
            for axis, (name, values) in zip(row, summary.items(), strict=True):
                _projected(axis, pictures[name, category])
                figures = f"outliers {100.0 * values[category]['outliers']:.1f} %, Chamfer {values[category]['chamfer']:.2f}"
                axis.set_title(f"{name}\n{figures}", fontsize=9)
        figure.suptitle(_budget(record, "an unseen shape of each category in a view that was not the input"), fontsize=10)


def _projected(axis: Any, picture: Record) -> None:
    """Projected points over the mask, outliers orange, and 8 pixels around the picture."""
    mask, pixels, outliers = (unpack(picture[key]) for key in ("mask", "points_px", "outliers"))
    axis.imshow(1.0 - 0.3 * mask, cmap="gray", vmin=0.0, vmax=1.0)
    axis.scatter(*pixels.T, s=np.where(outliers > 0.5, 6, 3), c=np.where(outliers > 0.5, WORSE, BETTER), linewidths=0)
    height, width = mask.shape
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height], [0, 0]]) - 0.5
    axis.plot(*corners.T, color=PALE, linewidth=0.8)
    axis.set(xlim=(-8.5, width + 7.5), ylim=(height + 7.5, -8.5), xticks=[], yticks=[])


def draw_failures(path: Path, record: Record, overwrite: bool = False) -> None:
    """An unseen aeroplane and an unseen car from above, by setting: truth grey, prediction in colour."""
    clouds = [(run["setting"], cloud) for run in record["runs"] for cloud in run["clouds"].values()]
    columns = min(4, len(clouds))
    rows = -(-len(clouds) // columns)
    with page(path, overwrite, (0.6 + 2.5 * columns, 0.5 + 2.9 * rows)) as figure:
        axes = figure.subplots(rows, columns, squeeze=False).flatten()
        for axis in axes[len(clouds) :]:
            axis.remove()
        for axis, (name, cloud) in zip(axes, clouds, strict=False):
            # y is vertical in both frames, so x and z show the cloud from above.
            for points, shade in ((cloud["target"], PALE), (cloud["points"], BETTER)):
                axis.scatter(*unpack(points)[:, ::2].T, s=3, color=shade, linewidths=0)
            axis.set(xlim=(-0.62, 0.62), ylim=(-0.62, 0.62), aspect="equal", xticks=[], yticks=[])
            axis.set_title(f"{name}\n{cloud['shape']}", fontsize=8)
        figure.suptitle(_budget(record, "unseen shapes from above: truth grey"), fontsize=10)
