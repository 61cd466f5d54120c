"""The charts of the studies: bars, ratios of cases, and pictures of cases."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tso_cli.evaluation.footprint import Solid, common_window, in_window
from tso_cli.geometry.points import Array, scattered
from tso_cli.plots.style import BETTER, COLOURS, INK, WORSE, page

if TYPE_CHECKING:
    from .studies.cases import Case
    from .study import Draw

Rows = Mapping[str, Mapping[str, Mapping[str, float | None]]]
"""Title of a panel -> label of a group of bars -> label of a bar -> value."""
# Inches.
ROW_HEIGHT, PICTURE_SIZE = 0.15, 1.6
MOST_POINTS = 1500
"""Of a cloud that are drawn."""
# Which of the camera's axes (x right, y down, z away) point across, up and towards the eye.
SIDES = {
    "from the camera's right": np.array([(0, 0, 1), (0, -1, 0), (1, 0, 0)], dtype=np.float64),
    "from above": np.array([(1, 0, 0), (0, 0, 1), (0, -1, 0)], dtype=np.float64),
}


def bars(panels: Callable[[Any], Rows], log: bool = False) -> Draw:
    """What draws a record's ``panels`` one below the other, a group of bars for each row."""

    def draw(path: Path, record: Any, overwrite: bool = False) -> None:
        from matplotlib import colormaps

        titles = panels(record)
        bars_of = {
            title: list(dict.fromkeys(bar for row in rows.values() for bar in row))
            for title, rows in titles.items()
        }
        heights = [
            0.6 + (0.2 + 0.13 * len(bars_of[title])) * len(titles[title]) for title in titles
        ]
        with page(path, overwrite, (8.6, sum(heights)), dpi=100) as figure:
            axes = figure.subplots(len(titles), 1, squeeze=False, height_ratios=heights)[:, 0]
            for axis, (title, rows) in zip(axes, titles.items(), strict=True):
                labels = bars_of[title]
                shades = colormaps["viridis"](np.linspace(0.0, 0.95, len(labels)))
                colours = COLOURS if len(labels) <= len(COLOURS) else shades
                height = 0.8 / len(labels)
                for j, label in enumerate(labels):
                    places = np.arange(len(rows)) + (j - (len(labels) - 1) / 2) * height
                    values = np.array([row.get(label) for row in rows.values()], dtype=float)
                    drawn = axis.barh(places, values, 0.9 * height, color=colours[j], label=label)
                    texts = ["" if np.isnan(value) else digits(value) for value in values]
                    axis.bar_label(drawn, texts, fontsize=7, padding=3)
                axis.set_yticks(range(len(rows)), list(rows), fontsize=8)
                axis.invert_yaxis()
                axis.margins(x=0.1)
                axis.set_xscale("log" if log else "linear")
                axis.set_title(title, fontsize=9)
                legend_beside(axis)

    return draw


def legend_beside(axis: Any) -> None:
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)


