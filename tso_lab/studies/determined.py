"""Whether `determined` and the confidence of points mean what they say."""

from __future__ import annotations

import zlib
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tso_cli.evaluation.metrics import chamfer
from tso_cli.losses.nearest import nearest
from tso_cli.refinement import RefineConfig, RefineResult, refine

from .. import options
from ..charts import Rows, bars
from ..study import Cases, Plan, Progress, Record, Study, Table, by_shape, claim, uninterrupted
from .cases import MASKS, Case, CaseBuilder
from .evidence import Truth, with_depth
from .shapes import Shape, shapes_of_part
from .summary import grouped, mean, rounded

CATEGORIES = ("chair", "airplane", "car")
SIZE = 64
"""Of the masks, px."""
MASK_COUNTS = (1, 2, 4, 8)


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
    return by_shape({**settings, "size": SIZE}, shapes, partial(_of_shape, builder))


def _of_shape(builder: CaseBuilder, shape: Shape) -> Cases:
    """The results of one shape: by several masks, and by a depth map."""
    cases = builder.cases(shape, "other")
    case, views = cases[0], (*cases[0].views, *cases[-1].views)
    truth = Truth(shape)
    rng = np.random.default_rng([builder.seed, zlib.crc32(shape.name.encode())])
    seen = {f"{count} mask{'s' * (count > 1)}": views[:count] for count in MASK_COUNTS}
    seen["mask and depth map"] = with_depth(case, truth, rng).views[:1]
    names = {"shape": shape.name, "category": shape.category}
    config, rows = RefineConfig(point_confidence=True), []
    for name, masks in seen.items():
        result = uninterrupted(refine(case.initial, masks, config=config))
        rows.append(rounded({**names, "seen": name, **_figures(case, result)}))
    return rows


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
    after, before = (chamfer(cloud, case.target) for cloud in (result.points, case.initial))
    return {
        "determined": result.determined,
        "ratio": after.chamfer / before.chamfer,
        **{name: float(spearmanr(confidence, values)[0]) for name, values in ranked.items()},
        "error_of_lowest": 100.0 * float(error[confidence <= low].mean()),
        "error_of_highest": 100.0 * float(error[confidence >= high].mean()),
    }


def conclude(cases: Cases) -> Record:
    """Means over shapes, by evidence."""
    keys = "determined", "ratio", "error", "along", "across", "error_of_lowest", "error_of_highest"
    summary = {
        name: {"shapes": len(rows)} | {key: mean(row[key] for row in rows) for key in keys}
        for name, rows in grouped(cases, "seen").items()
    }
    most = list(summary.values())[len(MASK_COUNTS) - 1]
    share = most["error_of_highest"] / most["error_of_lowest"]
    text = f"with {MASK_COUNTS[-1]} masks the most confident quarter of the points is half as far "
    text += "off as the least"
    claims = [claim(text, share <= 0.5, f"{share:.2f} times as far")]
    return {"summary": summary, "claims": claims}


def tables(record: Record) -> list[Table]:
    """A row for each evidence."""
    header = ["evidence", "shapes", "determined", "after / before", "rank correlation"]
    header += ["along", "across", "error of the lowest quarter", "of the highest"]
    rows = [[name, *figures.values()] for name, figures in record["summary"].items()]
    return [Table(header, rows)]


def panels(record: Record) -> Rows:
    """What each evidence determines."""
    shares = {
        name: {"determined": figures["determined"], "error after / before": figures["ratio"]}
        for name, figures in record["summary"].items()
    }
    return {"by evidence": shares}


STUDY = Study(
    name="determined",
    parts=("pictures", "points, best"),
    tables=tables,
    draw=bars(panels),
    options=(*options.COMMON, options.part("test"), options.categories(*CATEGORIES)),
    plan=plan,
    conclude=conclude,
)
