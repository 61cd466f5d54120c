"""How much nearer to the truth a refinement comes, and how often further away: every preset and variant on unseen shapes."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...evaluation.footprint import IOU_MEANS
from ...evaluation.metrics import chamfer, f_score
from ...geometry.points import Array
from ...io.output import check_output
from ...network.model import BaseNetwork
from ..charts.accuracy_pictures import draw_cases
from ..charts.ratios import Panel, draw_ratios
from ..charts.tradeoff import Tradeoff, draw_tradeoffs
from ..study import CHECKPOINT, COMMON, DEVICE, VIEWS, Cases, Option, Progress, Record, Study, Table, part, record_of
from .accuracy_cases import KINDS, AccuracyCase, CaseBuilder, check_points, kinds_of
from .accuracy_claims import claims, ratios_of, select, summarise
from .accuracy_variants import DEFAULT, Variant, alone, refined, variants_of
from .parts import Shape, shapes_of_part, view_aligned_network, weights_hash
from .summary import by_category, rounded

CATEGORIES = ("chair", "airplane", "car", "sofa", "table")
GROUP = 32
"""Cases that are refined together: their dense matrices fill 0.4 GiB."""
TIMED = 6
"""Cases of each kind, category and variant that are refined once more, alone, for the time."""
STARTS = "Where the starts are from. May be repeated.  [default: all; with --ablation all but right]"
F_THRESHOLD = 0.02
CONVENTION = {
    "chamfer": "squared distances, mean over points, forward + backward, longest side 1; to as many target points",
    "f_score": f"share of points with a counterpart nearer than {F_THRESHOLD}, harmonic mean of both directions, 16,384 target "
    "points",
    "iou": IOU_MEANS,
    "floor": "Chamfer distance of another sampling of the true surface",
    "seconds": "one call of refine alone, median over up to 6 cases",
}


def run(
    progress: Progress,
    *,
    meshes: Path,
    checkpoint: Path,
    split: Path | None,
    pictures: Path | None,
    kinds: tuple[str, ...],
    **settings: Any,
) -> Record:
    """Refine every case of every kind with every variant, and judge it against the truth.

    ``settings`` are the other options, which the record keeps. Raises TsoError where a case cannot be refined.
    """
    if pictures is not None:
        check_output(pictures, progress.overwrite)
    kinds = kinds or tuple(kind for kind in KINDS if kind != "right" or not settings["ablation"])
    categories, size = settings["categories"], settings["size"]
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    network, about = view_aligned_network(checkpoint) if "network" in kinds else (None, None)
    check_points(settings["points"], kinds, about)
    builder = CaseBuilder(meshes, split, settings["views"], size, settings["points"], settings["seed"], network, about)
    variants = {kind: variants_of(kind, settings["ablation"]) for kind in kinds}
    settings |= {
        "categories": list(categories),
        "kinds": list(kinds),
        "shapes": [shape.name for shape in shapes],
        "network": weights_hash(network) if network else None,
        "variants": {kind: list(of_kind) for kind, of_kind in variants.items()},
    }
    groups = _groups(shapes, categories, kinds, max(1, GROUP // settings["views"]))
    if not groups:
        raise InputError(f"kinds are {', '.join(kinds)}, expected some that {', '.join(categories)} have")
    cases = progress.earlier_cases("accuracy", settings)
    done = {(case["kind"], case["shape"]) for case in cases}

    def judged(kind: str, group: list[Shape], timed: int) -> Cases:
        built = [case for shape in group for case in builder.cases(shape, kind)]
        return judge_group(built, variants[kind], settings["device"], network, timed)

    def record(cases: Cases, complete: bool) -> Record:
        summary = summarise(cases)
        answers = claims(cases, summary) if complete and not settings["ablation"] else []
        return record_of(
            "accuracy", CONVENTION, complete=complete, settings=settings, summary=summary, claims=answers, cases=cases
        )

    work = [None if (kind, group[0].name) in done else partial(judged, kind, group, timed) for kind, group, timed in groups]
    finished = progress.complete("refining", cases, work, record)
    if pictures is not None:
        draw_cases(pictures, _extremes(finished, builder, shapes), progress.overwrite)
    return finished


def _groups(
    shapes: list[Shape], categories: tuple[str, ...], kinds: tuple[str, ...], size: int
) -> list[tuple[str, list[Shape], int]]:
    """(kind, shapes of one category that are refined together, how many of their cases are timed)."""
    groups = []
    for category in categories:
        members = [shape for shape in shapes if shape.category == category]
        for kind in kinds_of(category, kinds):
            groups += [(kind, members[i : i + size], TIMED if i == 0 else 0) for i in range(0, len(members), size)]
    return groups


def judge_group(
    cases: list[AccuracyCase], variants: dict[str, Variant], device: str, network: BaseNetwork | None, timed: int
) -> Cases:
    """Refine cases of one kind and category with every variant; the first ``timed`` once more, alone, for the time."""
    records: Cases = []
    for case in cases:
        before = {**_judged(case.initial, case), "floor": case.floor}
        names = {key: getattr(case, key) for key in ("kind", "category", "shape", "view", "start")}
        records.append({**names, "before": rounded(before), "variants": {}})
    for name, variant in variants.items():
        results = refined(cases, variant, device, network)
        for number, (case, record, result) in enumerate(zip(cases, records, results, strict=True)):
            row = {**_judged(result.points, case), "iou_before": result.iou_before, "iou": result.iou_after}
            if number < timed:
                start = time.perf_counter()
                alone(case, variant, device, network)
                row["seconds"] = time.perf_counter() - start
            record["variants"][name] = rounded(row)
    return records


def _judged(points: Array, case: AccuracyCase) -> dict[str, Any]:
    return {
        "chamfer": chamfer(points, case.target).chamfer,
        "f_score": f_score(points, case.dense, F_THRESHOLD).f_score,
    }


def _extremes(record: Record, builder: CaseBuilder, shapes: list[Shape]) -> list[tuple[str, AccuracyCase, Array]]:
    """Worst, median and best case of each category under the default preset, refined once more: (title, case, points).

    They are of the first kind in ``record``.
    """
    by_name = {shape.name: shape for shape in shapes}
    kind = next(iter(record["summary"]))
    variant = variants_of(kind, record["settings"]["ablation"])[DEFAULT]
    rows = []
    for category in record["summary"][kind]:
        cases = by_category(select(record["cases"], kind))[category]
        ratios = ratios_of(cases, DEFAULT)
        order = np.argsort(ratios)[::-1]
        # One or two cases have fewer than three places.
        for place, name in {order[0]: "worst", order[len(order) // 2]: "median", order[-1]: "best"}.items():
            shape = by_name[cases[place]["shape"]]
            case = builder.cases(shape, kind)[cases[place]["view"]]
            result = alone(case, variant, record["settings"]["device"], builder.network)
            title = f"{category}, {name}: {ratios[place]:.2f}, {shape.name.partition('/')[2][:16]}"
            rows.append((title, case, result.points))
    return rows


def tables(record: Record) -> list[Table]:
    """What each variant reaches; of an ablation a row an ingredient and a column a kind and category."""
    groups = [(kind, category, group) for kind, summary in record["summary"].items() for category, group in summary.items()]
    if record["settings"]["ablation"]:
        return [_ablation(groups)]
    rows = []
    for kind, category, group in groups:
        before = group["before"]
        for name, row in group["variants"].items():
            figures = [row[key] for key in ("mean_ratio", "median_ratio", "worst_ratio", "worse")]
            figures += [before.get("floor_ratio"), before["f_score"], row["f_score"]]
            figures += [row[key] for key in ("iou_before", "iou", "median_seconds")]
            rows.append([kind, category, group["cases"], name, 1e3 * before["chamfer"], 1e3 * row["chamfer"], *figures])
    header = ["kind", "category", "cases", "variant", "before", "after", "ratio", "median", "worst", "worse", "floor"]
    note = (
        "before, after: Chamfer x1000; ratio: after/before, mean of the cases' own; worse: cases over 1; floor: ratio that "
        "another sampling of the truth has; s: median seconds a case"
    )
    return [Table([*header, "F", "after", "IoU", "after", "s"], rows, note=note)]


def _ablation(groups: list[tuple[str, str, dict[str, Any]]]) -> Table:
    def cell(row: dict[str, Any]) -> str:
        return f"{row['mean_ratio']:.2f} ({row['worse']}, {row['worst_ratio']:.2f})"

    header = ["", *(f"{category}, {kind}" for kind, category, _ in groups)]
    rows = [[name, *(cell(group["variants"][name]) for *_, group in groups)] for name in groups[0][2]["variants"]]
    rows.append(["Chamfer x1000 of the start", *(f"{1e3 * group['before']['chamfer']:.1f}" for *_, group in groups)])
    rows.append(["cases", *(str(group["cases"]) for *_, group in groups)])
    return Table(header, rows, note="mean of Chamfer after / before (cases that got worse, worst case)")


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Chamfer after / before of every case, a row of panels for each kind and a panel for each category; and the same means
    against seconds, NAME.tradeoff.png."""
    tradeoffs = [
        Tradeoff(category, timed, group["before"].get("floor_ratio"))
        for category, group in record["summary"].get("other", {}).items()
        if (timed := _timed(group["variants"])) and not record["settings"]["ablation"]
    ]
    if tradeoffs:
        draw_tradeoffs(path.with_suffix(".tradeoff.png"), tradeoffs, overwrite)
    grid = []
    for kind, summary in record["summary"].items():
        panels = []
        for category, group in summary.items():
            cases = by_category(select(record["cases"], kind))[category]
            panels.append(Panel(f"{category}, {kind}", {name: ratios_of(cases, name) for name in group["variants"]}))
        grid.append(panels)
    draw_ratios(path, grid, overwrite)