def digits(value: float) -> str:
    """Three digits, without powers of ten."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


@dataclass(frozen=True)
class Panel:
    """``rows`` : label -> Chamfer after / before of each case.

    ``references`` : label -> the paper's value, a dotted bar.
    """

    title: str
    rows: Mapping[str, Sequence[float] | np.ndarray]
    references: Mapping[str, float] = field(default_factory=dict)


def ratios(grid: Callable[[Any], Sequence[Sequence[Panel]]]) -> Draw:
    """What draws a record's ``grid``: rows of panels that share their labels.

    Red dots are cases that got worse.
    """

    def draw(path: Path, record: Any, overwrite: bool = False) -> None:
        rows = grid(record)
        labels = [list(dict.fromkeys(name for panel in row for name in panel.rows)) for row in rows]
        heights = [0.5 + ROW_HEIGHT * len(names) for names in labels]
        columns = max(map(len, rows))
        rng = np.random.default_rng(0)
        with page(path, overwrite, (2.5 + 2.4 * columns, 0.4 + sum(heights)), dpi=100) as figure:
            axes = figure.subplots(len(rows), columns, squeeze=False, height_ratios=heights)
            for axis in axes.flat:
                axis.set_yticks([])
            for row, names, panels in zip(axes, labels, rows, strict=True):
                for axis, panel in zip(row, panels, strict=False):
                    _draw_panel(axis, panel, names, rng)
                for axis in row[len(panels) :]:
                    axis.set_xticks([])
                row[0].set_yticks(range(len(names)), names, fontsize=7)
            figure.supxlabel("Chamfer after / before of each case, and their mean", fontsize=9)

    return draw


def _draw_panel(axis: Any, panel: Panel, names: list[str], rng: np.random.Generator) -> None:
    for label, ratios in panel.rows.items():
        y, values = names.index(label), np.asarray(ratios)
        colours = np.where(values > 1.0, WORSE, BETTER)
        spread = y + rng.uniform(-0.25, 0.25, len(values))
        axis.scatter(values, spread, s=8, c=colours, alpha=0.5, linewidths=0)
        bar = [y - 0.36, y + 0.36]
        axis.plot([values.mean()] * 2, bar, color=INK, linewidth=2)
        if label in panel.references:
            axis.plot([panel.references[label]] * 2, bar, color=INK, linewidth=1, linestyle=":")
    axis.axvline(1.0, color=INK, linewidth=0.8, zorder=0)
    axis.set_title(panel.title, fontsize=9)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.tick_params(labelsize=8)


def draw_cases(
    path: Path, cases: Sequence[tuple[str, Case, Array]], overwrite: bool = False
) -> None:
    """A row for each (title, case, refined points).

    The mask with the outline of the silhouette before and after, then both clouds and the truth
    from two sides. Raises InputError if ``path`` cannot be written to.
    """
    columns = 2 + 3 * len(SIDES)
    size = PICTURE_SIZE * columns, (PICTURE_SIZE + 0.4) * len(cases)
    with page(path, overwrite, size, dpi=80) as figure:
        axes = figure.subplots(len(cases), columns, squeeze=False)
        for row, (title, case, refined) in zip(axes, cases, strict=True):
            clouds = {"initial": case.initial, "refined": refined, "truth": case.target}
            _draw_outlines(row, case, clouds)
            for i, (side, directions) in enumerate(SIDES.items()):
                turn = case.views[0].camera.R.T @ directions.T
                turned = {name: points @ turn for name, points in clouds.items()}
                for axis, name in zip(row[2 + 3 * i :], turned, strict=False):
                    _draw_cloud(axis, turned[name], list(turned.values()))
                    axis.set_title(f"{name}\n{side}", fontsize=8)
            for axis in row:
                axis.set(xticks=[], yticks=[])
            row[0].text(0.0, 1.25, title, transform=row[0].transAxes, fontsize=9)


def _draw_outlines(row: Any, case: Case, clouds: Mapping[str, Array]) -> None:
    view, names = case.views[0], ("initial", "refined")
    box = common_window([(Solid(clouds[name]), view) for name in names])
    for axis, name in zip(row, names, strict=False):
        window = in_window(Solid(clouds[name]), view, box)
        axis.imshow(1.0 - 0.45 * window.mask, cmap="gray", vmin=0.0, vmax=1.0)
        if window.silhouette.any() and not window.silhouette.all():
            axis.contour(window.silhouette, levels=[0.5], colors=WORSE, linewidths=1.2)
        axis.set_title(f"mask, {name} outline", fontsize=8)


def _draw_cloud(axis: Any, points: Array, frame: Sequence[Array]) -> None:
    """``points`` [N, 3] across, up and towards the eye; clouds of ``frame`` share one frame."""
    low = np.min([cloud.min(0) for cloud in frame], axis=0)
    high = np.max([cloud.max(0) for cloud in frame], axis=0)
    middle, half = (low + high) / 2.0, float((high - low)[:2].max()) * 0.54
    across, up, near = (scattered(points, MOST_POINTS) - middle).T
    order = np.argsort(near)
    axis.scatter(across[order], up[order], s=2.2, c=near[order], cmap="viridis", linewidths=0)
    axis.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
