"""`tso lab stability`: how wrong the input may be, and whether tso warns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from ...errors import InputError
from ...io.clouds import read_cloud
from ...io.shipped import examples_folder
from ...plots.style import INK, PALE, page
from ...pose.asked import Asked
from ...refinement import RefineConfig
from ...scene.load import load_points_scene
from .. import options
from ..charts import pictures_at
from ..options import Option
from ..studies.accuracy import CATEGORIES
from ..studies.cases import MASKS, Case, CaseBuilder
from ..studies.refining import DEFAULT, FOUR_MASKS, POINTS, Variant
from ..studies.shapes import shapes_of_part
from ..studies.summary import grouped, summarised
from ..study import Cases, Plan, Progress, Record, Study, Table
from ..views import views_around
from .axes import AXES, Axis
from .knees import AXIS, SILENT, WORSE, fails, got_worse, knee, warns
from .runs import Way, level_rows, outcomes_of, run_of

# Axes that other packages, and with --quick other variants, are compared on.
COMPARED = ("nothing wrong", "mask dilated", "yaw of the camera", "start far off")
# Axes on which something moves as one, in each of these ways.
MOVED_ON = ("nothing wrong", "yaw of the camera", "start far off")
MOVES: tuple[Asked, ...] = ("shape", "pose", "camera")
GROUPS = ("settings", "mask", "camera", "cloud", "image")
# With --quick every second level, up to these, which take long by themselves.
HIGHEST_LEVEL = {"points": 20_000, "px": 1024, "steps": 200}
SHAPES, SIZE, COUNT = 2, 128, 1024
"""Of each category; pixels of a mask each way; points of a cloud."""
PICTURED, ROWS_OF_GROUP, TITLE_WIDTH = ("mask", "camera", "cloud"), 3, 28
"""Groups of which the worst axes are drawn, how many of each, and characters across a title."""
# Largest ratio -> colour and its name: better, hardly changed, worse, far worse.
SHADES = {
    0.7: ("#1a9850", "to 0.7"),
    0.95: ("#91cf60", "to 0.95"),
    WORSE: ("#d9ef8b", f"to {WORSE:g}, as before"),
    1.5: ("#fdae61", "to 1.5"),
    3.0: ("#f46d43", "to 3"),
    np.inf: ("#d73027", "above"),
}
ROW_HEIGHT = 0.17
"""Inches."""
CONVENTION = {
    "ratio": "Chamfer distance after / before, squared distances, mean over points, forward + "
    "backward, longest side 1; of the cloud's own points, without added ones; before: the start as "
    "it was given, altered",
    "works": f"median ratio up to {WORSE}, at most 5 % of the runs over {WORSE}; fails: median "
    f"over {WORSE}, or most are refused",
    "warns": "a warning, a doubtful verdict or a refusal in at least half of the runs, at this "
    "level and at all harder ones that fail",
    "said": "of each run: - nothing, w a warning, d doubtful, r refused, n not finite",
    "runs": "all seeds of the first case, of the second, ...; null: none",
    "worse, silent": f"shares of all runs: over {WORSE}, and over it without a warning",
}


@cache
def example_cases() -> list[Case]:
    """The shipped examples; further masks are silhouettes of the true cloud from around it."""
    cases, angles = [], 2.0 * np.pi * np.arange(1, MASKS) / MASKS
    for category in ("chair", "car", "airplane"):
        folder = examples_folder() / category
        scene = load_points_scene(folder / "initial.ply", folder / "mask.png")
        target = read_cloud(folder / "target.ply").points
        views = tuple(views_around(scene.view, target, angles))
        names = ("example", category, category, 0, "initial.ply")
        cases.append(Case(*names, scene.points, target, target, views, float("nan")))
    return cases


def plan(
    progress: Progress,
    *,
    quick: bool,
    meshes: Path | None,
    split: Path | None,
    pictures: Path | None,
    seed: int,
    axes: Sequence[Axis] = AXES,
    compared: Sequence[str] = COMPARED,
) -> Plan:
    """Every axis with the default preset; some levels with the other variants, and peers on some.

    Raises InputError without ``meshes``, unless ``quick``.
    """
    if quick:
        names, cases_of, seeds = ["chair", "car", "airplane"], example_cases, [seed]
    elif meshes is None:
        raise InputError("--meshes is missing, expected a folder of meshes, or --quick")
    else:
        shapes = shapes_of_part(meshes, split, "test", CATEGORIES, SHAPES)
        builder = CaseBuilder(meshes, split, 1, SIZE, COUNT, seed)
        names, seeds = [shape.name for shape in shapes], [seed, seed + 1]

        @cache
        def cases_of() -> list[Case]:
            return [case for shape in shapes for case in builder.cases(shape, "other")]

    settings = {"quick": quick, "seed": seed, "seeds": len(seeds), "shapes": names}

    def refine_axis(axis: Axis, name: str, way: Way) -> Cases:
        in_full = name == DEFAULT and not quick
        levels = axis.levels if in_full else fewer_levels(axis)
        own_seeds = seeds if name == DEFAULT else seeds[:1]
        return level_rows(cases_of(), own_seeds, axis, name, way, levels)

    jobs = [
        ({"axis": axis.name, "variant": name}, partial(refine_axis, axis, name, way))
        for axis in axes
        for name, way in _ways(axis, quick, compared).items()
    ]

    def worst(record: Record) -> list[tuple[str, Case, np.ndarray]]:
        return _worst(record["cases"], cases_of(), seeds)

    return Plan(settings, jobs, finish=pictures_at(pictures, progress.overwrite, worst))


def fewer_levels(axis: Axis) -> Sequence[float]:
    """Every second level, or the only one, without those that take long."""
    most = HIGHEST_LEVEL.get(axis.unit, np.inf)
    return [level for level in axis.levels[1::2] or axis.levels if level <= most]


def _ways(axis: Axis, quick: bool, compared: Sequence[str]) -> dict[str, Way]:
    """The default preset; other variants where the axis asks for none, and peers on some."""
    of_interest = axis.name in (compared[::3] if quick else compared)
    plain = axis.group != "settings" and axis.masks == 1 and not quick
    ways: dict[str, Way] = dict(POINTS) if of_interest or plain else {DEFAULT: POINTS[DEFAULT]}
    if quick:
        ways.pop(FOUR_MASKS, None)
    if axis.name in MOVED_ON:
        ways |= {f"best, move {move}": Variant(RefineConfig(move=move)) for move in MOVES}
    if of_interest:
        from .peers import PEERS

        ways |= PEERS
    return ways


def _worst(
    rows: Cases, cases: Sequence[Case], seeds: Sequence[int]
) -> list[tuple[str, Case, np.ndarray]]:
    """(title, altered case, points) of the worst results without a warning, refined once more."""
    pictured = []
    for group in PICTURED:
        worst: dict[str, tuple[float, float, int]] = {}
        for row in rows:
            if row["variant"] == DEFAULT and AXIS[row["axis"]].group == group:
                found = [
                    (ratio, row["level"], i)
                    for i, ratio in enumerate(row["ratio"])
                    if ratio and row["said"][i] == SILENT
                ]
                worst[row["axis"]] = max([*found, worst.get(row["axis"], (0.0, 0.0, 0))])
        for name in sorted(worst, key=lambda name: -worst[name][0])[:ROWS_OF_GROUP]:
            ratio, level, place = worst[name]
            number, seed = divmod(place, len(seeds))
            run = run_of(cases, AXIS[name], level, number, seeds[seed])
            (outcome,) = outcomes_of([run], POINTS[DEFAULT])
            if outcome.altered is not None and outcome.points is not None:
                title = f"{name} {AXIS[name].at(level)}: {ratio:.3g}, {outcome.altered.category}"
                pictured.append((fill(title, TITLE_WIDTH), outcome.altered, outcome.points))
    return pictured


def conclude(cases: Cases) -> Record:
    """{"knees": {variant: {axis: knee}}, "halves" of the axes of each group}.

    The halves, from harmless to hopeless, are of the default preset.
    """
    ours = [row for row in cases if row["variant"] == DEFAULT]
    halves = {}
    for group in GROUPS:
        rows = [row for row in ours if AXIS[row["axis"]].group == group]
        if rows:
            halves[group] = _halves(rows)
    knees = summarised(cases, ("variant", "axis"), knee)
    return {"knees": knees, "halves": halves}


def _halves(rows: Cases) -> Record:
    """Of the hopeless halves of axes: the runs, those that got worse, and those without a word."""
    runs = [
        (word, got_worse(ratio, word))
        for of_axis in grouped(rows, "axis").values()
        if len(of_axis) > 1
        for row in of_axis[len(of_axis) // 2 :]
        for ratio, word in zip(row["ratio"], row["said"], strict=True)
    ]
    worse = [word for word, is_worse in runs if is_worse]
    return {"runs": len(runs), "worse": len(worse), "silent": worse.count(SILENT)}


def tables(record: Record) -> list[Table]:
    """The axes with the default preset, some of them with other ways, and the warnings."""
    knees = record["knees"]
    axes = [[AXIS[name].group, *_cells(name, found)] for name, found in knees[DEFAULT].items()]
    several = [name for name in COMPARED if sum(name in of_way for of_way in knees.values()) > 1]
    compared = [
        [way, *_cells(name, of_way[name])]
        for name in several
        for way, of_way in knees.items()
        if name in of_way
    ]
    halves = [[group, *row.values()] for group, row in record["halves"].items()]
    columns = ["harmless up to", "tso warns from", "fails from", "worst", "worse, no warning"]
    note = "worst: largest median ratio of a level; worse, no warning: share of the axis's runs; "
    note += "every run is in the JSON file"
    return [
        Table(["", "axis", *columns], axes, "Default preset", note, decimals=2),
        Table(["by", "axis", *columns], compared, "Other ways", decimals=2),
        Table(
            ["wrong is", "runs", "worse", "worse, no warning"],
            halves,
            "Default preset, the hopeless half of the levels",
            "what is left as it was does not get worse",
        ),
    ]


def _cells(name: str, found: Record) -> list[Any]:
    """The columns of an axis: levels; where it is wrong or not, yes or no."""
    levels = [found[key] for key in ("works_to", "speaks_from", "fails_at")]
    empty, single = ("none", "never", "never"), len(AXIS[name].levels) == 1
    texts = [
        f"{level:g}" if level is not None else no for level, no in zip(levels, empty, strict=True)
    ]
    if single:
        texts = ["no" if level is None else "yes" for level in levels]
    texts[2] += " (refused)" if found["refused"] else ""
    return [AXIS[name].label, *texts, found["worst"], found["silent"]]


def draw(path: Path, record: Record, overwrite: bool) -> None:
    """By the default preset: cells of levels coloured by the median ratio; triangles: warnings."""
    axes = grouped([row for row in record["cases"] if row["variant"] == DEFAULT], "axis")
    columns = max(len(rows) for rows in axes.values())
    groups = [AXIS[name].group for name in axes]
    height = 1.15 + ROW_HEIGHT * (len(axes) + len(set(groups)))
    title = {"fontsize": 8, "weight": "bold", "ha": "right", "va": "center", "color": INK}
    with page(path, overwrite, (10.5, height), dpi=100) as figure:
        axis = figure.subplots()
        y, ticks = -1.0, []
        for i, rows in enumerate(axes.values()):
            if i == 0 or groups[i] != groups[i - 1]:
                y += 1.0
                axis.text(-0.55, y, groups[i], **title)
            y += 1.0
            ticks.append(y)
            for x, row in enumerate(rows):
                _draw_cell(axis, x, y, row)
        axis.set_yticks(ticks, [AXIS[name].label for name in axes], fontsize=7)
        axis.set(xlim=(-0.5, columns - 0.5), ylim=(y + 0.6, -0.6), xticks=[])
        axis.tick_params(left=False)
        axis.spines[["left", "bottom"]].set_visible(False)
        _draw_legend(figure)


def _draw_cell(axis: Any, x: float, y: float, row: Record) -> None:
    refused = row["refused"] > 0.5
    ratio = np.inf if row["median"] is None else row["median"]
    shade = next(colour for limit, (colour, _) in SHADES.items() if ratio <= limit)
    axis.barh(y, 0.96, 0.86, x - 0.48, color=PALE if refused else shade, linewidth=0)
    ink = "white" if not refused and (ratio > 3.0 or ratio <= 0.7) else INK
    level = AXIS[row["axis"]].at(row["level"]).split(" ")[0]
    axis.text(x - 0.44, y, level, fontsize=6, va="center", color=ink)
    if not refused:
        text = f"{ratio:.2f}" if ratio < 10.0 else f"{ratio:.0f}"
        weight = "bold" if fails(row) else "normal"
        style = {"fontsize": 6.5, "va": "center", "ha": "right", "weight": weight}
        axis.text(x + 0.30, y, text, color=ink, **style)
    if warns(row):
        axis.scatter(x + 0.39, y, s=16, marker="^", color=ink, linewidths=0)


def _draw_legend(figure: Any) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Patch(color=colour, label=name) for colour, name in SHADES.values()]
    handles.append(Patch(color=PALE, label="refused by most"))
    handles.append(Line2D([], [], color=INK, marker="^", ls="", label="tso warns"))
    title = "from harmless to hopeless: level, and median Chamfer distance after / before"
    style = {"frameon": False, "fontsize": 8, "title_fontsize": 9}
    place = {"loc": "outside upper center", "ncols": 8}
    figure.legend(handles=handles, title=title, **place, **style)


STUDY = Study(
    name="stability",
    about="One thing wrong at a time, from harmless to hopeless, on the test split; --quick takes "
    "the shipped examples and every second level.",
    parts=("pictures", "points, paper", "points, best"),
    tables=tables,
    draw=draw,
    reading="One thing is wrong at a time, from harmless to hopeless. Colours are medians of "
    "Chamfer after / before, triangles show where tso warns: red without a triangle is harm "
    "without a warning. The paper's own failures are among the axes: too wide a sigma^2 and thin "
    "objects (narrow aeroplanes), a start that is flat along the line of sight (cars deformed in "
    "depth).",
    convention=CONVENTION,
    options=(
        Option("--quick", "Shipped examples, every second level, one seed.", bool, False),
        replace(options.MESHES, required=False),
        options.SPLIT,
        options.SEED,
        options.pictures("the results that are worst without a warning"),
    ),
    plan=plan,
    conclude=conclude,
)
