"""How far other evidence than one right mask of the whole object helps a refinement, or misleads it."""

from __future__ import annotations

import zlib
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.metrics import chamfer
from ..charts.ratios import Panel, draw_ratios
from ..study import COMMON, DEVICE, VIEWS, Cases, Option, Progress, Record, Study, Table, part, record_of
from .accuracy_cases import AccuracyCase, CaseBuilder, kinds_of
from .accuracy_variants import refined
from .evidence_cases import Truth
from .evidence_questions import CATEGORIES, QUESTIONS, Question
from .parts import Shape, shapes_of_part
from .summary import rounded

SIZE, POINTS = 64, 1024
"""Pixels of the masks each way, points of the clouds."""
CONVENTION = {
    "ratio": "Chamfer distance after / before, mean of the cases' own; squared distances, mean over points, forward + "
    "backward, longest side 1, to as many target points; worse: cases over 1",
    "without a plane": "share of the cases whose refinement used no mirror plane",
    "trust in the fourth": "1, or less where the other views contradict the fourth, mean",
    "corrected": "share of the cameras that --refine-camera corrected",
    "degrees left": "angle between the cameras that were used and the true ones, mean",
}
FIGURES = ("cases", "mean_ratio", "worst_ratio", "worse")
ALL = "all"


def run(progress: Progress, *, meshes: Path, split: Path | None, questions: tuple[str, ...], **settings: Any) -> Record:
    """Ask each question of every case that it is about; errors are those of the study of accuracy."""
    asked = {name: QUESTIONS[name] for name in questions}
    categories = [name for name in CATEGORIES if any(name in question.categories for question in asked.values())]
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    by_category = {name: [shape for shape in shapes if shape.category == name] for name in categories}
    builder = CaseBuilder(meshes, split, settings["views"], SIZE, POINTS, settings["seed"])
    settings |= {
        "questions": list(questions),
        "points": POINTS,
        "size": SIZE,
        "rows": {name: list(question.rows) for name, question in asked.items()},
        "shapes": [shape.name for group in by_category.values() for shape in group],
    }
    cases = progress.earlier_cases("evidence", settings)
    done = {(case["question"], case["kind"], case["shape"]) for case in cases}

    def judged(name: str, kind: str, group: list[Shape]) -> Cases:
        built = [
            (case, Truth(shape, group[(place + 1) % len(group)] if len(group) > 1 else None))
            for place, shape in enumerate(group)
            for case in builder.cases(shape, kind)
        ]
        return judge(name, asked[name], built, settings["seed"], settings["device"])

    def record(cases: Cases, complete: bool) -> Record:
        return record_of("evidence", CONVENTION, complete=complete, settings=settings, summary=summarise(cases), cases=cases)

    groups = [
        None if all((name, kind, shape.name) in done for shape in group) else partial(judged, name, kind, group)
        for name, question in asked.items()
        for kind in question.kinds
        for category, group in by_category.items()
        if category in question.categories and kind in kinds_of(category, question.kinds)
    ]
    return progress.complete("refining", cases, groups, record)


def judge(name: str, question: Question, cases: list[tuple[AccuracyCase, Truth]], seed: int, device: str) -> Cases:
    """Every row of a question for cases of one kind and category; a row that a case cannot have is left out of it."""
    keys = ("kind", "category", "shape", "view")
    records: Cases = [{"question": name, **{key: getattr(case, key) for key in keys}, "rows": {}} for case, _ in cases]
    for label, (alter, variant) in question.rows.items():
        # The same random numbers for each row: what is compared differs in nothing else.
        altered = [alter(case, truth, _rng(seed, name, case)) for case, truth in cases]
        numbers = [number for number, case in enumerate(altered) if case is not None]
        changed = [case for case in altered if case is not None]
        results = refined(changed, variant, device, None) if changed else []
        for number, case, result in zip(numbers, changed, results, strict=True):
            before, after = (chamfer(points, case.target).chamfer for points in (case.initial, result.points))
            further = {key: measure(cases[number][0], case, result) for key, measure in question.measures.items()}
            records[number]["rows"][label] = rounded({"before": before, "chamfer": after, **further})
    return records


