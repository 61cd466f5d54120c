"""`tso bench stability`: how wrong the input may be, and whether the tool says so."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path
from textwrap import fill

import numpy as np

from ...errors import InputError
from ...io.clouds import read_cloud
from ...io.output import check_output
from ...io.shipped import examples_folder
from ...refinement import RefineConfig
from ...scene.load import load_points_scene
from ..charts import draw_cases
from ..studies.accuracy import CATEGORIES
from ..studies.cases import MASKS, Case, CaseBuilder
from ..studies.refining import DEFAULT, FOUR_MASKS, POINTS, Variant
from ..studies.shapes import shapes_of_part
from ..studies.summary import grouped, summarised
from ..study import SEED, SPLIT, Cases, Option, Plan, Progress, Record, Study, Table
from ..views import views_around
from .axes import AXES, Axis
from .chart import draw
from .knees import AXIS, FIGURES, SILENT, WORSE, got_worse, knee
from .runs import Way, judge, outcomes_of, run_of

# What other packages, and with --quick other variants, are compared on.
COMPARED = ("nothing wrong", "mask dilated", "yaw of the camera", "start far off")
CORRECTED_ON = ("nothing wrong", "yaw of the camera")
GROUPS = ("settings", "mask", "camera", "cloud", "image")
# With --quick every second level, without those that take long by themselves: points, pixels, steps.
MOST = {"points": 20_000, "px": 1024, "steps": 200}
SHAPES, SIZE, COUNT = 2, 128, 1024
"""Of each category; pixels of a mask each way; points of a cloud."""
PICTURED = ("mask", "camera", "cloud")
ROWS_OF_GROUP, TITLE = 3, 28
"""Pictures of each, and characters across one's title."""
CONVENTION = {
    "ratio": "Chamfer distance after / before, squared distances, mean over points, forward + backward, longest side 1; of the "
    "cloud's own points, without added ones; before is the start as it was given, altered",
    "works": f"median ratio up to {WORSE}, at most 5 % of the runs over {WORSE}; fails: median over {WORSE}, or most refused",
    "warns": "a warning, a doubt or a refusal in at least half of the runs, at this level and at all harder ones that fail",
    "said": "of each run: - nothing, w a warning, d doubted by the tool, r refused, n not finite",
    "took": "seconds; moved: mean of the points, longest sides",
    "runs": "all seeds of the first case, of the second, ...; null: none; verdict: first letter of the result's, if it has one",
    "p95, worst, worse, silent": f"of the runs that were not refused, shares of all: over {WORSE}, and that without a word",
}


@cache
def example_cases() -> list[Case]:
    """The shipped examples; further masks of each are silhouettes of the true cloud from around it."""
    cases = []
    for category in ("chair", "car", "airplane"):
        folder = examples_folder() / category
        scene, target = (
            load_points_scene(folder / "initial.ply", folder / "mask.png"),
            read_cloud(folder / "target.ply").points,
        )
        views = tuple(views_around(scene.view, target, 2.0 * np.pi * np.arange(1, MASKS) / MASKS))
        cases.append(
            Case(
                "example",
                category,
                category,
                0,
                "initial.ply",
                scene.points,
                target,
                target,
                views,
                float("nan"),
            )
        )
    return cases


def plan(
    progress: Progress,
    *,
    quick: bool,
    meshes: Path | None,
    split: Path | None,
    pictures: Path | None,
    seed: int,
) -> Plan:
    """Every axis with the default preset; fewer levels and seeds with the other variants, and some axes with peers.

    Raises InputError without ``meshes``, unless ``quick``.
    """
    if pictures is not None:
        check_output(pictures, progress.overwrite)
    if quick:
        names, cases_of, seeds = ["chair", "car", "airplane"], example_cases, [seed]
    else:
        if meshes is None:
            raise InputError(
                "--meshes is missing, expected a folder of meshes (or --quick, for the shipped examples)"
            )
        shapes = shapes_of_part(meshes, split, "test", CATEGORIES, SHAPES)
        builder = CaseBuilder(meshes, split, 1, SIZE, COUNT, seed)
        names, seeds = [shape.name for shape in shapes], [seed, seed + 1]

        @cache
        def cases_of() -> list[Case]:
            return [case for shape in shapes for case in builder.cases(shape, "other")]

    settings = {"quick": quick, "seed": seed, "seeds": len(seeds), "shapes": names}

    def judge_axis(axis: Axis, name: str, way: Way) -> Cases:
        in_full = name == DEFAULT and not quick
        levels = axis.levels if in_full else fewer_levels(axis)
        return judge(cases_of(), seeds if name == DEFAULT else seeds[:1], axis, name, way, levels)

    jobs = [
        ({"axis": axis.name, "variant": name}, partial(judge_axis, axis, name, way))
        for axis in AXES
        for name, way in _ways(axis, quick).items()
    ]

    def draw_worst(record: Record) -> None:
        if pictures is not None:
            draw_cases(pictures, _worst(record["cases"], cases_of(), seeds), progress.overwrite)

    return Plan(settings, jobs, finish=draw_worst)


def fewer_levels(axis: Axis) -> Sequence[float]:
    """Every second level, or the only one, without those that take long."""
    return [
        level for level in axis.levels[1::2] or axis.levels if level <= MOST.get(axis.unit, np.inf)
    ]


def _ways(axis: Axis, quick: bool) -> dict[str, Way]:
    """The default preset; other variants where nothing else is asked for by the axis, and peers on some."""
    compared, plain = (
        axis.name in (COMPARED[::3] if quick else COMPARED),
        axis.group != "settings" and axis.masks == 1,
    )
    ways: dict[str, Way] = (
        dict(POINTS) if compared or (plain and not quick) else {DEFAULT: POINTS[DEFAULT]}
    )
    if quick:
        ways.pop(FOUR_MASKS, None)
    if axis.name in CORRECTED_ON:
        ways["best, camera corrected"] = Variant(RefineConfig(refine_camera=True))
    if compared:
        from .peers import PEERS

        ways |= PEERS
    return ways


