"""Whether `determined` and the confidence of points mean what they say."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.points import Array
from tso_cli.geometry.view import View
from tso_cli.losses.nearest import nearest
from tso_cli.refinement import RefineConfig, RefineResult, refine

from .. import options
from ..charts import draw_bars
from ..interrupts import uninterrupted
from ..study import Cases, Plan, Progress, Record, Study, Table, claim
from .cases import MASKS, Case, CaseBuilder
from .evidence_alterations import Truth, with_depth
from .shapes import Shape, shapes_of_part
from .summary import grouped, rounded

CATEGORIES = ("chair", "airplane", "car")
SIZE = 64
"""Of the masks, px."""
MASK_COUNTS = (1, 2, 4, 8)
ASKING = RefineConfig(point_confidence=True)
CONVENTION = {
    "determined": "mean confidence of the control points",
    "rank correlation": "Spearman's, of the confidence of a point and its distance to the true "
    "surface, or the part of the distance along the first camera's axis or across it; negative is "
    "right; mean over shapes",
    "error of a quarter": "mean distance to the true surface x100 of the quarter of points with "
    "the lowest or highest confidence, longest side 1",
    "after / before": "Chamfer distance to the truth of the result over that of the start; mean "
    "over shapes",
}


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    categories: tuple[str, ...] = CATEGORIES,
    **settings: Any,
) -> Plan:
    """Refine another shape by more and more evidence."""
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    # The last of the cases has the four masks after those of the first.
    builder = CaseBuilder(meshes, split, MASKS + 1, SIZE, 1024, settings["seed"])
    settings |= {"size": SIZE, "shapes": [shape.name for shape in shapes]}
    jobs = [({"shape": shape.name}, partial(_of_shape, builder, shape)) for shape in shapes]
    return Plan(settings, jobs)


def _of_shape(builder: CaseBuilder, shape: Shape) -> Cases:
    """The results of one shape: by several masks, and by a depth map."""
    cases = builder.cases(shape, "other")
    case, views = cases[0], (*cases[0].views, *cases[-1].views)
    truth = Truth(shape)
    rng = np.random.default_rng([builder.seed, zlib.crc32(shape.name.encode())])
    seen = {f"{count} mask{'s' * (count > 1)}": views[:count] for count in MASK_COUNTS}
    seen["mask and depth map"] = with_depth(case, truth, rng).views[:1]
    results = {name: _refined(case, some) for name, some in seen.items()}
    rows = [{"seen": name, **_figures(case, result)} for name, result in results.items()]
    return [rounded({"shape": shape.name, "category": shape.category, **row}) for row in rows]


def _refined(case: Case, views: Sequence[View]) -> RefineResult:
    return uninterrupted(refine(case.initial, views, config=ASKING))


def _ratio(case: Case, result: RefineResult) -> float:
    after, before = (chamfer(cloud, case.target) for cloud in (result.points, case.initial))
    return after.chamfer / before.chamfer


def _figures(case: Case, result: RefineResult) -> Record:
    """What `determined` and the confidence of the points say, and the true errors."""
    from scipy.stats import spearmanr

    confidence = result.point_confidence
    assert confidence is not None
    offsets = case.dense[nearest(result.points, case.dense)] - result.points
    error = np.linalg.norm(offsets, axis=1)
    along = offsets @ case.views[0].camera.R[2]
    across = np.sqrt(np.maximum(np.square(error) - np.square(along), 0.0))
    ranked = {"error": error, "along": np.abs(along), "across": across}
    low, high = np.quantile(confidence, (0.25, 0.75))
    return {
        "determined": result.determined,
        "ratio": _ratio(case, result),
        **{name: float(spearmanr(confidence, values)[0]) for name, values in ranked.items()},
        "error_of_lowest": 100.0 * float(error[confidence <= low].mean()),
        "error_of_highest": 100.0 * float(error[confidence >= high].mean()),
    }


def conclude(cases: Cases) -> Record:
    """Means over shapes, by evidence."""
    keys = "determined", "ratio", "error", "along", "across", "error_of_lowest", "error_of_highest"
    summary = {
        name: {"shapes": len(rows)} | {key: float(_of(rows, key).mean()) for key in keys}
        for name, rows in grouped(cases, "seen").items()
    }
    return {"summary": summary, "claims": _claims(summary)}


def _claims(summary: Record) -> list[Record]:
    most = list(summary.values())[len(MASK_COUNTS) - 1]
    share = most["error_of_highest"] / most["error_of_lowest"]
    return [
        claim(
            f"with {MASK_COUNTS[-1]} masks the most confident quarter of the points is half as far "
            "off as the least",
            share <= 0.5,
            f"{share:.2f} times as far",
        ),
    ]


def _of(rows: Cases, key: str) -> Array:
    return np.array([row[key] for row in rows])


def tables(record: Record) -> list[Table]:
    """A row for each evidence."""
    header = ["evidence", "shapes", "determined", "after / before", "rank correlation"]
    header += ["along", "across", "error of the lowest quarter", "of the highest"]
    rows = [[name, *figures.values()] for name, figures in record["summary"].items()]
    return [Table(header, rows)]


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """What each evidence determines."""
    shares = {
        name: {"determined": one["determined"], "error after / before": one["ratio"]}
        for name, one in record["summary"].items()
    }
    draw_bars(path, {"by evidence": shares}, overwrite)


STUDY = Study(
    name="determined",
    about="Another shape of the category is refined by 1 to 8 masks and by a mask with its depth "
    "map.",
    parts=("pictures", "points, best"),
    tables=tables,
    draw=draw,
    reading="`determined` says how much of the shape the evidence fixes. It should rise where the "
    "error falls. Points of high confidence should lie nearer to the true surface than others.",
    convention=CONVENTION,
    options=(*options.COMMON, options.part("test"), options.categories(*CATEGORIES)),
    plan=plan,
    conclude=conclude,
)
