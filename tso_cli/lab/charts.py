"""The charts of the studies: bars, ratios of cases, and pictures of cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..evaluation.footprint import common_window, in_window
from ..geometry.points import Array, scattered
from ..plots.style import BETTER, COLOURS, INK, WORSE, page

if TYPE_CHECKING:
    from .studies.cases import Case

Rows = Mapping[str, Mapping[str, Mapping[str, float | None]]]
"""Title of a panel -> label of a group -> label of a bar -> value."""
ROW_HEIGHT, CELL = 0.15, 1.6
"""Inches of a row of ratios, and of a picture."""
DOTS = 1500
"""Points of a cloud that are drawn, at most."""
# What is across, what is up, and what is near, of the camera's axes (x right, y down, z away).
SIDES = {
    "from the camera's right": np.array([(0, 0, 1), (0, -1, 0), (1, 0, 0)], dtype=np.float64),
    "from above": np.array([(1, 0, 0), (0, 0, 1), (0, -1, 0)], dtype=np.float64),
}


def draw_bars(path: Path, panels: Rows, overwrite: bool = False) -> None:
    """A panel below the other, a group of bars for each row. Raises InputError if ``path`` cannot be written to."""
    from matplotlib import colormaps

    bars_of = {
        title: list(dict.fromkeys(bar for row in rows.values() for bar in row))
        for title, rows in panels.items()
    }
    heights = [
        0.6 + (0.2 + 0.13 * len(bars_of[title])) * len(rows) for title, rows in panels.items()
    ]
    with page(path, overwrite, (8.6, sum(heights)), dpi=100) as figure:
        axes = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
        for axis, (title, rows) in zip(axes, panels.items(), strict=True):
            labels = bars_of[title]
            colours = (
                COLOURS
                if len(labels) <= len(COLOURS)
                else colormaps["viridis"](np.linspace(0.0, 0.95, len(labels)))
            )
            height = 0.8 / len(labels)
            for j, label in enumerate(labels):
                places = np.arange(len(rows)) + (j - (len(labels) - 1) / 2) * height
                values = np.array([row.get(label) for row in rows.values()], dtype=float)
                bars = axis.barh(places, values, 0.9 * height, color=colours[j], label=label)
                axis.bar_label(
                    bars,
                    ["" if np.isnan(value) else f"{value:.3g}" for value in values],
                    fontsize=7,
                    padding=3,
                )
            axis.set_yticks(range(len(rows)), list(rows), fontsize=8)
            axis.invert_yaxis()
            axis.margins(x=0.1)
            axis.set_title(title, fontsize=9)
            axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)


@dataclass(frozen=True)
class Panel:
    """``rows`` : label -> Chamfer after / before of each case. ``references`` : label -> a dashed bar, the paper's."""

    title: str
    rows: Mapping[str, Sequence[float] | np.ndarray]
    references: Mapping[str, float] = field(default_factory=dict)


def draw_ratios(path: Path, grid: Sequence[Sequence[Panel]], overwrite: bool) -> None:
    """Panels in rows that share their labels; a case that got worse is red, the line is at 1."""
    labels = [list(dict.fromkeys(label for panel in row for label in panel.rows)) for row in grid]
    heights = [0.5 + ROW_HEIGHT * len(names) for names in labels]
    columns = max(map(len, grid))
    rng = np.random.default_rng(0)
    with page(path, overwrite, (2.5 + 2.4 * columns, 0.4 + sum(heights)), dpi=100) as figure:
        axes = figure.subplots(len(grid), columns, squeeze=False, height_ratios=heights)
        for axis in axes.flat:
            axis.set_yticks([])
        for row, names, panels in zip(axes, labels, grid, strict=True):
            for axis, panel in zip(row, panels, strict=False):
                for label, ratios in panel.rows.items():
                    y, values = names.index(label), np.asarray(ratios)
                    spread = y + rng.uniform(-0.25, 0.25, len(values))
                    axis.scatter(
                        values,
                        spread,
                        s=8,
                        c=np.where(values > 1.0, WORSE, BETTER),
                        alpha=0.5,
                        linewidths=0,
                    )
                    axis.plot([values.mean()] * 2, [y - 0.36, y + 0.36], color=INK, linewidth=2)
                    if label in panel.references:
                        axis.plot(
                            [panel.references[label]] * 2,
                            [y - 0.36, y + 0.36],
                            color=INK,
                            linewidth=1,
                            linestyle=":",
                        )
                axis.axvline(1.0, color=INK, linewidth=0.8, zorder=0)
                axis.set_title(panel.title, fontsize=9)
                axis.set_ylim(len(names) - 0.5, -0.5)
                axis.tick_params(labelsize=8)
            for axis in row[len(panels) :]:
                axis.set_xticks([])
            row[0].set_yticks(range(len(names)), names, fontsize=7)
        figure.supxlabel("Chamfer after / before of each case, and their mean", fontsize=9)


def draw_cases(
    path: Path, cases: Sequence[tuple[str, Case, Array]], overwrite: bool = False
) -> None:
    """A row for each (title, case, refined points).

    The mask with the silhouette's outline before and after, then both clouds and the truth from two sides. Raises InputError if
    ``path`` cannot be written to.
    """
    columns = 2 + 3 * len(SIDES)
    with page(path, overwrite, (CELL * columns, (CELL + 0.4) * len(cases)), dpi=80) as figure:
        axes = figure.subplots(len(cases), columns, squeeze=False)
        for row, (title, case, refined) in zip(axes, cases, strict=True):
            view = case.views[0]
            box = common_window([(points, view) for points in (case.initial, refined)])
            for axis, points, name in zip(
                row, (case.initial, refined), ("initial", "refined"), strict=False
            ):
                window = in_window(points, view, box)
                axis.imshow(1.0 - 0.45 * window.mask, cmap="gray", vmin=0.0, vmax=1.0)
                if window.silhouette.any() and not window.silhouette.all():
                    axis.contour(window.silhouette, levels=[0.5], colors=WORSE, linewidths=1.2)
                axis.set_title(f"mask, {name} outline", fontsize=8)
            shown = {"initial": case.initial, "refined": refined, "truth": case.target}
            for i, (side, directions) in enumerate(SIDES.items()):
                clouds = {
                    name: points @ view.camera.R.T @ directions.T for name, points in shown.items()
                }
                for axis, name in zip(row[2 + 3 * i :], clouds, strict=False):
                    _draw_cloud(axis, clouds[name], list(clouds.values()))
                    axis.set_title(f"{name}\n{side}", fontsize=8)
            for axis in row:
                axis.set(xticks=[], yticks=[])
            row[0].text(0.0, 1.25, title, transform=row[0].transAxes, fontsize=9)


def _draw_cloud(axis: Any, points: Array, frame: Sequence[Array]) -> None:
    """``points`` [N, 3] across, up and towards the eye; all clouds of ``frame`` share one frame."""
    low, high = (np.array([getattr(cloud, end)(0) for cloud in frame]) for end in ("min", "max"))
    middle, half = (
        (low.min(0) + high.max(0)) / 2.0,
        float((high.max(0) - low.min(0))[:2].max()) * 0.54,
    )
    across, up, near = (scattered(points, DOTS) - middle).T
    order = np.argsort(near)
    axis.scatter(across[order], up[order], s=2.2, c=near[order], cmap="viridis", linewidths=0)
    axis.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
