"""How far other evidence than one right mask of the whole object helps a refinement, or misleads it."""

from __future__ import annotations

import zlib
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...network.model import BaseNetwork
from ...version import __version__
from .accuracy import CATEGORIES, AccuracyConfig, builder_of
from .accuracy_cases import AccuracyCase, kinds_of
from .accuracy_variants import Variant, alone, refined
from .evidence_cases import Truth
from .evidence_questions import QUESTIONS, Question
from .parts import SPLIT, Shape, shapes_of_part
from .protocol import Report
from .resumed import Cases, Keep, cases_of, complete

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
ALL = "all"
"""The mean over all cases of a kind, whatever their category."""


@dataclass(frozen=True)
class EvidenceConfig:
    """What is studied.

    Parameters
    ----------
    questions : of `QUESTIONS`. part, limit, views : as in
        `AccuracyConfig`.
    """

    questions: tuple[str, ...] = tuple(QUESTIONS)
    part: str = "validation"
    limit: int | None = None
    views: int = 2
    seed: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        for question in self.questions:
            if question not in QUESTIONS:
                raise InputError(f"question is {question!r}, expected one of {', '.join(QUESTIONS)}")


def study_evidence(
    folder: Path,
    config: EvidenceConfig | None = None,
    split_file: Path = SPLIT,
    checkpoint: Path | None = None,
    earlier: dict[str, Any] | None = None,
    keep: Keep | None = None,
    report: Report | None = None,
) -> dict[str, Any]:
    """Ask each question of every case that it is about.

    Parameters and errors are those of `study_accuracy`.

    Returns
    -------
    A JSON-able record: {"study", "complete", "settings", "summary": {question: {kind: {category: {row: ...}}}}, "cases"}.
    """
    config = config or EvidenceConfig()
    asked = {name: QUESTIONS[name] for name in config.questions}
    kinds = tuple(dict.fromkeys(kind for question in asked.values() for kind in question.kinds))
    shapes = _of_each_category(folder, split_file, config)
    material = AccuracyConfig(kinds=kinds, views=config.views, size=SIZE, points=POINTS, seed=config.seed)
    builder, network, digest = builder_of(folder, material, split_file, checkpoint)
    settings = {**asdict(config), "questions": list(config.questions), "network": digest, "points": POINTS, "size": SIZE}
    settings["rows"] = {name: list(question.rows) for name, question in asked.items()}
    settings["shapes"] = [shape.name for own in shapes.values() for shape in own]
    cases = cases_of("evidence", earlier, settings)
    done = {(case["question"], case["kind"], case["shape"]) for case in cases}

    def judged(name: str, kind: str, own: list[Shape]) -> Cases:
        built = [
            (case, Truth(shape, own[(place + 1) % len(own)] if len(own) > 1 else None))
            for place, shape in enumerate(own)
            for case in builder.cases(shape, kind)
        ]
        return judge(name, asked[name], built, config, network)

    groups = [
        None if all((name, kind, shape.name) in done for shape in own) else partial(judged, name, kind, own)
        for name, kind, own in _groups(asked, shapes)
    ]
    return complete(cases, groups, partial(_record, settings), "refining", keep, report)


def judge(
    name: str,
    question: Question,
    cases: list[tuple[AccuracyCase, Truth]],
    config: EvidenceConfig,
    network: BaseNetwork | None,
) -> list[dict[str, Any]]:
    """Every row of a question for cases of one kind and category; a row that a case cannot have is left out of it."""
    records: list[dict[str, Any]] = [
        {"question": name, "kind": case.kind, "category": case.category, "shape": case.shape, "view": case.view, "rows": {}}
        for case, _ in cases
    ]
    for words, row in question.rows.items():
        # The same random numbers for each row: what is compared differs in nothing else.
        altered = [row.alter(case, truth, _rng(config.seed, name, case)) for case, truth in cases]
        had = [number for number, case in enumerate(altered) if case is not None]
        changed = [case for case in altered if case is not None]
        if isinstance(row.variant, Variant):
            results = refined(changed, row.variant, config.device, network)[0] if changed else []
        else:
            results = [alone(case, row.variant(case), config.device, network)[0] for case in changed]
        for number, case, result in zip(had, changed, results, strict=True):
            found: dict[str, float | None] = {
                "before": case.chamfer_of(case.initial),
                "chamfer": case.chamfer_of(result.points),
            }
            found |= {about: tell(cases[number][0], case, result) for about, tell in question.told.items()}
            records[number]["rows"][words] = {
                key: None if value is None else float(f"{value:.5g}") for key, value in found.items()
            }
    return records


def _rng(seed: int, question: str, case: AccuracyCase) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(f"{question} {case.shape}".encode()), case.view])


def _of_each_category(folder: Path, split_file: Path, config: EvidenceConfig) -> dict[str, list[Shape]]:
    categories = [
        name for name in CATEGORIES if any(name in (QUESTIONS[one].categories or CATEGORIES) for one in config.questions)
    ]
    shapes = shapes_of_part(folder, split_file, config.part, categories, config.limit)
    return {name: [shape for shape in shapes if shape.category == name] for name in categories}


def _groups(asked: dict[str, Question], shapes: dict[str, list[Shape]]) -> list[tuple[str, str, list[Shape]]]:
    """(question, kind, shapes of one category) that are worked on together."""
    return [
        (name, kind, own)
        for name, question in asked.items()
        for kind in question.kinds
        for category, own in shapes.items()
        if category in (question.categories or CATEGORIES) and kind in kinds_of(category, question.kinds)
    ]


def _record(settings: dict[str, Any], cases: list[dict[str, Any]], complete: bool) -> dict[str, Any]:
    return {
        "study": "evidence",
        "version": __version__,
        "complete": complete,
        "settings": settings,
        "convention": CONVENTION,
        "summary": summarise(cases),
        "cases": cases,
    }


def summarise(cases: list[dict[str, Any]]) -> dict[str, Any]:
    """{question: {kind: {category, and "all": {row: {"cases", "mean_ratio", "worst_ratio", "worse", ...}}}}}."""
    found: dict[str, Any] = {}
    for case, category in [(case, case["category"]) for case in cases] + [(case, ALL) for case in cases]:
        own = found.setdefault(case["question"], {}).setdefault(case["kind"], {}).setdefault(category, {})
        for row, values in case["rows"].items():
            own.setdefault(row, []).append(values)
    return {
        question: {
            kind: {category: {row: _means(values) for row, values in rows.items()} for category, rows in categories.items()}
            for kind, categories in kinds.items()
        }
        for question, kinds in found.items()
    }


def _means(values: list[dict[str, Any]]) -> dict[str, float]:
    ratios = np.array([one["chamfer"] / one["before"] for one in values])
    told = {key: [one[key] for one in values] for key in values[0] if key not in ("before", "chamfer")}
    means = {key: float(np.mean(own)) for key, own in told.items() if None not in own}
    found = {"mean_ratio": float(ratios.mean()), "worst_ratio": float(ratios.max()), **means}
    counts = {"cases": len(values), "worse": int((ratios > 1.0).sum())}
    return counts | {key: float(f"{value:.5g}") for key, value in found.items()}
