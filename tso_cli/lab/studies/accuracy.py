"""How much nearer to the truth a refinement comes, and how often further away: every preset and variant on unseen shapes."""

from __future__ import annotations

import time
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...evaluation.footprint import IOU_MEANS
from ...evaluation.metrics import chamfer, f_score
from ...geometry.points import Array
from ...io.output import check_output
from ...network.model import BaseNetwork
from ..charts import Panel, draw_cases, draw_ratios, draw_tradeoffs
from ..study import CHECKPOINT, COMMON, DEVICE, VIEWS, Cases, Option, Plan, Progress, Record, Study, Table, part
from .accuracy_targets import claims
from .cases import JUDGED, KINDS, SAMPLES, Case, CaseBuilder, kinds_of
from .refining import DEFAULT, TWO_MASKS, Variant, alone, refined, variants_of
from .shapes import Shape, shapes_of_part, view_aligned_network, weights_hash
from .summary import grouped, mean, ratio_figures, ratios_of, rounded

CATEGORIES = ("chair", "airplane", "car", "sofa", "table")
GROUP = 32
"""Cases that are refined together: their dense matrices fill 0.4 GiB."""
TIMED = 6
"""Cases of each kind, category and variant that are refined once more, alone, for the time."""
STARTS = "Where the starts are from. May be repeated.  [default: all; with --ablation all but right]"
F_THRESHOLD = 0.02
# Of a row of the table, beside Chamfer.
FIGURES = ("mean_ratio", "median_ratio", "worst_ratio", "worse", "floor_ratio", "start_f_score", "f_score", "iou_before", "iou")
CONVENTION = {
    "chamfer": "squared distances, mean over points, forward + backward, longest side 1; to as many target points",
    "f_score": f"share of points with a counterpart nearer than {F_THRESHOLD}, harmonic mean of both directions, 16,384 target "
    "points",
    "iou": IOU_MEANS,
    "floor": "Chamfer distance of another sampling of the true surface",
    "seconds": "one call of refine alone, median over up to 6 cases",
}


