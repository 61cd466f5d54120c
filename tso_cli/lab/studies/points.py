"""Does the points variant, with given settings, bring real clouds nearer to the truth?"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.metrics import chamfer
from ...refinement import RefineConfig, refine
from ..charts.ratios import Panel, draw_ratios
from ..study import DEVICE, LIMIT, SEED, Cases, Option, Progress, Record, Study, Table, record_of
from .protocol import INITIAL_CHAMFER, Case, build_cases
from .summary import by_category, ratio_figures

CATEGORIES = tuple(INITIAL_CHAMFER)
CONVENTION = "squared distances, mean over points, forward (truth -> cloud) + backward; longest side 1"
DIRECTIONS = ("chamfer", "forward", "backward")
OF_RESULT = ("iou_before", "iou_after", "best_step", "learning_rate", "gamma", "sigma_sq")


def run(
    progress: Progress,
    *,
    meshes: Path,
    categories: tuple[str, ...],
    limit: int | None,
    seed: int,
    **settings: Any,
) -> Record:
    """Refine every case of `build_cases` from one 64x64 mask and judge it by Chamfer to the true shape.

    ``settings`` : steps, learning_rate, gamma, sigma_sq and device of `RefineConfig`.
    """
    config = RefineConfig("points", preset="paper", **settings)
    rows: Cases = []
    for category in categories:
        cases = build_cases(meshes, category, seed, limit, progress.report)
        for done, case in enumerate(cases, 1):
            rows.append(refine_case(case, config))
            progress.report(f"{category}: refining", done, len(cases))
    used = {key: rows[0][key] for key in ("learning_rate", "gamma", "sigma_sq")}
    settings = {"steps": config.steps, **used, "seed": seed, "device": config.device, "points": 1024, "mask": "64x64"}
    summary = {category: summarise(group) for category, group in by_category(rows).items()}
    return record_of("points", CONVENTION, settings=settings, summary=summary, cases=rows)


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
        **{f"{key}_before": getattr(before, key) for key in DIRECTIONS},
        **{f"{key}_after": getattr(after, key) for key in DIRECTIONS},
        "ratio": after.chamfer / before.chamfer,
        "seconds": seconds,
        **{key: getattr(result, key) for key in OF_RESULT},
    }


def summarise(rows: Cases) -> dict[str, Any]:
    """Means over the cases of one category; the gain is read off the mean ratio, safety off the worst."""
    keys = ("chamfer_before", "chamfer_after", "iou_before", "iou_after")
    means = {key: float(np.mean([row[key] for row in rows])) for key in keys}
    return {
        "cases": len(rows),
        **means,
        "ratio_of_means": means["chamfer_after"] / means["chamfer_before"],
        **ratio_figures(np.array([row["ratio"] for row in rows])),
        "median_seconds": float(np.median([row["seconds"] for row in rows])),
    }


def tables(record: Record) -> list[Table]:
    """A row for each category."""
    header = ["category", "cases", "Chamfer x1000 before", "after", "after/before of the means", "mean ratio", "worst", "worse"]
    keys = ("ratio_of_means", "mean_ratio", "worst_ratio", "worse", "iou_before", "iou_after", "median_seconds")
    rows = [
        [category, row["cases"], 1e3 * row["chamfer_before"], 1e3 * row["chamfer_after"], *(row[key] for key in keys)]
        for category, row in record["summary"].items()
    ]
    return [Table([*header, "IoU before", "after", "s"], rows, note="worse: cases whose Chamfer distance grew")]


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Chamfer after / before of every case, a panel for each category."""
    panels = [
        Panel(f"{name}, {len(rows)} shapes", {"points": [row["ratio"] for row in rows]})
        for name, rows in by_category(record["cases"]).items()
    ]
    draw_ratios(path, [panels], overwrite)


STUDY = Study(
    "points",
    "Points mode with the paper's preset, or settings of your choice, on real shapes: start from another shape's cloud, see "
    "one 64x64 mask, be judged by Chamfer to the truth.",
    (
        Option("--meshes", "Folder with a folder of meshes for each category.", Path, required=True),
        Option("--category", "May be repeated.", str, CATEGORIES, CATEGORIES, multiple=True, name="categories"),
        LIMIT,
        Option("--steps", kind=int, default=50, least=0),
        Option("--learning-rate", "[default: 5e-4]", float),
        Option("--gamma", "[default: 1e6]", float),
        Option("--sigma-sq", "px^2 of the 64x64 mask.  [default: 0.4]", float),
        DEVICE,
        SEED,
    ),
    run,
    tables,
    draw,
    "With the paper's settings nearly every shape comes nearer to the truth, and hardly any gets worse, but the gain is small: "
    "the steps are few and short, and one mask says nothing of depth.",
)