def _rng(seed: int, question: str, case: AccuracyCase) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(f"{question} {case.shape}".encode()), case.view])


def summarise(cases: Cases) -> dict[str, Any]:
    """{question: {kind: {category, and "all": {row: {"cases", "mean_ratio", "worst_ratio", "worse", ...}}}}}."""
    summary: dict[str, Any] = {}
    for case, category in [(case, case["category"]) for case in cases] + [(case, ALL) for case in cases]:
        rows = summary.setdefault(case["question"], {}).setdefault(case["kind"], {}).setdefault(category, {})
        for label, figures in case["rows"].items():
            rows.setdefault(label, []).append(figures)
    for kinds in summary.values():
        for categories in kinds.values():
            for category, rows in categories.items():
                categories[category] = {label: _means(figures) for label, figures in rows.items()}
    return summary


def _means(figures: Cases) -> dict[str, Any]:
    ratios = np.array([row["chamfer"] / row["before"] for row in figures])
    columns = {key: [row[key] for row in figures] for key in figures[0] if key not in ("before", "chamfer")}
    means = {key: float(np.mean(values)) for key, values in columns.items() if None not in values}
    counts = {"cases": len(figures), "worse": int((ratios > 1.0).sum())}
    return rounded({**counts, "mean_ratio": float(ratios.mean()), "worst_ratio": float(ratios.max()), **means})


def _known(record: Record) -> dict[str, Any]:
    """The summary by question; older records have questions that are no longer asked."""
    return {question: kinds for question, kinds in record["summary"].items() if question in QUESTIONS}


def tables(record: Record) -> list[Table]:
    """A table for each question."""
    result = []
    for question, kinds in _known(record).items():
        rows = [
            (kind, category, label, figures)
            for kind, categories in kinds.items()
            for category, rows in categories.items()
            for label, figures in rows.items()
        ]
        # Not every row has everything: of three views there is no fourth.
        further = list(dict.fromkeys(key for *_, figures in rows for key in figures if key not in FIGURES))
        cells = [[*names, *(figures.get(key) for key in (*FIGURES, *further))] for *names, figures in rows]
        header = ["kind", "category", question, "cases", "ratio", "worst", "worse", *further]
        result.append(Table(header, cells, title=QUESTIONS[question].title))
    return result


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Chamfer after / before of every case; a row of panels for each question, a panel for each kind."""
    grid = []
    for question, kinds in _known(record).items():
        panels = []
        for kind, categories in kinds.items():
            cases = [case["rows"] for case in record["cases"] if (case["question"], case["kind"]) == (question, kind)]
            rows = {label: [case[label] for case in cases if label in case] for label in categories[ALL]}
            ratios = {label: [row["chamfer"] / row["before"] for row in figures] for label, figures in rows.items()}
            panels.append(Panel(f"{question}, {kind}", ratios))
        grid.append(panels)
    draw_ratios(path, grid, overwrite)


STUDY = Study(
    "evidence",
    "Depth maps (depth), photos of painted objects (colours), objects of which a part is missing (missing), wrong views among "
    "right ones (wrong), and cameras that are off (cameras).",
    (
        *COMMON,
        part("validation"),
        Option("--question", "May be repeated.", str, tuple(QUESTIONS), tuple(QUESTIONS), multiple=True, name="questions"),
        VIEWS,
        DEVICE,
    ),
    run,
    tables,
    draw,
    "Each question alters cases in one way and compares rows that see the same random numbers. Evidence that is right "
    "helps: more masks, depth, a photo of an object whose colours are known. What matters as much is the harm that wrong "
    "evidence does: a method that weighs its evidence loses little to one wrong view, camera or plane.",
    kept="after every group of shapes",
)
