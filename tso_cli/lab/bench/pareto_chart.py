"""The chart of `tso bench pareto`: ratio against seconds, with the front, and labels that do not cover one another."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

from ...plots.style import COLOURS, INK, PALE, page
from ..stability.peers import PEERS
from ..studies.refining import Variant
from ..study import Record
from .ways import (
    CLOUD,
    DEFAULT,
    PAPER,
    PREDICTION,
    PUBLISHED,
    PUBLISHED_SECONDS,
    STARTS,
    STEPS,
    WAYS,
)

MODES = {
    "points": COLOURS[0],
    "encoder": COLOURS[4],
    "encoder-decoder": COLOURS[2],
    "latent": COLOURS[3],
}
OTHERS = "#777777"
# Where a label may stand: points from its place, and to which side; beside it rather than far from it.
SPOTS = [
    (distance, side)
    for distance in (6, 14, 24, 36, 50)
    for side in product((1, -1, 0), (1, -1, 0))
    if any(side)
]
ACROSS, UP = {1: "left", 0: "center", -1: "right"}, {1: "bottom", 0: "center", -1: "top"}


def draw(path: Path, record: Record, overwrite: bool) -> None:
    """Ratio against seconds, logarithmic, a panel for each start."""
    from matplotlib.lines import Line2D
    from matplotlib.ticker import LogLocator, NullFormatter

    # Predictions gain little: with more masks than one on the axis, the modes of the network could not be told apart.
    shown = {
        kind: {
            **group,
            "ways": {
                name: row
                for name, row in group["ways"].items()
                if kind == CLOUD or WAYS[name].masks == 1
            },
        }
        for kind, group in record["summary"].items()
    }
    with page(path, overwrite, (9.0, 5.8), dpi=100) as figure:
        axes = figure.subplots(1, len(shown), squeeze=False)[0]
        for axis, (kind, group) in zip(axes, shown.items(), strict=True):
            _draw_ways(axis, group)
            if kind == PREDICTION:
                middle, half = sum(PUBLISHED) / 2, (PUBLISHED[1] - PUBLISHED[0]) / 2
                axis.errorbar(
                    PUBLISHED_SECONDS, middle, half, fmt="D", color=INK, capsize=4, markersize=5
                )
            axis.set(title=STARTS[kind], xscale="log")
            axis.margins(x=0.12)
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_formatter(NullFormatter())
        axes[0].set_ylabel("Chamfer distance after / before")
        figure.supxlabel(
            "median seconds an object, one thread; bars: standard error over shapes", fontsize=9
        )
        handles = [
            Line2D([], [], color=colour, marker="o", label=f"{mode} mode")
            for mode, colour in MODES.items()
        ]
        handles += [
            Line2D(
                [],
                [],
                color=INK,
                marker="o",
                markerfacecolor="white",
                ls="--",
                label="hollow: the paper's preset",
            ),
            Line2D(
                [],
                [],
                color=OTHERS,
                marker="X",
                ls="",
                label="other ways, with the paper's descent",
            ),
            Line2D([], [], color=INK, marker="D", ls="", label="as the paper reports"),
            Line2D([], [], color=PALE, linewidth=6, label="Pareto front, one mask"),
        ]
        figure.legend(
            handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=8
        )
        figure.draw_without_rendering()  # labels are placed in pixels: the axes must stand where they will
        for axis, (kind, group) in zip(axes, shown.items(), strict=True):
            _label(axis, group, others=kind == CLOUD)


def _place(row: Record) -> tuple[float, float]:
    return row["median_seconds"], row["mean_ratio"]


def _lines(group: Record) -> dict[str, list[str]]:
    """Line -> its ways, in the order of what is swept; sweeps of other things than steps go through the default."""
    lines: dict[str, list[str]] = {}
    for name in group["ways"]:
        lines.setdefault(
            WAYS[name].line or name, [] if (WAYS[name].line or name) in group["ways"] else [DEFAULT]
        ).append(name)
    return {
        line: sorted(
            names,
            key=lambda name: (WAYS[name].points, WAYS[name].size, WAYS[name].masks, _spent(name)),
        )
        for line, names in lines.items()
    }


def _spent(name: str) -> tuple[bool, bool, str]:
    """The order of the budgets: seconds, auto, full."""
    run = WAYS[name].run
    budget = str(run.config.budget) if isinstance(run, Variant) else ""
    return budget == "full", budget == "auto", budget


def _draw_ways(axis: Any, group: Record) -> None:
    ways = group["ways"]
    axis.plot(
        *zip(*(_place(ways[name]) for name in group["front"]), strict=True),
        color=PALE,
        linewidth=7,
        alpha=0.6,
        zorder=1,
    )
    axis.axhline(1.0, color=INK, linewidth=0.8, zorder=0)
    for line, names in _lines(group).items():
        run = WAYS[names[0]].run
        colour, preset = (
            (MODES[run.config.mode], run.config.preset)
            if isinstance(run, Variant)
            else (OTHERS, "")
        )
        seconds, ratios = zip(*(_place(ways[name]) for name in names), strict=True)
        axis.errorbar(
            seconds,
            ratios,
            [ways[name]["standard_error"] for name in names],
            color=colour,
            elinewidth=0.5,
            linestyle="--" if preset == "paper" else "-" if line in ways else ":",
            linewidth=1.3,
            marker="o" if preset else "X",
            markersize=5,
            markerfacecolor="white" if preset == "paper" else colour,
            zorder=3,
        )
    axis.plot(
        *_place(ways[DEFAULT]),
        "*",
        color=MODES["points"],
        markersize=16,
        markeredgecolor="white",
        zorder=4,
    )


def _label(axis: Any, group: Record, others: bool) -> None:
    """Name the presets of points mode, the front, the ends of sweeps, and single ways; of ``others`` if asked."""
    from matplotlib.patheffects import withStroke
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    ways, renderer = group["ways"], axis.figure.canvas.get_renderer()
    ends = [names[-1] for line, names in _lines(group).items() if line not in STEPS]
    budgets = [name for name in ways if WAYS[name].line == "budget"]
    named = [
        name
        for name in dict.fromkeys([DEFAULT, PAPER, *group["front"], *budgets, *ends])
        if others or name not in PEERS
    ]
    centres = [axis.transData.transform(_place(row)) for row in ways.values()]
    taken = [Bbox.from_bounds(x - 4, y - 4, 8, 8) for x, y in centres]
    for name in named:
        text = {DEFAULT: "default", PAPER: "paper"}.get(
            name, name.removeprefix(f"{DEFAULT}, ").replace("points, paper, ", "")
        )
        for distance, (across, up) in SPOTS:
            note = axis.annotate(
                text.replace(", best", ""),
                _place(ways[name]),
                (across * distance, up * distance),
                textcoords="offset points",
                ha=ACROSS[across],
                va=UP[up],
                fontsize=8,
                color=INK,
                weight="bold" if name == DEFAULT else "normal",
                arrowprops={"arrowstyle": "-", "color": OTHERS, "linewidth": 0.5}
                if distance > SPOTS[0][0]
                else None,
                path_effects=[withStroke(linewidth=2.5, foreground="white")],
                zorder=5,
            )
            note.set_in_layout(False)
            note.update_positions(renderer)
            box = Text.get_window_extent(note, renderer)  # without the line to it
            inside = (
                axis.bbox.containsx(box.x0)
                and axis.bbox.containsx(box.x1)
                and axis.bbox.containsy(box.y1)
            )
            if inside and not any(map(box.overlaps, taken)):
                taken.append(box)
                break
            note.remove()
