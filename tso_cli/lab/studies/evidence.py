"""How far other evidence than one right mask of the whole object helps a refinement, or misleads it."""

from __future__ import annotations

import zlib
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...network.model import BaseNetwork
from ..charts.ratios import Panel, draw_ratios
from ..study import CHECKPOINT, COMMON, DEVICE, VIEWS, Cases, Option, Progress, Record, Study, Table, part, record_of
from .accuracy import CATEGORIES
from .accuracy_cases import AccuracyCase, CaseBuilder, kinds_of
from .accuracy_variants import Variant, alone, refined
from .evidence_cases import Truth
from .evidence_questions import QUESTIONS, Question
from .parts import Shape, shapes_of_part, view_aligned_network, weights_hash
from .summary import rounded

SIZE, POINTS = 64, 1024
"""Pixels of the masks each way, points of the clouds."""
CONVENTION = {
    "ratio": "Chamfer distance after / before, mean of the cases' own; squared distances, mean over points, forward + "
    "backward, longest side 1, to as many target points; worse: cases over 1",
    "IoU": "of mask and silhouette after, mean",
    "without a plane": "share of the cases whose refinement used no mirror plane",
    "trust in the fourth": "1, or less where the other views contradict the fourth, mean",
    "corrected": "share of the cameras that --refine-camera corrected",
    "degrees left": "angle between the cameras that were used and the true ones, mean",
}
FIGURES = ("cases", "mean_ratio", "worst_ratio", "worse")
"""What the summary has of every row; the rest depends on the question."""
ALL = "all"
"""The mean over all cases of a kind, whatever their category."""


def run(
    progress: Progress, *, meshes: Path, checkpoint: Path, split: Path | None, questions: tuple[str, ...], **settings: Any
) -> Record:
    """Ask each question of every case that it is about; errors are those of the study of accuracy."""
    asked = {name: QUESTIONS[name] for name in questions}
    of_any = {name for question in asked.values() for name in question.categories or CATEGORIES}
    categories = [name for name in CATEGORIES if name in of_any]
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    by_category = {name: [shape for shape in shapes if shape.category == name] for name in categories}
    uses_network = any("network" in question.kinds for question in asked.values())
    network, about = view_aligned_network(checkpoint) if uses_network else (None, None)
    builder = CaseBuilder(meshes, split, settings["views"], SIZE, POINTS, settings["seed"], network, about)
    settings |= {
        "questions": list(questions),
        "network": weights_hash(network) if network else None,
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
        return judge(name, asked[name], built, settings["seed"], settings["device"], network)

    def record(cases: Cases, complete: bool) -> Record:
        return record_of("evidence", CONVENTION, complete=complete, settings=settings, summary=summarise(cases), cases=cases)

    groups = [
        None if all((name, kind, shape.name) in done for shape in group) else partial(judged, name, kind, group)
        for name, question in asked.items()
        for kind in question.kinds
        for category, group in by_category.items()
        if category in (question.categories or CATEGORIES) and kind in kinds_of(category, question.kinds)
    ]
    return progress.complete("refining", cases, groups, record)


def judge(
    name: str,
    question: Question,
    cases: list[tuple[AccuracyCase, Truth]],
    seed: int,
    device: str,
    network: BaseNetwork | None,
) -> Cases:
    """Every row of a question for cases of one kind and category; a row that a case cannot have is left out of it."""
    keys = ("kind", "category", "shape", "view")
    records: Cases = [{"question": name, **{key: getattr(case, key) for key in keys}, "rows": {}} for case, _ in cases]
    for label, row in question.rows.items():
        # The same random numbers for each row: what is compared differs in nothing else.
        altered = [row.alter(case, truth, _rng(seed, name, case)) for case, truth in cases]
        numbers = [number for number, case in enumerate(altered) if case is not None]
        changed = [case for case in altered if case is not None]
        if isinstance(row.variant, Variant):
            results = refined(changed, row.variant, device, network)[0] if changed else []
        else:
            results = [alone(case, row.variant(case), device, network)[0] for case in changed]
        for number, case, result in zip(numbers, changed, results, strict=True):
            figures: dict[str, Any] = {"before": case.chamfer_of(case.initial), "chamfer": case.chamfer_of(result.points)}
            figures |= {key: measure(cases[number][0], case, result) for key, measure in question.measures.items()}
            records[number]["rows"][label] = rounded(figures)
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


def tables(record: Record) -> list[Table]:
    """A table for each question."""
    result = []
    for question, kinds in record["summary"].items():
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
    grid: dict[str, dict[str, dict[str, list[float]]]] = {}
    for case in record["cases"]:
        panel = grid.setdefault(case["question"], {}).setdefault(case["kind"], {})
        for label, figures in case["rows"].items():
            panel.setdefault(label, []).append(figures["chamfer"] / figures["before"])
    panels = [[Panel(f"{question}, {kind}", rows) for kind, rows in kinds.items()] for question, kinds in grid.items()]
    draw_ratios(path, panels, overwrite, row_height=0.112)


STUDY = Study(
    "evidence",
    "Objects in larger photos (framing), depth maps (depth), photos of painted objects (colours), objects of which a part is "
    "missing (missing), wrong views among right ones (wrong), cameras that are off (cameras), predictions whose distance is "
    "not known (placing), the learning rates of the network's variants (rates), and starts that are meshes (meshes).",
    (
        *COMMON,
        CHECKPOINT,
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
