"""Charts of the studies that train networks; the paper's own figures, where it has some, are hollow marks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...plots.style import BETTER, COLOURS, INK, PALE, WORSE, page
from ..packing import unpack

LABEL = "Chamfer x1000 (scaled by own box)"


def _budget(record: dict[str, Any]) -> str:
    settings = record["settings"]
    return f"{settings['steps']} steps of {settings['batch_size']}, seed {settings['seed']}"


def draw_supervision(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Chamfer of each kind of supervision by category, and the mean. Raises InputError if ``path`` cannot be written."""
    summary, paper = record["summary"], record["paper"]
    names = list(summary)
    columns = [key for key in summary[names[0]] if key != "mean"]
    with page(path, overwrite, (8.6, 1.5 + 0.55 * len(names))) as figure:
        axis = figure.subplots()
        height = 0.8 / len(columns)
        for j, category in enumerate(columns):
            for i, name in enumerate(names):
                y = i + (j - (len(columns) - 1) / 2) * height
                value = summary[name][category]
                axis.barh(y, value, height * 0.9, color=COLOURS[j], label=category if i == 0 else None)
                theirs = paper.get(name, {}).get(category)
                if theirs is not None:
                    axis.plot(theirs, y, "D", color="white", markeredgecolor=INK, markersize=5)
        for i, name in enumerate(names):
            longest = max(summary[name][category] for category in columns)
            axis.annotate(
                f"mean {summary[name]['mean']:.2f}", (longest, i), xytext=(10, 0), textcoords="offset points", va="center"
            )
        if paper:
            axis.plot([], [], "D", color="white", markeredgecolor=INK, markersize=5, label="paper")
        axis.set_yticks(range(len(names)), names)
        axis.invert_yaxis()
        axis.margins(x=0.15)
        axis.set_xlim(left=0.0)
        axis.set_xlabel(LABEL)
        axis.set_title(f"{_budget(record)}; unseen shapes")
        figure.legend(loc="outside lower center", ncols=len(columns) + 1, frameon=False)


