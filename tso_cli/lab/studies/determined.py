"""Whether `determined`, the confidence of points and the suggested view mean what they say."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...diagnosis.best_view import DIRECTIONS, around
from ...evaluation.metrics import chamfer
from ...geometry.camera import Camera
from ...geometry.points import Array
from ...geometry.view import View
from ...losses.nearest import nearest
from ...refinement import RefineConfig, RefineResult, refine
from ...render import RayScene, render_view
from .. import options
from ..charts import draw_bars
from ..interrupts import uninterrupted
from ..study import Cases, Plan, Progress, Record, Study, Table, claim
from .cases import MASKS, Case, CaseBuilder
from .evidence_alterations import Truth, with_depth
from .shapes import Shape, shapes_of_part
from .summary import grouped, interval, rounded

CATEGORIES = ("chair", "airplane", "car")
SIZE = 64
"""Of the masks, px."""
MASK_COUNTS = (1, 2, 4, 8)
SUGGESTED, RANDOM, OBLIQUE, NONE = "the suggested one", "a random one", "oblique", "none"
RANDOM_VIEWS = 4
"""Of each shape, whose results are averaged."""
A_RULE = (45, 45)
"""The rule that needs no computation: degrees to the right, and above."""
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
    SUGGESTED: "the `best_view` of the result of the first mask",
    RANDOM: f"{RANDOM_VIEWS} of the {len(DIRECTIONS)} directions that may be suggested, averaged",
    OBLIQUE: f"always from {A_RULE[0]} degrees to the right and {A_RULE[1]} degrees above",
}


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    categories: tuple[str, ...] = CATEGORIES,
    **settings: Any,
) -> Plan:
    """Refine another shape by more and more evidence, and by a further mask from elsewhere."""
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    # The last of the cases has the four masks after those of the first.
    builder = CaseBuilder(meshes, split, MASKS + 1, SIZE, 1024, settings["seed"])
    settings |= {"size": SIZE, "shapes": [shape.name for shape in shapes]}
    jobs = [({"shape": shape.name}, partial(_of_shape, builder, shape)) for shape in shapes]
    return Plan(settings, jobs)


def _of_shape(builder: CaseBuilder, shape: Shape) -> Cases:
    """The results of one shape: by several masks, by a depth map, and by each further mask."""
    cases = builder.cases(shape, "other")
    case, views = cases[0], (*cases[0].views, *cases[-1].views)
    truth = Truth(shape)
    rng = np.random.default_rng([builder.seed, zlib.crc32(shape.name.encode())])
    seen = {f"{count} mask{'s' * (count > 1)}": views[:count] for count in MASK_COUNTS}
    seen["mask and depth map"] = with_depth(case, truth, rng).views[:1]
    results = {name: _refined(case, some) for name, some in seen.items()}
    rows = [
        {"asked": "evidence", "seen": name, **_figures(case, result)}
        for name, result in results.items()
    ]
    best = results["1 mask"].best_view
    assert best
    drawn = rng.choice(len(DIRECTIONS), RANDOM_VIEWS, replace=False)
    further: dict[str, list[tuple[int, int] | None]] = {
        NONE: [None],
        SUGGESTED: [(best.azimuth, best.elevation)],
        RANDOM: [DIRECTIONS[number] for number in drawn],
        OBLIQUE: [A_RULE],
    }
    for name, directions in further.items():
        ratios = []
        for where in directions:
            more = [_seen_from(truth.scene, views[0].camera, where, rng)] if where else []
            ratios.append(_ratio(case, _refined(case, [views[0], *more])))
        rows.append({"asked": "further", "seen": name, "ratio": float(np.mean(ratios))})
    return [rounded({"shape": shape.name, "category": shape.category, **row}) for row in rows]


def _refined(case: Case, views: Sequence[View]) -> RefineResult:
    return uninterrupted(refine(case.initial, views, config=ASKING))


def _seen_from(
    scene: RayScene, first: Camera, where: tuple[int, int], rng: np.random.Generator
) -> View:
    """The true mask from there, in a picture twice as wide: no side of the object is cut off."""
    K = first.K.copy()
    K[:2, 2] += first.width / 2.0, first.height / 2.0
    wide = replace(first, K=K, width=2 * first.width, height=2 * first.height)
    camera = around(wide, *where)
    return View(render_view(scene, camera, rng).mask.astype(np.float32) / 255.0, camera)


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
    """Means over shapes: by evidence, and by further mask with 95 % intervals."""
    evidence, further = (grouped(cases, "asked")[part] for part in ("evidence", "further"))
    keys = "determined", "ratio", "error", "along", "across", "error_of_lowest", "error_of_highest"
    summary = {
        name: {"shapes": len(rows)} | {key: float(_of(rows, key).mean()) for key in keys}
        for name, rows in grouped(evidence, "seen").items()
    }
    by_mask = grouped(further, "seen")
    chance = _of(by_mask[RANDOM], "ratio")
    masks = {}
    for name, rows in by_mask.items():
        ratios, shapes = _of(rows, "ratio"), [row["shape"] for row in rows]
        masks[name] = {
            "shapes": len(rows),
            "ratio": float(ratios.mean()),
            "over_random": float((ratios - chance).mean()),
            "interval": interval(shapes, ratios - chance),
            "better_than_random": float((ratios < chance).mean()),
        }
    return {"summary": summary, "further": masks, "claims": _claims(summary, masks)}


def _claims(summary: Record, masks: Record) -> list[Record]:
    most = list(summary.values())[len(MASK_COUNTS) - 1]
    share = most["error_of_highest"] / most["error_of_lowest"]
    gain, (low, high) = masks[SUGGESTED]["over_random"], masks[SUGGESTED]["interval"]
    return [
        claim(
            f"with {MASK_COUNTS[-1]} masks the most confident quarter of the points is half as far "
            "off as the least",
            share <= 0.5,
            f"{share:.2f} times as far",
        ),
        claim(
            "a mask from the suggested view helps more than one from a random view, with 95 % "
            "certainty",
            high < 0.0,
            f"after / before {gain:+.3f}, {low:+.3f} to {high:+.3f}",
        ),
    ]


def _of(rows: Cases, key: str) -> Array:
    return np.array([row[key] for row in rows])


def tables(record: Record) -> list[Table]:
    """A row for each evidence, and for each further mask."""
    header = ["evidence", "shapes", "determined", "after / before", "rank correlation"]
    header += ["along", "across", "error of the lowest quarter", "of the highest"]
    rows = [[name, *figures.values()] for name, figures in record["summary"].items()]
    masks = [
        [
            name,
            one["shapes"],
            one["ratio"],
            *("" if name == RANDOM else value for value in (one["over_random"], *one["interval"])),
            "" if name == RANDOM else one["better_than_random"],
        ]
        for name, one in record["further"].items()
    ]
    columns = ["further mask", "shapes", "after / before", "minus random", "95 % from", "to"]
    return [
        Table(header, rows),
        Table([*columns, "better than random"], masks, "A second mask"),
    ]


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """What each evidence determines, and what each further mask is worth."""
    shares = {
        name: {"determined": one["determined"], "error after / before": one["ratio"]}
        for name, one in record["summary"].items()
    }
    masks = {name: {"ratio": one["ratio"]} for name, one in record["further"].items()}
    panels = {"by evidence": shares, "error after / before, by the second mask": masks}
    draw_bars(path, panels, overwrite)


STUDY = Study(
    name="determined",
    about="Another shape of the category is refined by 1 to 8 masks and by a mask with its depth "
    "map, and by a first mask with a second one from the suggested view, a random one, or a fixed "
    "one.",
    parts=("pictures", "points, best"),
    tables=tables,
    draw=draw,
    reading="`determined` says how much of the shape the evidence fixes. It should rise where the "
    "error falls. Points of high confidence should lie nearer to the true surface than others. A "
    "second mask from the suggested view should help more than one from a random view.",
    convention=CONVENTION,
    options=(*options.COMMON, options.part("test"), options.categories(*CATEGORIES)),
    plan=plan,
    conclude=conclude,
)