def plan(
    progress: Progress,
    *,
    meshes: Path,
    checkpoint: Path,
    split: Path | None,
    pictures: Path | None,
    kinds: tuple[str, ...],
    **settings: Any,
) -> Plan:
    """Refine every case of every kind with every variant, and judge it against the truth.

    Raises InputError where there are no such cases.
    """
    if pictures is not None:
        check_output(pictures, progress.overwrite)
    kinds = kinds or tuple(kind for kind in KINDS if kind != "right" or not settings["ablation"])
    categories, points = settings["categories"], settings["points"]
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    network, about = view_aligned_network(checkpoint) if "network" in kinds else (None, None)
    if not JUDGED <= points <= SAMPLES:
        raise InputError(f"points is {points}, expected {JUDGED} to {SAMPLES}")
    if about is not None and about.points != points:
        raise InputError(f"points is {points}, expected {about.points}, as many as the network predicts, for kind network")
    builder = CaseBuilder(meshes, split, settings["views"], settings["size"], points, settings["seed"], network, about)
    variants = {kind: variants_of(kind, settings["ablation"]) for kind in kinds}
    settings |= {"categories": list(categories), "kinds": list(kinds), "shapes": [shape.name for shape in shapes]}
    settings["network"] = weights_hash(network) if network else None
    settings["variants"] = {kind: list(of_kind) for kind, of_kind in variants.items()}

    def judge(kind: str, group: list[Shape], timed: int) -> Cases:
        cases = [case for shape in group for case in builder.cases(shape, kind)]
        return judge_group(cases, variants[kind], settings["device"], network, timed)

    jobs, size = [], max(1, GROUP // settings["views"])
    for category in categories:
        members = [shape for shape in shapes if shape.category == category]
        for kind, start in product(kinds_of(category, kinds), range(0, len(members), size)):
            group, timed = members[start : start + size], 0 if start else TIMED
            jobs.append(({"kind": kind, "shape": group[0].name}, partial(judge, kind, group, timed)))
    if not jobs:
        raise InputError(f"kinds are {', '.join(kinds)}, expected some that {', '.join(categories)} have")

    def draw_extremes(record: Record) -> None:
        if pictures is not None:
            draw_cases(pictures, _extremes(record, builder, shapes), progress.overwrite)

    return Plan(settings, jobs, finish=draw_extremes)


def judge_group(cases: list[Case], variants: dict[str, Variant], device: str, network: BaseNetwork | None, timed: int) -> Cases:
    """Refine cases of one kind and category with every variant; the first ``timed`` once more, alone, for the time."""
    records: Cases = []
    for case in cases:
        names = {key: getattr(case, key) for key in ("kind", "category", "shape", "view")}
        records.append({**names, "before": rounded({**_scores(case.initial, case), "floor": case.floor}), "variants": {}})
    for name, variant in variants.items():
        results = refined(cases, variant, device, network)
        for number, (case, record, result) in enumerate(zip(cases, records, results, strict=True)):
            row = {**_scores(result.points, case), "iou_before": result.iou_before, "iou": result.iou_after}
            if number < timed:
                start = time.perf_counter()
                alone(case, variant, device, network)
                row["seconds"] = time.perf_counter() - start
            record["variants"][name] = rounded(row)
    return records


def _scores(points: Array, case: Case) -> dict[str, float]:
    distance, score = chamfer(points, case.target), f_score(points, case.dense, F_THRESHOLD)
    return {"chamfer": distance.chamfer, "f_score": score.f_score}


def _extremes(record: Record, builder: CaseBuilder, shapes: list[Shape]) -> list[tuple[str, Case, Array]]:
    """Worst and median case of each category under the default preset, refined once more: (title, case, points).

    They are of the first kind in ``record``.
    """
    by_name = {shape.name: shape for shape in shapes}
    kind, cases_of_kind = next(iter(grouped(record["cases"], "kind").items()))
    variant = variants_of(kind, record["settings"]["ablation"])[DEFAULT]
    rows = []
    for category, cases in grouped(cases_of_kind, "category").items():
        ratios = ratios_of(cases, DEFAULT)
        order = np.argsort(ratios)[::-1]
        # A single case has one place.
        for place, name in {order[len(order) // 2]: "median", order[0]: "worst"}.items():
            shape = by_name[cases[place]["shape"]]
            case = builder.cases(shape, kind)[cases[place]["view"]]
            result = alone(case, variant, record["settings"]["device"], builder.network)
            title = f"{category}, {name}: {ratios[place]:.2f}, {shape.name.partition('/')[2][:16]}"
            rows.append((title, case, result.points))
    return rows


def conclude(cases: Cases) -> Record:
    """{"summary": {kind: {category: {"cases", "before", "variants": {variant: {...}}}}}, "claims"}; of an ablation none."""
    summary = {
        kind: {category: _means(group) for category, group in grouped(of_kind, "category").items()}
        for kind, of_kind in grouped(cases, "kind").items()
    }
    return {"summary": summary, "claims": claims(cases, summary) if TWO_MASKS in cases[0]["variants"] else []}


def _means(cases: Cases) -> Record:
    before = {key: mean(case["before"][key] for case in cases) for key in ("chamfer", "f_score")}
    before["floor_ratio"] = mean(case["before"]["floor"] / case["before"]["chamfer"] for case in cases)
    variants = {}
    for name in cases[0]["variants"]:
        rows = [case["variants"][name] for case in cases]
        seconds = [row["seconds"] for row in rows if "seconds" in row]
        row = {key: mean(row[key] for row in rows) for key in ("chamfer", "f_score", "iou_before", "iou")}
        row |= ratio_figures(ratios_of(cases, name))
        variants[name] = rounded({**row, "median_seconds": float(np.median(seconds)) if seconds else None})
    return {"cases": len(cases), "before": before, "variants": variants}


def tables(record: Record) -> list[Table]:
    """What each variant reaches; of an ablation a row an ingredient and a column a kind and category."""
    groups = [(kind, category, group) for kind, summary in record["summary"].items() for category, group in summary.items()]
    if record["settings"]["ablation"]:
        return [_ablation(groups)]
    rows = []
    for kind, category, group in groups:
        before = group["before"]
        for name, row in group["variants"].items():
            start = [kind, category, group["cases"], name, 1e3 * before["chamfer"], 1e3 * row["chamfer"]]
            figures = {**row, "floor_ratio": before["floor_ratio"], "start_f_score": before["f_score"]}
            rows.append([*start, *(figures[key] for key in (*FIGURES, "median_seconds"))])
    header = ["kind", "category", "cases", "variant", "before", "after", "ratio", "median", "worst", "worse", "floor"]
    note = (
        "before, after: Chamfer x1000; ratio: after/before, mean of the cases' own; worse: cases over 1; floor: ratio that "
        "another sampling of the truth has; s: median seconds a case"
    )
    return [Table([*header, "F", "after", "IoU", "after", "s"], rows, note=note)]


def _ablation(groups: list[tuple[str, str, Record]]) -> Table:
    def cell(row: Record) -> str:
        return f"{row['mean_ratio']:.2f} ({row['worse']}, {row['worst_ratio']:.2f})"

    header = ["", *(f"{category}, {kind}" for kind, category, _ in groups)]
    rows = [[name, *(cell(group["variants"][name]) for *_, group in groups)] for name in groups[0][2]["variants"]]
    rows.append(["Chamfer x1000 of the start", *(f"{1e3 * group['before']['chamfer']:.1f}" for *_, group in groups)])
    rows.append(["cases", *(str(group["cases"]) for *_, group in groups)])
    return Table(header, rows, note="mean of Chamfer after / before (cases that got worse, worst case)")


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Ratios of all cases, a row of panels for each kind; and their means against seconds, NAME.tradeoff.png."""
    if "other" in record["summary"] and not record["settings"]["ablation"]:
        draw_tradeoffs(path.with_suffix(".tradeoff.png"), record["summary"]["other"], overwrite)
    grid: list[list[Panel]] = []
    for kind, of_kind in grouped(record["cases"], "kind").items():
        groups = grouped(of_kind, "category").items()
        ratios = {category: {name: ratios_of(cases, name) for name in cases[0]["variants"]} for category, cases in groups}
        grid.append([Panel(f"{category}, {kind}", rows) for category, rows in ratios.items()])
    draw_ratios(path, grid, overwrite)


STUDY = Study(
    name="accuracy",
    about="Starts are another shape's cloud as wrong as a trained network's (other), one near the truth (near), the first "
    "with an object that the border truncates (cut), the truth sampled once more (right), and the network's prediction "
    "(network).",
    parts=("pictures", "points, paper", "points, best", "network modes, paper", "network modes, best"),
    tables=tables,
    draw=draw,
    reading="The default preset is judged by two questions: how much of the error it removes, and how often it adds some. One "
    "mask says nothing of depth; symmetry and further masks are what reaches beyond it. Two samplings of one surface differ "
    "too: no ratio can fall below that floor. Starts that are right already show what a refinement costs where there is "
    "nothing to gain.",
    convention=CONVENTION,
    options=(
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
    plan=plan,
    conclude=conclude,
    kept="after every group of shapes",
)
