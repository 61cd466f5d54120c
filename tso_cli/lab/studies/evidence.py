"""How far other evidence than one right mask of the whole object helps a refinement, or misleads it."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.metrics import chamfer
from ...refinement import RefineConfig
from ..charts import Panel, draw_ratios
from ..study import COMMON, VIEWS, Cases, Plan, Progress, Record, Study, Table, part
from .cases import Case, CaseBuilder, kinds_of
from .evidence_alterations import Alter, Truth, painted, unaltered, with_depth, without
from .refining import Variant, refined
from .shapes import Shape, shapes_of_part
from .summary import grouped, rounded

SIZE, POINTS = 64, 1024
"""Pixels of the masks each way, points of the clouds."""
PLANES = "no mirror plane"
CONVENTION = {
    "ratio": "Chamfer distance after / before, mean of the cases' own; squared distances, mean over points, forward + "
    "backward, longest side 1, to as many target points; worse: cases over 1",
    PLANES: "share of the cases whose refinement used none",
}
FIGURES = ("cases", "mean_ratio", "worst_ratio", "worse")
ALL = "all"
Rows = dict[str, tuple[Alter, Variant]]
"""By label: how a case is altered, and how it is then refined."""


@dataclass(frozen=True)
class Question:
    """Rows that are compared on cases of some kinds, of `KINDS`, and categories; with ``planes`` so are mirror planes."""

    title: str
    kinds: tuple[str, ...]
    rows: Rows
    categories: tuple[str, ...]
    planes: bool = False


def _variant(masks: int = 1, **settings: object) -> Variant:
    return Variant(RefineConfig(**settings), masks)  # type: ignore[arg-type]


ONE, TWO = _variant(symmetry="none"), _variant(2, symmetry="none")
DEPTH_ROWS: Rows = {
    "mask, no symmetry": (unaltered, ONE),
    "mask and depth, no symmetry": (with_depth, ONE),
    "mask, symmetry auto": (unaltered, _variant()),
    "mask and depth, symmetry auto": (with_depth, _variant()),
    "mask and depth with noise of 0.01, no symmetry": (partial(with_depth, noise=0.01), ONE),
    "mask and depth with noise of 0.03, no symmetry": (partial(with_depth, noise=0.03), ONE),
    "two masks, no symmetry": (unaltered, TWO),
    "two masks and their depths, no symmetry": (with_depth, TWO),
}
STARTS_OF_PAINT = {
    "bent 2": "bent to Chamfer 2",
    "bent 6": "bent to Chamfer 6",
    "other": "another shape, other colours",
}
PHOTOS = {None: "mask", 0.7: "mask and photo, exposure 0.7", 1.4: "mask and photo, exposure 1.4"}
COLOUR_ROWS: Rows = {
    f"{STARTS_OF_PAINT[start]}; {PHOTOS[exposure]}": (
        partial(painted, start=start, exposure=exposure),
        ONE,
    )
    for start, exposure in product(STARTS_OF_PAINT, PHOTOS)
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
        LACKING.items(), (("none", ONE), ("auto", _variant()))
    )
}


THREE = ("chair", "airplane", "car")
QUESTIONS = {
    "depth": Question("Depth maps", ("other", "near"), DEPTH_ROWS, THREE),
    "colours": Question("Photos of painted objects", ("other",), COLOUR_ROWS, THREE),
    "missing": Question(
        "Objects of which a part is missing",
        ("other",),
        MISSING_ROWS,
        (*THREE, "sofa"),
        planes=True,
    ),
}


def plan(progress: Progress, *, meshes: Path, split: Path | None, **settings: Any) -> Plan:
    """Ask each question of every case that it is about; errors are those of the study of accuracy."""
    categories = list(
        dict.fromkeys(name for question in QUESTIONS.values() for name in question.categories)
    )
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    by_category = {
        name: [shape for shape in shapes if shape.category == name] for name in categories
    }
    builder = CaseBuilder(meshes, split, settings["views"], SIZE, POINTS, settings["seed"])
    settings |= {"points": POINTS, "size": SIZE}
    settings["rows"] = {name: list(question.rows) for name, question in QUESTIONS.items()}
    settings["shapes"] = [shape.name for group in by_category.values() for shape in group]

    def judge_group(name: str, kind: str, group: list[Shape]) -> Cases:
        cases = [
            (case, truth)
            for truth in map(Truth, group)
            for case in builder.cases(truth.shape, kind)
        ]
        return judge(name, QUESTIONS[name], cases, settings["seed"])

    jobs = [
        (
            {"question": name, "kind": kind, "shape": group[0].name},
            partial(judge_group, name, kind, group),
        )
        for name, question in QUESTIONS.items()
        for kind in question.kinds
        for category, group in by_category.items()
        if category in question.categories and kind in kinds_of(category, question.kinds)
    ]
    return Plan(settings, jobs)


def judge(name: str, question: Question, cases: list[tuple[Case, Truth]], seed: int) -> Cases:
    """Every row of a question for cases of one kind and category; a row that a case cannot have is left out of it."""
    keys = ("kind", "category", "shape", "view")
    records: Cases = [
        {"question": name, **{key: getattr(case, key) for key in keys}, "rows": {}}
        for case, _ in cases
    ]
    for label, (alter, variant) in question.rows.items():
        # The same random numbers for each row: what is compared differs in nothing else.
        seeds = [
            [seed, zlib.crc32(f"{name} {case.shape}".encode()), case.view] for case, _ in cases
        ]
        altered = [
            alter(case, truth, np.random.default_rng(key))
            for (case, truth), key in zip(cases, seeds, strict=True)
        ]
        numbers = [number for number, case in enumerate(altered) if case is not None]
        changed = [case for case in altered if case is not None]
        results = refined(changed, variant, "cpu", None) if changed else []
        for number, case, result in zip(numbers, changed, results, strict=True):
            before, after = (
                chamfer(points, case.target).chamfer for points in (case.initial, result.points)
            )
            planes = {PLANES: float(result.symmetry is None)} if question.planes else {}
            records[number]["rows"][label] = rounded({"before": before, "chamfer": after, **planes})
    return records


def conclude(cases: Cases) -> Record:
    """{"summary": {question: {kind: {category, and "all": {row: {"cases", "mean_ratio", "worst_ratio", "worse", ...}}}}}}."""
    summary: Record = {}
    for question, asked in grouped(cases, "question").items():
        summary[question] = {}
        for kind, of_kind in grouped(asked, "kind").items():
            groups = {**grouped(of_kind, "category"), ALL: of_kind}
            summary[question][kind] = {
                category: _means(group) for category, group in groups.items()
            }
    return {"summary": summary}


def _means(cases: Cases) -> Record:
    """By row; a case may lack some."""
    means = {}
    for label in dict.fromkeys(label for case in cases for label in case["rows"]):
        rows = [case["rows"][label] for case in cases if label in case["rows"]]
        ratios = np.array([row["chamfer"] / row["before"] for row in rows])
        columns = {
            key: [row[key] for row in rows] for key in rows[0] if key not in ("before", "chamfer")
        }
        averages = {key: float(np.mean(values)) for key, values in columns.items()}
        counts = {"cases": len(rows), "worse": int((ratios > 1.0).sum())}
        means[label] = rounded(
            {
                **counts,
                "mean_ratio": float(ratios.mean()),
                "worst_ratio": float(ratios.max()),
                **averages,
            }
        )
    return means


def tables(record: Record) -> list[Table]:
    """A table for each question."""
    result = []
    for question, kinds in record["summary"].items():
        columns = [*FIGURES, *[PLANES] * QUESTIONS[question].planes]
        rows = [
            [kind, category, label, *map(figures.get, columns)]
            for kind, categories in kinds.items()
            for category, of_category in categories.items()
            for label, figures in of_category.items()
        ]
        header = [
            "kind",
            "category",
            question,
            "cases",
            "ratio",
            "worst",
            "worse",
            *columns[len(FIGURES) :],
        ]
        result.append(Table(header, rows, title=QUESTIONS[question].title))
    return result


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Chamfer after / before of every case; a row of panels for each question, a panel for each kind."""
    grid = []
    for question, cases in grouped(record["cases"], "question").items():
        panels = []
        for kind, of_kind in grouped(cases, "kind").items():
            rows_of = [case["rows"] for case in of_kind]
            ratios = {
                label: [
                    rows[label]["chamfer"] / rows[label]["before"]
                    for rows in rows_of
                    if label in rows
                ]
                for label in record["summary"][question][kind][ALL]
            }
            panels.append(Panel(f"{question}, {kind}", ratios))
        grid.append(panels)
    draw_ratios(path, grid, overwrite)


STUDY = Study(
    name="evidence",
    about="Depth maps (depth), photos of painted objects (colours), and objects of which a part is missing (missing).",
    parts=("pictures", "points, best"),
    tables=tables,
    draw=draw,
    reading="Each question alters cases in one way and compares rows that see the same random numbers. Evidence that is right "
    "helps: more masks, depth, a photo of an object whose colours are known. Where an object lacks a part that its start has, "
    "a mirror plane gains less, and harms few.",
    convention=CONVENTION,
    options=(*COMMON, part("validation"), VIEWS),
    plan=plan,
    conclude=conclude,
)
