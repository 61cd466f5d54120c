"""`tso lab harm`: how often a cloud gets worse in the field, and whether tso says so."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tso_cli.errors import InputError, TsoError
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.arrays import Array
from tso_cli.geometry.points import longest_side, root_mean_square
from tso_cli.plots.style import BETTER as GAIN_COLOUR
from tso_cli.plots.style import COLOURS, INK, PALE, page
from tso_cli.plots.style import WORSE as HARM_COLOUR
from tso_cli.refinement import RefineConfig, refine

from .. import options
from ..options import option
from ..studies.summary import grouped, rounded, summarised
from ..study import Cases, Plan, Progress, Record, Study, Table, uninterrupted
from .scenes import STARTS, Gallery, Scene, gallery
from .troubles import TROUBLE, TROUBLES, Trouble

VIEWS, STRENGTHS = (1, 4), 3
STRIDE = 17
"""How many shapes further on each trouble begins."""
WORSE, BETTER = 1.05, 0.95
"""A ratio over or under this is worse or better than the start."""
SILENT, SAID, GAINED, WITHHELD, KEPT = "silent", "said", "gained", "withheld", "kept"
VARIANTS = {
    "default": RefineConfig(),
    "shape": RefineConfig(move="shape"),
    "paper": RefineConfig(preset="paper"),
}
DEFAULT = next(iter(VARIANTS))


def altered(
    gallery: Gallery, trouble: Trouble, start: str, number: int, views: int
) -> tuple[Record, Scene | InputError]:
    """Scene ``number`` of a trouble and start, and what a record calls it.

    An error where the scene cannot even be given to tso.
    """
    place = TROUBLES.index(trouble) * STRIDE + number
    shape, strength = gallery.shape(place), number % STRENGTHS
    views = max(views, trouble.views)
    names: Record = {"trouble": trouble.name, "start": start, "number": number}
    names |= {"strength": strength, "views": views}
    names |= {"shape": shape.name, "category": shape.category}
    names["listed"] = shape.name in gallery.listed
    rng = gallery.rng(trouble.name, start, shape.name, str(number))
    try:
        return names, trouble.apply(gallery.scene(place, start, views), strength, rng)
    except InputError as error:
        return names, error


def scenes_of(
    gallery: Gallery, trouble: Trouble, start: str, count: int
) -> Iterator[tuple[Record, Scene | InputError]]:
    """``count`` scenes, with one and four views in turn; none of a start it is not about."""
    for number in range(count if start in trouble.starts else 0):
        yield altered(gallery, trouble, start, number, VIEWS[number % len(VIEWS)])


def run_row(scene: Scene | InputError, config: RefineConfig) -> Record:
    """The figures of one run."""
    if isinstance(scene, InputError):
        return _refused(scene)
    began = time.perf_counter()
    try:
        result = uninterrupted(refine(scene.initial, scene.views, config=config))
    except TsoError as error:
        return _refused(uninterrupted(error))
    milliseconds = 1000.0 * (time.perf_counter() - began)
    before = distance(scene.initial, scene)
    names = [finding.name.partition("=")[0] for finding in result.findings]
    moved = (result.points - scene.initial)[: scene.own]
    row: Record = {
        "ratio": distance(result.points, scene) / before,
        "before": before,
        "moved": root_mean_square(moved) / own_size(scene),
        "verdict": result.trust.verdict,
        "confidence": result.trust.confidence,
        "outcome": result.fit.outcome,
        "move": result.move.kind,
        "findings": names,
        "suspicious": any(finding.suspicious for finding in result.findings),
        "iou_before": result.fit.iou_before,
        "iou_after": result.fit.iou_after,
        "milliseconds": milliseconds,
    }
    if result.fit.stop_reason == "doubtful":
        accepting = replace(config, accept_doubtful=True)
        accepted = uninterrupted(refine(scene.initial, scene.views, config=accepting))
        row["withheld_ratio"] = distance(accepted.points, scene) / before
    return rounded({**row, "became": became(row)})


def _refused(error: TsoError) -> Record:
    return {"ratio": None, "outcome": "error", "message": str(error)[:120], "became": SAID}


def own_size(scene: Scene) -> float:
    """Longest side of the start's own points."""
    return longest_side(scene.initial[: scene.own])


def distance(points: Array, scene: Scene) -> float:
    """Chamfer distance of the object's own ``points`` to the true surface."""
    return chamfer(points[: scene.own], scene.dense).chamfer


