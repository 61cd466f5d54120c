"""Does the points variant, with given settings, bring real clouds nearer to the truth?"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.metrics import chamfer
from ...refinement import RefineConfig, refine
from ...version import __version__
from .protocol import INITIAL_CHAMFER, Case, Report, build_cases


def study_points(
    folder: Path,
    config: RefineConfig,
    categories: Sequence[str] = tuple(INITIAL_CHAMFER),
    seed: int = 0,
    limit: int | None = None,
    report: Report | None = None,
) -> dict[str, Any]:
    """Refine every case of `build_cases` from one 64x64 mask and judge it by Chamfer to the true shape.

    Parameters
    ----------
    folder : meshes in one folder for each category.
    config : settings of the refinement, mode "points".
    limit : at most so many cases for each category.

    Returns
    -------
    A JSON-able record: {"study", "settings", "convention", "summary": {category: ...}, "cases": [...]}. Distances are raw.
    """
    records = []
    for category in categories:
        cases = build_cases(folder, category, seed, limit, report)
        for done, case in enumerate(cases, 1):
            records.append(refine_case(case, config))
            if report:
                report(f"{category}: refining", done, len(cases))
    return {
        "study": "points",
        "version": __version__,
        "settings": {
            "steps": config.steps,
            "learning_rate": records[0]["learning_rate"],
            "gamma": records[0]["gamma"],
            "sigma_sq": records[0]["sigma_sq"],
            "seed": seed,
            "device": config.device,
            "points": 1024,
            "mask": "64x64",
        },
        "convention": "squared distances, mean over points, forward (truth -> cloud) + backward; longest side 1",
        "summary": {category: summarise([r for r in records if r["category"] == category]) for category in categories},
        "cases": records,
    }


def refine_case(case: Case, config: RefineConfig) -> dict[str, Any]:
    """Refine one case and judge it."""
    start = time.perf_counter()
    result = refine(case.initial, case.view, config=config)
    seconds = time.perf_counter() - start
    before, after = chamfer(case.initial, case.target), chamfer(result.points, case.target)
    return {
        "category": case.category,
        "shape": case.shape,
        "start": case.start,
        "chamfer_before": before.chamfer,
        "chamfer_after": after.chamfer,
        "forward_before": before.forward,
        "forward_after": after.forward,
        "backward_before": before.backward,
        "backward_after": after.backward,
        "ratio": after.chamfer / before.chamfer,
        "iou_before": result.iou_before,
        "iou_after": result.iou_after,
        "best_step": result.best_step,
        "seconds": seconds,
        "learning_rate": result.learning_rate,
        "gamma": result.gamma,
        "sigma_sq": result.sigma_sq,
    }


def summarise(records: list[dict[str, Any]]) -> dict[str, Any]:
    """Means over the cases of one category; the gain is read off the mean ratio, safety off the worst."""
    ratios = np.array([record["ratio"] for record in records])

    def mean(key: str) -> float:
        return float(np.mean([record[key] for record in records]))

    return {
        "cases": len(records),
        "chamfer_before": mean("chamfer_before"),
        "chamfer_after": mean("chamfer_after"),
        "ratio_of_means": mean("chamfer_after") / mean("chamfer_before"),
        "mean_ratio": float(ratios.mean()),
        "median_ratio": float(np.median(ratios)),
        "worst_ratio": float(ratios.max()),
        "worse": int((ratios > 1.0).sum()),
        "iou_before": mean("iou_before"),
        "iou_after": mean("iou_after"),
        "median_seconds": float(np.median([record["seconds"] for record in records])),
    }
