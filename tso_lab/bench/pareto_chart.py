"""The chart of `tso lab pareto`: ratio against seconds, and the front."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

from tso_cli.plots.style import COLOURS, INK, PALE, page

from ..studies.refining import Variant
from ..study import Record
from .peers import PEERS
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
# Where a label may stand: points from its place, and on which side; the nearest spots first.
SPOTS = [
    (distance, side)
    for distance in (6, 14, 24, 36, 50)
    for side in product((1, -1, 0), (1, -1, 0))
    if any(side)
]
ACROSS, UP = {1: "left", 0: "center", -1: "right"}, {1: "bottom", 0: "center", -1: "top"}


def draw(path: Path, record: Record, overwrite: bool) -> None:
    """Ratio against seconds, a panel for each start."""
    from matplotlib.ticker import LogLocator, NullFormatter

    # Predictions gain little: with several masks on the axis, the modes would fall together.
    panels: Record = {}
    for kind, group in record["summary"].items():
        ways = {
            name: row
            for name, row in group["ways"].items()
            if kind == CLOUD or WAYS[name].masks == 1
        }
        panels[kind] = {"ways": ways, "front": [name for name in group["front"] if name in ways]}
    with page(path, overwrite, (9.0, 5.8), dpi=100) as figure:
        axes = figure.subplots(1, len(panels), squeeze=False)[0]
        for axis, (kind, group) in zip(axes, panels.items(), strict=True):
            _draw_ways(axis, group)
            if kind == PREDICTION:
                middle, half = sum(PUBLISHED) / 2, (PUBLISHED[1] - PUBLISHED[0]) / 2
                style = {"fmt": "D", "color": INK, "capsize": 4, "markersize": 5}
                axis.errorbar(PUBLISHED_SECONDS, middle, half, **style)
            axis.set(title=STARTS[kind], xscale="log")
            axis.margins(x=0.12)
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_formatter(NullFormatter())
        axes[0].set_ylabel("Chamfer distance after / before")
        text = "median seconds an object, one thread; bars: standard error over shapes"
        figure.supxlabel(text, fontsize=9)
        style = {"loc": "outside upper center", "ncols": 4, "frameon": False, "fontsize": 8}
        figure.legend(handles=_legend(), **style)
        figure.draw_without_rendering()  # labels are placed in pixels: the axes must stand first
        for axis, (kind, group) in zip(axes, panels.items(), strict=True):
            _label(axis, group, others=kind == CLOUD)


def _legend() -> list[Any]:
    from matplotlib.lines import Line2D

    hollow = {"marker": "o", "markerfacecolor": "white", "ls": "--"}
    styles: dict[str, Any] = {
        **{f"{mode} mode": {"color": colour, "marker": "o"} for mode, colour in MODES.items()},
        "hollow: the paper's preset": {"color": INK, **hollow},
        "other ways, with the paper's steps": {"color": OTHERS, "marker": "X", "ls": ""},
        "as the paper reports": {"color": INK, "marker": "D", "ls": ""},
        "Pareto front, one mask": {"color": PALE, "linewidth": 6},
    }
    return [Line2D([], [], label=label, **style) for label, style in styles.items()]


def _place(row: Record) -> tuple[float, float]:
    return row["median_seconds"], row["mean_ratio"]


def lines(group: Record) -> dict[str, list[str]]:
    """Line -> its ways, in the order of what is swept.

    Sweeps of anything but steps go through the default.
    """
    found: dict[str, list[str]] = {}
    for name in group["ways"]:
        line = WAYS[name].line or name
        found.setdefault(line, [] if line in group["ways"] else [DEFAULT]).append(name)
    return {line: sorted(names, key=_order) for line, names in found.items()}


def _order(name: str) -> tuple[int, int, int]:
    """Points, pixels, masks."""
    way = WAYS[name]
    return way.points, way.size, way.masks


def _draw_ways(axis: Any, group: Record) -> None:
    ways = group["ways"]
    front = zip(*(_place(ways[name]) for name in group["front"]), strict=True)
    axis.plot(*front, color=PALE, linewidth=7, alpha=0.6, zorder=1)
    axis.axhline(1.0, color=INK, linewidth=0.8, zorder=0)
    for line, names in lines(group).items():
        run = WAYS[names[0]].run
        colour, preset = OTHERS, ""
        if isinstance(run, Variant):
            colour, preset = MODES[run.config.mode], run.config.preset
        seconds, ratios = zip(*(_place(ways[name]) for name in names), strict=True)
        errors = [ways[name]["standard_error"] for name in names]
        dashes = "--" if preset == "paper" else "-" if line in ways else ":"
        face = "white" if preset == "paper" else colour
        style = {"linestyle": dashes, "linewidth": 1.3, "elinewidth": 0.5, "zorder": 3}
        style |= {"marker": "o" if preset else "X", "markersize": 5, "markerfacecolor": face}
        axis.errorbar(seconds, ratios, errors, color=colour, **style)
    star = {"color": MODES["points"], "markersize": 16, "markeredgecolor": "white", "zorder": 4}
    axis.plot(*_place(ways[DEFAULT]), "*", **star)


def _label(axis: Any, group: Record, others: bool) -> None:
    """Name the presets, the front, the ends of sweeps and single ways; ``others`` : peers too."""
    from matplotlib.patheffects import withStroke
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    ways, renderer = group["ways"], axis.figure.canvas.get_renderer()
    ends = [names[-1] for line, names in lines(group).items() if line not in STEPS]
    centres = [axis.transData.transform(_place(row)) for row in ways.values()]
    taken = [Bbox.from_bounds(x - 4, y - 4, 8, 8) for x, y in centres]
    style = {"fontsize": 8, "color": INK, "textcoords": "offset points", "zorder": 5}
    style |= {"path_effects": [withStroke(linewidth=2.5, foreground="white")]}
    arrow = {"arrowstyle": "-", "color": OTHERS, "linewidth": 0.5}
    for name in dict.fromkeys([DEFAULT, PAPER, *group["front"], *ends]):
        if name in PEERS and not others:
            continue
        weight = "bold" if name == DEFAULT else "normal"
        for distance, (across, up) in SPOTS:
            note = axis.annotate(
                _short(name),
                _place(ways[name]),
                (across * distance, up * distance),
                ha=ACROSS[across],
                va=UP[up],
                weight=weight,
                arrowprops=arrow if distance > SPOTS[0][0] else None,
                **style,
            )
            note.set_in_layout(False)
            note.update_positions(renderer)
            box = Text.get_window_extent(note, renderer)  # without the line to it
            frame = axis.bbox
            inside = frame.containsx(box.x0) and frame.containsx(box.x1)
            if inside and frame.containsy(box.y1) and not any(map(box.overlaps, taken)):
                taken.append(box)
                break
            note.remove()


def _short(name: str) -> str:
    if name in (DEFAULT, PAPER):
        return "default" if name == DEFAULT else "paper"
    text = name.removeprefix(f"{DEFAULT}, ").replace("points, paper, ", "")
    return text.replace(", best", "")