def became(row: Record) -> str:
    """What became of a run that came to an end."""
    if row["ratio"] > WORSE:
        return SAID if row["verdict"] == "doubtful" or row["suspicious"] else SILENT
    if row["ratio"] < BETTER:
        return GAINED
    return WITHHELD if row.get("withheld_ratio", 1.0) < BETTER else KEPT


def rows_of(
    gallery: Gallery, trouble: Trouble, starts: tuple[str, ...], count: int, variant: str
) -> Cases:
    """The rows of a trouble and variant for all ``starts``."""
    return [
        {**names, "variant": variant, **run_row(scene, VARIANTS[variant])}
        for start in starts
        for names, scene in scenes_of(gallery, trouble, start, count)
    ]


# The study.

ALL, LISTED, UNSEEN = "all", "listed", "unseen"
SHARES = {SILENT: "silently worse %", SAID: "worse, said %", WITHHELD: "gain withheld %"}
SEGMENTS = {
    SILENT: ("silently worse", HARM_COLOUR),
    SAID: ("worse and said, or refused as input", COLOURS[4]),
    GAINED: ("better, kept", GAIN_COLOUR),
    WITHHELD: ("a gain withheld", COLOURS[5]),
}
ROW_HEIGHT = 0.13
"""Inches."""
SCENES, QUICK_SCENES = 12, 2


def plan(
    progress: Progress,
    *,
    quick: bool,
    meshes: Path | None,
    split: Path | None,
    part: str,
    unseen: Path | None,
    per: int | None,
    seed: int,
    variants: bool,
    names: Sequence[str],
) -> Plan:
    """A job for each trouble, start and variant; InputError without meshes, unless ``quick``."""
    per = per or (QUICK_SCENES if quick else SCENES)
    if quick:
        meshes = unseen = None
    elif meshes is None and unseen is None:
        raise InputError("--meshes is missing, expected a folder of meshes, or --quick")
    for name in names:
        if name not in TROUBLE:
            raise InputError(f"--trouble is {name!r}, expected some of {', '.join(TROUBLE)}")
    scenes = gallery(meshes, split, part, unseen, seed)
    troubles = [trouble for trouble in TROUBLES if not names or trouble.name in names]
    settings = {"quick": quick, "part": part, "per": per, "seed": seed}
    settings["shapes"] = [shape.name for shape in scenes.shapes]
    jobs = [
        (
            {"trouble": trouble.name, "start": start, "variant": variant},
            partial(rows_of, scenes, trouble, (start,), per, variant),
        )
        for trouble in troubles
        for start in trouble.starts
        for variant in (VARIANTS if variants else (DEFAULT,))
        # The paper's preset knows no depth maps.
        if VARIANTS[variant].preset != "paper" or trouble.group != "depth"
    ]
    return Plan(settings, jobs)


def conclude(cases: Cases) -> Record:
    """{"summary": {variant: {trouble: {start: figures}}}, "strengths": {trouble: {strength: ...}}}.

    Below trouble "all" are the totals, by start and by list. Strengths are of the default variant.
    """
    summary = summarised(cases, ("variant", "trouble", "start"), figures)
    for variant, rows in grouped(cases, "variant").items():
        totals = summarised(rows, ("start",), figures)
        lists = {LISTED: [row for row in rows if row["listed"]]}
        lists[UNSEEN] = [row for row in rows if not row["listed"]]
        totals |= {name: figures(group) for name, group in lists.items() if group}
        summary[variant][ALL] = totals | {ALL: figures(rows)}
    ours = [row for row in cases if row["variant"] == DEFAULT and TROUBLE[row["trouble"]].levels]
    ours = [{**row, "strength": str(row["strength"])} for row in ours]
    ours.sort(key=lambda row: int(row["strength"]))
    strengths = summarised(ours, ("trouble", "start", "strength"), figures)
    return {"summary": summary, "strengths": strengths}


def figures(rows: Cases) -> Record:
    """Of some runs: how many, their mean and worst ratio, and per cent of what they became."""
    ratios = [row["ratio"] for row in rows if row["ratio"] is not None]
    became = [row["became"] for row in rows]
    shares = {name: 100.0 * became.count(name) / len(rows) for name in SEGMENTS}
    mean = float(np.mean(ratios)) if ratios else None
    return rounded({"runs": len(rows), "ratio": mean, "worst": max(ratios, default=None), **shares})


