"""How far evidence other than one right mask of the whole object helps, or misleads."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from tso_cli.evaluation.metrics import chamfer
from tso_cli.refinement import RefineConfig, RefineResult

from .. import options
from ..charts import Panel, draw_ratios
from ..study import Cases, Plan, Progress, Record, Study, Table
from . import evidence_maps
from .cases import Case, CaseBuilder, kinds_of
from .evidence_alterations import Alter, Truth, unaltered, with_depth, without
from .refining import Variant, refined
from .shapes import Shape, shapes_of_part
from .summary import grouped, rounded, summarised

SIZE, POINTS = 64, 1024
"""Pixels of the masks each way, points of the clouds."""
PLANES, NAMED, IGNORED = "no mirror plane", "named", "ignored"
CONVENTION = {
    "ratio": "Chamfer distance after / before, mean of the cases' ratios; squared distances, mean "
    "over points, forward + backward, longest side 1, to as many target points; worse: cases with "
    "a ratio over 1",
    PLANES: "share of the cases whose refinement used none",
    NAMED: "share of the cases in which it was said what the depth map holds",
    IGNORED: "share of the cases in which the depth map was left out",
}
FIGURES = {"cases": "cases", "mean_ratio": "ratio", "worst_ratio": "worst", "worse": "worse"}
ALL = "all"
Rows = dict[str, tuple[Alter, Variant]]
"""By label: how a case is altered, and how it is then refined."""


@dataclass(frozen=True)
class Question:
    """Rows that are compared on cases of some kinds and categories.

    more : further figures by their names: means of a number of each result and its row's label.
    """

    title: str
    kinds: tuple[str, ...]
    rows: Rows
    categories: tuple[str, ...]
    more: dict[str, Callable[[RefineResult, str], float]] = field(default_factory=dict)


def no_plane(result: RefineResult, label: str) -> float:
    """1 if the refinement used no mirror plane."""
    return float(result.symmetry.plane is None)


AUTO = Variant()
ONE, TWO = Variant(RefineConfig(symmetry="none")), Variant(RefineConfig(symmetry="none"), 2)
DEPTH_ROWS: Rows = {
    "mask, no symmetry": (unaltered, ONE),
    "mask and depth, no symmetry": (with_depth, ONE),
    "mask, symmetry auto": (unaltered, AUTO),
    "mask and depth, symmetry auto": (with_depth, AUTO),
    "mask and depth with noise of 0.01, no symmetry": (partial(with_depth, noise=0.01), ONE),
    "mask and depth with noise of 0.03, no symmetry": (partial(with_depth, noise=0.03), ONE),
    "two masks, no symmetry": (unaltered, TWO),
    "two masks and their depths, no symmetry": (with_depth, TWO),
}
LACKING: dict[str, Alter] = {
    "whole": unaltered,
    "one side missing": partial(without, part="side"),
    "upper part of a side missing": partial(without, part="high"),
    "lower part of a side missing": partial(without, part="low"),
}
MISSING_ROWS: Rows = {
    f"{name}; symmetry {plane}": (alter, variant)
    for (name, alter), (plane, variant) in product(
        LACKING.items(), {"none": ONE, "auto": AUTO}.items()
    )
}
THREE = ("chair", "airplane", "car")
QUESTIONS = {
    "depth": Question("Depth maps", ("other", "near"), DEPTH_ROWS, THREE),
    "missing": Question(
        "Objects that lack a part",
        ("other",),
        MISSING_ROWS,
        (*THREE, "sofa"),
        {PLANES: no_plane},
    ),
    "maps": Question(
        "Depth maps that hold something else",
        ("other",),
        evidence_maps.rows(),
        THREE,
        {NAMED: evidence_maps.named, IGNORED: evidence_maps.ignored},
    ),
}


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    questions: dict[str, Question] = QUESTIONS,
    **settings: Any,
) -> Plan:
    """Ask each question of every case that it is about; InputError where a shape is missing."""
    named = (name for question in questions.values() for name in question.categories)
    categories = list(dict.fromkeys(named))
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    groups = {name: [shape for shape in shapes if shape.category == name] for name in categories}
    seed = settings["seed"]
    builder = CaseBuilder(meshes, split, settings["views"], SIZE, POINTS, seed)
    settings |= {"points": POINTS, "size": SIZE}
    settings["rows"] = {name: list(question.rows) for name, question in questions.items()}
    settings["shapes"] = [shape.name for group in groups.values() for shape in group]

    def refine_group(name: str, kind: str, group: list[Shape]) -> Cases:
        truths = map(Truth, group)
        cases = [(case, truth) for truth in truths for case in builder.cases(truth.shape, kind)]
        return refine_rows(name, questions[name], cases, seed)

    jobs = []
    for name, question in questions.items():
        for kind, (category, group) in product(question.kinds, groups.items()):
            if category in question.categories and kind in kinds_of(category, question.kinds):
                shared = {"question": name, "kind": kind, "shape": group[0].name}
                jobs.append((shared, partial(refine_group, name, kind, group)))
    return Plan(settings, jobs)


def refine_rows(name: str, question: Question, cases: list[tuple[Case, Truth]], seed: int) -> Cases:
    """Every row of a question for cases of one kind and category.

    Where a case cannot be altered as a row asks, the row is left out of it.
    """
    records: Cases = [{"question": name, **case.names, "rows": {}} for case, _ in cases]
    for label, (alter, variant) in question.rows.items():
        altered = []
        for number, (case, truth) in enumerate(cases):
            # The same random numbers for each row: rows differ in nothing else.
            key = [seed, zlib.crc32(f"{name} {case.shape}".encode()), case.view]
            changed = alter(case, truth, np.random.default_rng(key))
            if changed is not None:
                altered.append((number, changed))
        results = refined([case for _, case in altered], variant) if altered else []
        for (number, case), result in zip(altered, results, strict=True):
            row = {
                "before": chamfer(case.initial, case.target).chamfer,
                "chamfer": chamfer(result.points, case.target).chamfer,
            }
            row |= {name: number(result, label) for name, number in question.more.items()}
            records[number]["rows"][label] = rounded(row)
    return records


def conclude(cases: Cases) -> Record:
    """{"summary": {question: {kind: {"all": {row: {"cases", ...}}}}}}, of all categories."""
    figures = lambda of_kind: {ALL: _means(of_kind)}  # noqa: E731
    return {"summary": summarised(cases, ("question", "kind"), figures)}


def _means(cases: Cases) -> Record:
    """By row; a case may lack some."""
    means = {}
    for label in dict.fromkeys(label for case in cases for label in case["rows"]):
        rows = [case["rows"][label] for case in cases if label in case["rows"]]
        ratios = np.array([row["chamfer"] / row["before"] for row in rows])
        figures: Record = {"cases": len(rows), "worse": int((ratios > 1.0).sum())}
        figures |= {"mean_ratio": float(ratios.mean()), "worst_ratio": float(ratios.max())}
        for key in rows[0]:
            if key not in ("before", "chamfer"):
                figures[key] = float(np.mean([row[key] for row in rows]))
        means[label] = rounded(figures)
    return means


def tables(record: Record) -> list[Table]:
    """A table for each question."""
    result = []
    for question, kinds in record["summary"].items():
        asked = QUESTIONS[question]
        columns = FIGURES | {name: name for name in asked.more}
        rows = [
            [kind, label, *map(figures.get, columns)]
            for kind, groups in kinds.items()
            for label, figures in groups[ALL].items()
        ]
        header = ["kind", question, *columns.values()]
        result.append(Table(header, rows, title=asked.title))
    return result


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Chamfer after / before of every case: a row of panels for each question."""
    grid = []
    for question, cases in grouped(record["cases"], "question").items():
        panels = []
        for kind, of_kind in grouped(cases, "kind").items():
            ratios: dict[str, list[float]] = {}
            for label in record["summary"][question][kind][ALL]:
                rows = [case["rows"][label] for case in of_kind if label in case["rows"]]
                ratios[label] = [row["chamfer"] / row["before"] for row in rows]
            panels.append(Panel(f"{question}, {kind}", ratios))
        grid.append(panels)
    draw_ratios(path, grid, overwrite)


STUDY = Study(
    name="evidence",
    about="Depth maps (depth), objects that lack a part (missing), and depth maps that hold "
    "something else than depth (maps).",
    parts=("pictures", "points, best"),
    tables=tables,
    draw=draw,
    reading="Each question alters cases in one way and compares rows that see the same random "
    "numbers. Right evidence helps: more masks, and depth. Where an object lacks a part that its "
    "start has, a mirror plane gains less, and does harm to few. A depth map that holds something "
    "else is mostly named or left out; a map of another picture often is not.",
    convention=CONVENTION,
    options=(*options.COMMON, options.part("validation"), options.views(2)),
    plan=plan,
    conclude=conclude,
)