def _timed(variants: dict[str, Any]) -> dict[str, tuple[float, float]]:
    return {name: (row["median_seconds"], row["mean_ratio"]) for name, row in variants.items() if row["median_seconds"]}


STUDY = Study(
    "accuracy",
    "Starts are another shape's cloud as wrong as a trained network's (other), one near the truth (near), the first with an "
    "object that the border truncates (cut), the truth sampled once more (right), and the network's prediction (network).",
    (
        *COMMON,
        CHECKPOINT,
        part("test"),
        Option("--category", "May be repeated.", default=CATEGORIES, multiple=True, name="categories"),
        Option("--kind", STARTS, str, (), KINDS, multiple=True, name="kinds"),
        VIEWS,
        Option("--size", "Of the masks, pixels each way.", int, 64, least=16, most=1024),
        Option("--points", "Of initial and target clouds, 1024 to 16384.", int, 1024),
        Option("--ablation", "Change one ingredient of the default preset at a time.", bool, False),
        Option("--pictures", "Draw the worst, the median and the best case of each category here (.png).", Path),
        DEVICE,
    ),
    run,
    tables,
    draw,
    "The default preset is judged by two questions: how much of the error it removes, and how often it adds some. One mask "
    "says nothing of depth; symmetry and further masks are what reaches beyond it. Two samplings of one surface differ too: "
    "no ratio can fall below that floor. Starts that are right already show what a refinement costs where there is nothing "
    "to gain.",
    kept="after every group of shapes",
)
