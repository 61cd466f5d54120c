"""How far other evidence than one right mask of the whole object helps a refinement, or misleads it."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.metrics import chamfer
from ...geometry.rotations import angle_between
from ...refinement import RefineConfig, RefineResult
from ...refinement.presets import BEST
from ..charts import Panel, draw_ratios
from ..study import COMMON, DEVICE, VIEWS, Cases, Option, Plan, Progress, Record, Study, Table, part
from .cases import Case, CaseBuilder, kinds_of
from .evidence_alterations import (
    Alter,
    Truth,
    bunched,
    painted,
    unaltered,
    with_cameras_off,
    with_depth,
    with_wrong_camera,
    with_wrong_mask,
    without,
)
from .refining import Variant, refined
from .shapes import Shape, shapes_of_part
from .summary import grouped, rounded

SIZE, POINTS = 64, 1024
"""Pixels of the masks each way, points of the clouds."""
CONVENTION = {
    "ratio": "Chamfer distance after / before, mean of the cases' own; squared distances, mean over points, forward + "
    "backward, longest side 1, to as many target points; worse: cases over 1",
    "no mirror plane": "share of the cases whose refinement used none",
    "fourth inlier weight": "1, or less where the other views contradict the fourth, mean",
    "corrected": "share of the cameras that --refine-camera corrected",
    "degrees left": "angle between the cameras that were used and the true ones, mean",
}
FIGURES = ("cases", "mean_ratio", "worst_ratio", "worse")
ALL = "all"
Rows = dict[str, tuple[Alter, Variant]]
"""By label: how a case is altered, and how it is then refined."""
Measure = Callable[[Case, Case, RefineResult], float | None]
"""A further figure: of the case as it was, the altered case, and its result; None where there is none."""


@dataclass(frozen=True)
class Question:
    """Rows that are compared on cases of some kinds, of `KINDS`, and categories; ``measures`` are further figures by name."""

    title: str
    kinds: tuple[str, ...]
    rows: Rows
    categories: tuple[str, ...]
    measures: dict[str, Measure] = field(default_factory=dict)


def _variant(masks: int = 1, **settings: object) -> Variant:
    return Variant(RefineConfig(**settings), masks)  # type: ignore[arg-type]


def _corrected(case: Case, altered: Case, result: RefineResult) -> float:
    pairs = zip(result.cameras, altered.views, strict=False)
    return float(np.mean([not np.array_equal(camera.R, view.camera.R) for camera, view in pairs]))


def _degrees_left(case: Case, altered: Case, result: RefineResult) -> float:
    pairs = zip(result.cameras, case.views, strict=False)
    return float(np.mean([angle_between(camera.R, view.camera.R) for camera, view in pairs]))


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
STARTS_OF_PAINT = {"bent 2": "bent to Chamfer 2", "bent 6": "bent to Chamfer 6", "other": "another shape, other colours"}
PHOTOS = {None: "mask", 0.7: "mask and photo, exposure 0.7", 1.4: "mask and photo, exposure 1.4"}
COLOUR_ROWS: Rows = {
    f"{STARTS_OF_PAINT[start]}; {PHOTOS[exposure]}": (partial(painted, start=start, exposure=exposure), ONE)
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
    for (name, alter), (plane, variant) in product(LACKING.items(), (("none", ONE), ("auto", _variant())))
}


def _wrong_rows() -> Rows:
    views: dict[str, Alter] = {
        "four right views": unaltered,
        "three views close together, one from the side": bunched,
        "fourth mask of another shape": with_wrong_mask,
        "fourth camera 30 degrees off": with_wrong_camera,
    }
    rows: Rows = {}
    for preset in ("paper", "best"):
        rows |= {f"{name}; {preset}": (alter, _variant(4, preset=preset)) for name, alter in views.items()}
        if preset == "best":
            unweighted = _variant(4, coarse_to_fine=replace(BEST, weigh_views=False))
            rows |= {f"{name}; best, views unweighted": (alter, unweighted) for name, alter in views.items()}
        rows[f"first three views alone; {preset}"] = unaltered, _variant(3, preset=preset)
        rows[f"three views close together alone; {preset}"] = bunched, _variant(3, preset=preset)
    return rows


CAMERA_ROWS: Rows = {
    f"{masks} mask{'s' * (masks > 1)}, {degrees} degrees off; {'refined' if refine else 'as given'}": (
        partial(with_cameras_off, degrees=degrees),
        _variant(masks, refine_camera=refine),
    )
    for masks, degrees, refine in product((1, 2), (0, 2, 5), (False, True))
}
THREE = ("chair", "airplane", "car")
CATEGORIES = (*THREE, "sofa", "table")
STARTS = ("other", "near")
QUESTIONS = {
    "depth": Question("Depth maps", STARTS, DEPTH_ROWS, THREE),
    "colours": Question("Photos of painted objects", ("other",), COLOUR_ROWS, THREE),
    "missing": Question(
        "Objects of which a part is missing",
        ("other",),
        MISSING_ROWS,
        CATEGORIES[:4],
        {"no mirror plane": lambda case, altered, result: float(result.symmetry is None)},
    ),
    "wrong": Question(
        "Wrong views among four",
        ("other",),
        _wrong_rows(),
        CATEGORIES,
        {"fourth inlier weight": lambda case, altered, result: dict(enumerate(result.view_trust)).get(3)},
    ),
    "cameras": Question(
        "Cameras that are off", STARTS, CAMERA_ROWS, THREE, {"corrected": _corrected, "degrees left": _degrees_left}
    ),
}


def plan(progress: Progress, *, meshes: Path, split: Path | None, questions: tuple[str, ...], **settings: Any) -> Plan:
    """Ask each question of every case that it is about; errors are those of the study of accuracy."""
    chosen = {name: QUESTIONS[name] for name in questions}
    categories = [name for name in CATEGORIES if any(name in question.categories for question in chosen.values())]
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    by_category = {name: [shape for shape in shapes if shape.category == name] for name in categories}
    builder = CaseBuilder(meshes, split, settings["views"], SIZE, POINTS, settings["seed"])
    settings |= {"questions": list(questions), "points": POINTS, "size": SIZE}
    settings["rows"] = {name: list(question.rows) for name, question in chosen.items()}
    settings["shapes"] = [shape.name for group in by_category.values() for shape in group]

    def judge_group(name: str, kind: str, group: list[Shape]) -> Cases:
        others = [*group[1:], group[0]] if len(group) > 1 else [None]
        truths = [Truth(shape, other) for shape, other in zip(group, others, strict=True)]
        cases = [(case, truth) for truth in truths for case in builder.cases(truth.shape, kind)]
        return judge(name, chosen[name], cases, settings["seed"], settings["device"])

    jobs = [
        ({"question": name, "kind": kind, "shape": group[0].name}, partial(judge_group, name, kind, group))
        for name, question in chosen.items()
        for kind in question.kinds
        for category, group in by_category.items()
        if category in question.categories and kind in kinds_of(category, question.kinds)
    ]
    return Plan(settings, jobs)


def judge(name: str, question: Question, cases: list[tuple[Case, Truth]], seed: int, device: str) -> Cases:
    """Every row of a question for cases of one kind and category; a row that a case cannot have is left out of it."""
    keys = ("kind", "category", "shape", "view")
    records: Cases = [{"question": name, **{key: getattr(case, key) for key in keys}, "rows": {}} for case, _ in cases]
    for label, (alter, variant) in question.rows.items():
        # The same random numbers for each row: what is compared differs in nothing else.
        seeds = [[seed, zlib.crc32(f"{name} {case.shape}".encode()), case.view] for case, _ in cases]
        altered = [alter(case, truth, np.random.default_rng(key)) for (case, truth), key in zip(cases, seeds, strict=True)]
        numbers = [number for number, case in enumerate(altered) if case is not None]
        changed = [case for case in altered if case is not None]
        results = refined(changed, variant, device, None) if changed else []
        for number, case, result in zip(numbers, changed, results, strict=True):
            before, after = (chamfer(points, case.target).chamfer for points in (case.initial, result.points))
            further = {key: measure(cases[number][0], case, result) for key, measure in question.measures.items()}
            records[number]["rows"][label] = rounded({"before": before, "chamfer": after, **further})
    return records


def conclude(cases: Cases) -> Record:
    """{"summary": {question: {kind: {category, and "all": {row: {"cases", "mean_ratio", "worst_ratio", "worse", ...}}}}}}."""
    summary: Record = {}
    for question, asked in grouped(cases, "question").items():
        summary[question] = {}
        for kind, of_kind in grouped(asked, "kind").items():
            groups = {**grouped(of_kind, "category"), ALL: of_kind}
            summary[question][kind] = {category: _means(group) for category, group in groups.items()}
    return {"summary": summary}


def _means(cases: Cases) -> Record:
    """By row; a case may lack some."""
    means = {}
    for label in dict.fromkeys(label for case in cases for label in case["rows"]):
        rows = [case["rows"][label] for case in cases if label in case["rows"]]
        ratios = np.array([row["chamfer"] / row["before"] for row in rows])
        columns = {key: [row[key] for row in rows] for key in rows[0] if key not in ("before", "chamfer")}
        further = {key: float(np.mean(values)) for key, values in columns.items() if None not in values}
        counts = {"cases": len(rows), "worse": int((ratios > 1.0).sum())}
        means[label] = rounded({**counts, "mean_ratio": float(ratios.mean()), "worst_ratio": float(ratios.max()), **further})
    return means


def tables(record: Record) -> list[Table]:
    """A table for each question; not every row has every figure: of three views there is no fourth."""
    result = []
    for question, kinds in record["summary"].items():
        columns = [*FIGURES, *QUESTIONS[question].measures]
        rows = [
            [kind, category, label, *map(figures.get, columns)]
            for kind, categories in kinds.items()
            for category, of_category in categories.items()
            for label, figures in of_category.items()
        ]
        header = ["kind", "category", question, "cases", "ratio", "worst", "worse", *columns[len(FIGURES) :]]
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
                label: [rows[label]["chamfer"] / rows[label]["before"] for rows in rows_of if label in rows]
                for label in record["summary"][question][kind][ALL]
            }
            panels.append(Panel(f"{question}, {kind}", ratios))
        grid.append(panels)
    draw_ratios(path, grid, overwrite)


STUDY = Study(
    name="evidence",
    about="Depth maps (depth), photos of painted objects (colours), objects of which a part is missing (missing), wrong views "
    "among right ones (wrong), and cameras that are off (cameras).",
    parts=("pictures", "points, paper", "points, best", "camera fit"),
    tables=tables,
    draw=draw,
    reading="Each question alters cases in one way and compares rows that see the same random numbers. Evidence that is right "
    "helps: more masks, depth, a photo of an object whose colours are known. What matters as much is the harm that wrong "
    "evidence does: a method that weighs its evidence loses little to one wrong view, camera or plane.",
    convention=CONVENTION,
    options=(
        *COMMON,
        part("validation"),
        Option("--question", "May be repeated.", str, tuple(QUESTIONS), tuple(QUESTIONS), multiple=True, name="questions"),
        VIEWS,
        DEVICE,
    ),
    plan=plan,
    conclude=conclude,
)