def _worst(
    rows: Cases, cases: Sequence[Case], seeds: Sequence[int]
) -> list[tuple[str, Case, np.ndarray]]:
    """Of some groups the axes whose silent results are worst, refined once more: (title, altered case, points)."""
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
            ratio, level, run = worst[name]
            number, seed = divmod(run, len(seeds))
            (outcome,) = outcomes_of(
                [run_of(cases, AXIS[name], level, number, seeds[seed])], POINTS[DEFAULT]
            )
            if outcome.altered is not None and outcome.points is not None:
                title = f"{name} {AXIS[name].at(level)}: {ratio:.3g}, {outcome.altered.category}"
                pictured.append((fill(title, TITLE), outcome.altered, outcome.points))
    return pictured


def conclude(cases: Cases) -> Record:
    """{"knees": {variant: {axis: knee}}, and of the default preset "silence", shares of runs that got worse without a word, and
    "halves" of the axes, from harmless to hopeless}."""
    knees = summarised(cases, ("variant", "axis"), knee)
    silence = {}
    for what, gross in (("gross mistakes", True), ("other mistakes", False)):
        rows = [
            row for row in cases if row["variant"] == DEFAULT and AXIS[row["axis"]].gross == gross
        ]
        runs = sum(len(row["said"]) for row in rows)
        shares = {
            key: sum(row[key] * len(row["said"]) for row in rows) / max(1, runs)
            for key in ("refused", "worse", "silent")
        }
        silence[what] = {"runs": runs, **{key: round(share, 4) for key, share in shares.items()}}
    ours = [row for row in cases if row["variant"] == DEFAULT]
    halves = {
        group: _halves(rows)
        for group in GROUPS
        if (rows := [row for row in ours if AXIS[row["axis"]].group == group])
    }
    return {"knees": knees, "silence": silence, "halves": halves}


def _halves(rows: Cases) -> Record:
    """Of axes with several levels: axes, those with a worse case in the harmless half, and in the other worse runs, flagged."""
    axes = worse_axes = worse = flagged = 0
    for of_axis in grouped(rows, "axis").values():
        if len(of_axis) > 1:
            middle = len(of_axis) // 2
            axes += 1
            worse_axes += any(_worse(row) for row in of_axis[:middle])
            words = [word for row in of_axis[middle:] for word in _worse(row)]
            worse, flagged = worse + len(words), flagged + sum(word != SILENT for word in words)
    return {"axes": axes, "harmless_worse": worse_axes, "hopeless_worse": worse, "flagged": flagged}


def _worse(row: Record) -> list[str]:
    """What became of each run that got worse."""
    return [
        word
        for ratio, word in zip(row["ratio"], row["said"], strict=True)
        if got_worse(ratio, word)
    ]


def tables(record: Record) -> list[Table]:
    """The figures of every level of the default preset, of the other ways all together, the knees, and the silence."""
    rows = [
        [row["axis"], AXIS[row["axis"]].at(row["level"]), *_figures(row)]
        for row in record["cases"]
        if row["variant"] == DEFAULT
    ]
    several = {row["axis"] for row in record["cases"] if row["variant"] != DEFAULT}.intersection(
        COMPARED
    )
    chosen = [
        row
        for row in record["cases"]
        if row["axis"] in several and row["level"] in fewer_levels(AXIS[row["axis"]])
    ]
    chosen.sort(key=lambda row: (COMPARED.index(row["axis"]), row["level"]))
    compared = [
        [row["axis"], AXIS[row["axis"]].at(row["level"]), row["variant"], *_figures(row)]
        for row in chosen
    ]
    words = [
        [AXIS[name].group, name, found["words"]] for name, found in record["knees"][DEFAULT].items()
    ]
    silence = [[what, *row.values()] for what, row in record["silence"].items()]
    halves = [[group, *row.values()] for group, row in record["halves"].items()]
    return [
        Table(["axis", "level", *FIGURES], rows, "Default preset", decimals=2),
        Table(["axis", "level", "by", *FIGURES], compared, "Variants and other ways", decimals=2),
        Table(["", "axis", "knee"], words, "Knees of the default preset"),
        Table(
            ["default preset", "runs", "refused", "worse", "worse, without a word"],
            silence,
            decimals=3,
        ),
        Table(
            [
                "wrong is",
                "axes",
                "harmless half: with a worse run",
                "other half: worse runs",
                "flagged",
            ],
            halves,
        ),
    ]


def _figures(row: Record) -> list[float | None]:
    return [row[name] for name in FIGURES]


STUDY = Study(
    name="stability",
    parts=("pictures", "points, paper", "points, best"),
    tables=tables,
    draw=draw,
    reading="One difficulty at a time, from harmless to hopeless: in full on the test split; --quick takes the shipped "
    "examples and every second level. Colours are medians of Chamfer after / before, triangles say where the tool speaks up: "
    "red without a triangle is harm that nobody is told of. The paper's own failures are among the axes: too wide a sigma^2 "
    "and thin objects (narrow aeroplanes), a start that is flat along the line of sight (cars deformed in depth).",
    convention=CONVENTION,
    options=(
        Option("--quick", "Shipped examples, every second level, one seed.", bool, False),
        Option(
            "--meshes",
            "Folder with CATEGORY/NAME for every name of the split; not with --quick.",
            Path,
        ),
        SPLIT,
        SEED,
        Option("--pictures", "Draw results that are worst without a word here (.png).", Path),
    ),
    plan=plan,
    conclude=conclude,
)