def draw_views(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Chamfer over the number of supervising masks. Raises InputError if ``path`` cannot be written."""
    with page(path, overwrite, (7.6, 5.4)) as figure:
        axis = figure.subplots()
        for i, (category, values) in enumerate(record["summary"].items()):
            counts = [int(count) for count in values]
            axis.plot(counts, list(values.values()), "o-", color=COLOURS[i], label=category)
            for count, single in record["seeds"][category].items():
                axis.plot([int(count)] * len(single), single, "_", color=COLOURS[i], ms=10)
            constant = record["constant"][category]
            axis.axhline(constant, color=COLOURS[i], lw=0.8, ls=":", label=f"{category}, mean training shape")
            theirs = {int(count): value for count, value in record["paper"].get(category, {}).items()}
            if theirs:
                axis.plot(
                    counts, [theirs[count] for count in counts], "D--", color=COLOURS[i], mfc="white", ms=5, lw=1,
                    label=f"{category}, paper",
                )  # fmt: skip
        axis.set_xticks(counts)
        axis.set_ylim(bottom=0.0)
        axis.set_xlabel("masks of each object that supervise a step")
        axis.set_ylabel(LABEL)
        axis.set_title(f"{_budget(record)}; unseen shapes")
        figure.legend(loc="outside lower center", ncols=len(record["summary"]), frameon=False)


def draw_weight(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Chamfer over lambda, for each form of the affinity loss. Raises InputError if ``path`` cannot be written."""
    weights = [float(weight) for weight in next(iter(record["summary"].values()))]
    # Even steps: 0 has no place on a logarithmic axis.
    place = {weight: i for i, weight in enumerate(weights)}
    with page(path, overwrite, (6.4, 4.4)) as figure:
        axis = figure.subplots()
        for i, (form, values) in enumerate(record["summary"].items()):
            axis.plot(range(len(weights)), list(values.values()), "o-", color=COLOURS[i], label=f"form {form!r}")
        for name, values in record["paper"].items():
            at = [place[float(weight)] for weight in values]
            axis.plot(at, list(values.values()), "D--", color=INK, mfc="white", ms=5, lw=1, label=f"paper ({name})")
        axis.set_xticks(range(len(weights)), [f"{weight:g}" for weight in weights])
        axis.set_ylim(bottom=0.0)
        axis.set_xlabel("lambda, weight of the affinity loss")
        axis.set_ylabel(LABEL)
        axis.set_title(f"{', '.join(record['settings']['shapes'])}: {_budget(record)}")
        axis.legend(frameon=False)


def draw_affinity(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Share of outliers with and without the affinity loss, and projected points of unseen shapes over unseen masks.

    Raises InputError if ``path`` cannot be written.
    """
    summary = record["summary"]
    names, categories = list(summary), list(next(iter(summary.values())))
    pictures = {(run["setting"], picture["category"]): picture for run in record["runs"] for picture in run["pictures"]}
    rows = len(categories)
    with page(path, overwrite, (3.0 + 2.4 * len(names), 0.5 + 2.5 * rows)) as figure:
        axes = figure.subplots(rows, len(names) + 1, squeeze=False)
        for row, category in zip(axes, categories, strict=True):
            shares = [100.0 * summary[name][category]["outliers"] for name in names]
            row[0].bar(range(len(names)), shares, color=[WORSE, *[BETTER] * (len(names) - 1)])
            row[0].bar_label(row[0].containers[0], [f"{share:.1f}" for share in shares])
            row[0].set_xticks(range(len(names)), [name.split(",")[0] for name in names])
            row[0].set_ylabel(f"{category}: outliers, %")
            row[0].margins(y=0.2)
            for axis, name in zip(row[1:], names, strict=True):
                _projected(axis, pictures[name, category])
                axis.set_title(f"{name}\nChamfer {summary[name][category]['chamfer']:.2f}", fontsize=9)
        figure.suptitle(
            f"{_budget(record)}; an unseen shape of each category in a view that was not the input: mask grey, outliers orange",
            fontsize=10,
        )


def _projected(axis: Any, picture: dict[str, Any]) -> None:
    """Projected points over the mask, and 8 pixels around the picture."""
    mask, pixels, stray = (unpack(picture[key]) for key in ("mask", "points_px", "outliers"))
    axis.imshow(1.0 - 0.3 * mask, cmap="gray", vmin=0.0, vmax=1.0)
    wrong = stray > 0.5
    axis.scatter(*pixels[~wrong].T, s=3, color=BETTER, linewidths=0)
    axis.scatter(*pixels[wrong].T, s=6, color=WORSE, linewidths=0)
    height, width = mask.shape
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height], [0, 0]]) - 0.5
    axis.plot(*corners.T, color=PALE, linewidth=0.8)
    axis.set_xlim(-8.5, width + 7.5)
    axis.set_ylim(height + 7.5, -8.5)
    axis.set_xticks([])
    axis.set_yticks([])


def draw_failures(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Sizes of aeroplanes and errors of cars, with an aeroplane from above and a car from its side of the line of sight.

    Raises InputError if ``path`` cannot be written.
    """
    summary, runs = record["summary"], {run["setting"]: run for run in record["runs"]}
    parts = [("airplane", [name for name in summary if "span" in summary[name]])]
    parts.append(("car", [name for name in summary if "depth" in summary[name]]))
    parts = [(category, names) for category, names in parts if names]
    columns = 1 + max(len(names) for _, names in parts)
    with page(path, overwrite, (2.6 + 2.5 * columns, 0.5 + 3.2 * len(parts))) as figure:
        grid = figure.subplots(len(parts), columns, squeeze=False, width_ratios=[1.6] + [1.0] * (columns - 1))
        for row, (category, names) in zip(grid, parts, strict=True):
            keys = ("body_width", "body_height", "span") if category == "airplane" else ("depth", "across")
            _grouped(row[0], summary, names, keys, category)
            for axis, name, colour in zip(row[1:], names, COLOURS, strict=False):
                cloud = runs[name]["clouds"][category]
                # y is up in the objects' frame, so x against z is the view from above; of a car in camera axes, too.
                _from_above(axis, unpack(cloud["points"]), unpack(cloud["target"]), colour)
                axis.set_title(name.replace(", ", ",\n"), fontsize=9, color=colour)
            for axis in row[1 + len(names) :]:
                axis.set_axis_off()
        figure.suptitle(
            f"{_budget(record)}; beside the bars an unseen shape from above: truth grey, prediction in colour (camera of "
            "the car below)",
            fontsize=10,
        )


def _grouped(axis: Any, summary: dict[str, Any], names: list[str], keys: tuple[str, ...], category: str) -> None:
    width = 0.8 / len(names)
    for i, name in enumerate(names):
        scale = 1.0 if category == "airplane" else 1e3
        x = np.arange(len(keys)) + (i - (len(names) - 1) / 2) * width
        axis.bar(x, [scale * summary[name][key] for key in keys], width * 0.9, color=COLOURS[i])
    axis.set_xticks(range(len(keys)), [key.replace("_", " ") for key in keys])
    if category == "airplane":
        axis.axhline(1.0, color=INK, linewidth=0.8, linestyle="--")
        axis.set_ylabel("aeroplanes: predicted / true size")
    else:
        axis.set_ylabel("cars: squared error x1000, per axis")
    axis.margins(y=0.1)


def _from_above(axis: Any, points: Any, target: Any, colour: str) -> None:
    axis.scatter(target[:, 0], target[:, 2], s=3, color=PALE, linewidths=0)
    axis.scatter(points[:, 0], points[:, 2], s=3, color=colour, linewidths=0)
    axis.set_xlim(-0.62, 0.62)
    axis.set_ylim(-0.62, 0.62)
    axis.set_aspect("equal")
    axis.set_xticks([])
    axis.set_yticks([])