def tables(record: Record) -> list[Table]:
    """By trouble and start, of each variant; by strength; totals."""
    header = ["runs", "mean ratio", "worst", *SHARES.values()]
    result = []
    for variant, troubles in record["summary"].items():
        rows = [
            [name, start, *_cells(row)]
            for name, starts in troubles.items()
            for start, row in starts.items()
            if name != ALL
        ]
        result.append(Table(["trouble", "start", *header], rows, f"Variant {variant}", decimals=2))
    strengths = [
        [name, start, TROUBLE[name].at(int(strength)), *_cells(row)]
        for name, starts in record["strengths"].items()
        for start, by_strength in starts.items()
        for strength, row in by_strength.items()
    ]
    title = "By strength, default variant"
    result.append(Table(["trouble", "start", "how far", *header], strengths, title, decimals=2))
    totals = [
        [variant, name, *_cells(row)]
        for variant, troubles in record["summary"].items()
        for name, row in troubles[ALL].items()
    ]
    result.append(Table(["variant", "runs of", *header], totals, "All troubles", decimals=2))
    return result


def _cells(row: Record) -> list[Any]:
    return [row["runs"], row["ratio"], row["worst"], *(row[name] for name in SHARES)]


def draw(path: Path, record: Record, overwrite: bool) -> None:
    """Per cent of the runs that end in each way: a column of bars for each variant."""
    from matplotlib.patches import Patch

    summary = record["summary"]
    bars = [
        (name, start)
        for name, starts in summary[DEFAULT].items()
        for start in starts
        if start in STARTS
    ]
    size = 2.6 + 3.2 * len(summary), 1.2 + ROW_HEIGHT * (len(bars) + 0.6 * len(summary[DEFAULT]))
    with page(path, overwrite, size, dpi=100) as figure:
        axes = figure.subplots(1, len(summary), squeeze=False, sharey=True)[0]
        places = _places(bars)
        for axis, (variant, troubles) in zip(axes, summary.items(), strict=True):
            for place, (name, start) in zip(places, bars, strict=True):
                _draw_bar(axis, place, troubles.get(name, {}).get(start))
            axis.set_title(f"variant {variant}", fontsize=9)
            axis.set(xlim=(0, 100), ylim=(places[-1] + 0.8, -0.8))
            axis.tick_params(labelsize=7, left=False)
        axes[0].set_yticks(places, [f"{name}, {start}" for name, start in bars], fontsize=7)
        figure.supxlabel("per cent of the runs", fontsize=9)
        handles = [Patch(color=colour, label=label) for label, colour in SEGMENTS.values()]
        where: Any = {"loc": "outside upper center", "ncols": 4 if len(summary) > 1 else 2}
        figure.legend(handles=handles, frameon=False, fontsize=8, **where)


def _places(bars: Sequence[tuple[str, str]]) -> list[float]:
    """Heights of the bars, with a gap between troubles."""
    places = [0.0]
    for before, after in zip(bars[:-1], bars[1:], strict=True):
        places.append(places[-1] + (1.0 if before[0] == after[0] else 1.6))
    return places


def _draw_bar(axis: Any, place: float, row: Record | None) -> None:
    axis.barh(place, 100.0, 0.9, color=PALE, alpha=0.35 if row else 0.0, linewidth=0)
    left = 0.0
    for name, (_, colour) in SEGMENTS.items() if row else ():
        share = row[name] if row else 0.0
        axis.barh(place, share, 0.9, left, color=colour, linewidth=0)
        if name == SILENT and share:
            style = {"fontsize": 6, "va": "center", "ha": "left", "color": INK}
            axis.text(left + 0.5, place, f"{share:.0f}", **style)
        left += share


STUDY = Study(
    name="harm",
    values={"WORSE": WORSE, "BETTER": BETTER},
    more_convention={trouble.name: f"the user {trouble.did}" for trouble in TROUBLES[1:]},
    parts=("pictures", "points, paper", "points, best"),
    tables=tables,
    draw=draw,
    options=(
        option("--quick", "Shipped examples.", bool, False),
        options.meshes(required=False),
        options.SPLIT,
        options.part("validation"),
        options.UNSEEN,
        option("--per", f"Scenes for each trouble and start.  [default: {SCENES}]", int, least=1),
        option(
            "--trouble", "May be repeated.  [default: all]", default=(), multiple=True, name="names"
        ),
        options.SEED,
        option("--variants", "Also without a move as one, and the paper's preset.", bool, False),
    ),
    plan=plan,
    conclude=conclude,
)
