"""How much nearer to the truth a refinement comes, and how often further away: every preset and variant on unseen shapes."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...evaluation.footprint import IOU_MEANS
from ...evaluation.metrics import chamfer, emd, f_score
from ...geometry.points import Array
from ...io.output import check_output
from ...network.model import BaseNetwork
from ..charts.accuracy_pictures import draw_cases
from ..charts.ratios import Panel, draw_ratios
from ..study import CHECKPOINT, COMMON, DEVICE, VIEWS, Cases, Option, Progress, Record, Study, Table, part, record_of
from .accuracy_cases import KINDS, AccuracyCase, CaseBuilder, check_points, kinds_of
from .accuracy_claims import claims, ratios_of, select, summarise
from .accuracy_variants import DEFAULT, Variant, alone, refined, variants_of
from .parts import Shape, shapes_of_part, view_aligned_network, weights_hash
from .summary import rounded

CATEGORIES = ("chair", "airplane", "car", "sofa", "table")
GROUP = 32
"""Cases that are refined together: their dense matrices fill 0.4 GiB."""
TIMED = 6
"""Cases of each kind, category and variant that are refined once more, alone, for the time."""
STARTS = "Where the starts are from. May be repeated.  [default: all; with --ablation all but right]"
F_THRESHOLD = 0.02
ASSIGNED = 2048
"""Points up to which one-to-one assignments are solved."""
CONVENTION = {
    "chamfer": "squared distances, mean over points, forward + backward, longest side 1; to as many target points",
    "dense": "the same to 16,384 target points",
    "f_score": f"share of points with a counterpart nearer than {F_THRESHOLD}, harmonic mean of both directions, 16,384 target "
    "points",
    "emd": "mean distance of an optimal one-to-one assignment; none over 2,048 points",
    "iou": IOU_MEANS,
    "floor": "Chamfer distance of another sampling of the true surface",
    "in_plane": "each point keeps its depth and takes the place in the image plane of the target point that an optimal "
    "assignment gives it, or none moves where that is nearer",
    "seconds": "one call of refine alone, median over up to 6 cases; batch_seconds: a case of a batch",
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

    ``settings`` : the other options, which the record keeps.

    Raises
    ------
    InputError
        A shape is missing, the network is not view-aligned, or the earlier record is of other settings.
    TsoError
        A case cannot be refined.
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
    # A group of which a shape is missing is judged anew as a whole.
    complete_groups = [all((kind, shape.name) in done for shape in group) for kind, group in groups]
    kept = {(kind, s.name) for (kind, group), whole in zip(groups, complete_groups, strict=True) if whole for s in group}
    cases = [case for case in cases if (case["kind"], case["shape"]) in kept]
    timed = {(case["kind"], case["category"]) for case in cases}

    def judged(kind: str, group: list[Shape]) -> Cases:
        built = [case for shape in group for case in builder.cases(shape, kind)]
        first = (kind, group[0].category) not in timed
        timed.add((kind, group[0].category))
        return judge_group(built, variants[kind], settings["device"], network, TIMED if first else 0)

    def record(cases: Cases, complete: bool) -> Record:
        summary = summarise(cases)
        answers = claims(cases, summary) if complete and not settings["ablation"] else []
        return record_of(
            "accuracy", CONVENTION, complete=complete, settings=settings, summary=summary, claims=answers, cases=cases
        )

    work = [
        None if whole else partial(judged, kind, group) for (kind, group), whole in zip(groups, complete_groups, strict=True)
    ]
    finished = progress.complete("refining", cases, work, record)
    if pictures is not None:
        draw_cases(pictures, _extremes(finished, builder, shapes), progress.overwrite)
    return finished


def _groups(
    shapes: list[Shape], categories: tuple[str, ...], kinds: tuple[str, ...], size: int
) -> list[tuple[str, list[Shape]]]:
    """(kind, shapes of one category) that are refined together."""
    groups = []
    for category in categories:
        members = [shape for shape in shapes if shape.category == category]
        for kind in kinds_of(category, kinds):
            groups += [(kind, members[i : i + size]) for i in range(0, len(members), size)]
    return groups


def judge_group(
    cases: list[AccuracyCase], variants: dict[str, Variant], device: str, network: BaseNetwork | None, timed: int
) -> Cases:
    """Refine cases of one kind and category with every variant; the first ``timed`` once more, alone, for the time."""
    records: Cases = []
    for case in cases:
        before = {
            **_judged(case.initial, case),
            "floor": case.floor,
            "floor_dense": case.floor_dense,
            "in_plane": in_plane(case),
        }
        names = {key: getattr(case, key) for key in ("kind", "category", "shape", "view", "start")}
        records.append({**names, "before": rounded(before), "variants": {}})
    for name, variant in variants.items():
        results, batch_seconds = refined(cases, variant, device, network)
        for number, (case, record, result) in enumerate(zip(cases, records, results, strict=True)):
            row = _judged(result.points, case)
            row |= {"iou_before": result.iou_before, "iou": result.iou_after, "mirrored": result.symmetry is not None}
            if batch_seconds is not None:
                row["batch_seconds"] = batch_seconds
            if number < timed:
                row["seconds"] = alone(case, variant, device, network)[1]
            record["variants"][name] = rounded(row)
    return records


def _judged(points: Array, case: AccuracyCase) -> dict[str, Any]:
    return {
        "chamfer": chamfer(points, case.target).chamfer,
        "dense": chamfer(points, case.dense).chamfer,
        "f_score": f_score(points, case.dense, F_THRESHOLD).f_score,
        "emd": emd(points, case.target) if len(points) <= ASSIGNED else None,
    }


def in_plane(case: AccuracyCase) -> float | None:
    """Chamfer distance of the start once nothing is wrong with it but depth, as the case's own camera sees it.

    Each point moves parallel to the image plane, to the place of the target point that an optimal one-to-one assignment
    (squared distances) gives it, or none moves where that is nearer. None over 2,048 points, and for a network's prediction,
    whose points lie so unevenly that an assignment does more harm than good.
    """
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    if len(case.initial) > ASSIGNED or case.kind == "network":
        return None
    rotation = case.views[0].camera.R
    moved, truth = case.initial @ rotation.T, case.target @ rotation.T
    _, paired = linear_sum_assignment(cdist(moved, truth, "sqeuclidean"))
    moved[:, :2] = truth[paired, :2]
    # An assignment leads a few clouds astray, seen along a flat part: these stay as they are.
    return min(chamfer(moved, truth).chamfer, chamfer(case.initial, case.target).chamfer)


def _extremes(record: Record, builder: CaseBuilder, shapes: list[Shape]) -> list[tuple[str, AccuracyCase, Array]]:
    """Worst, median and best case of each category under the default preset, refined once more: (title, case, points).

    They are of the first kind in ``record``.
    """
    by_name = {shape.name: shape for shape in shapes}
    kind = next(iter(record["summary"]))
    variant = variants_of(kind, record["settings"]["ablation"])[DEFAULT]
    rows = []
    for category in record["summary"][kind]:
        cases = select(record["cases"], kind, category)
        ratios = ratios_of(cases, DEFAULT)
        order = np.argsort(ratios)[::-1]
        # One or two cases have fewer than three places.
        for place, name in {order[0]: "worst", order[len(order) // 2]: "median", order[-1]: "best"}.items():
            shape = by_name[cases[place]["shape"]]
            case = builder.cases(shape, kind)[cases[place]["view"]]
            result, _ = alone(case, variant, record["settings"]["device"], builder.network)
            title = f"{category}, {name}: {ratios[place]:.2f}, {shape.name.partition('/')[2][:16]}"
            rows.append((title, case, result.points))
    return rows


def tables(record: Record) -> list[Table]:
    """What each variant reaches, and what bounds it; of an ablation a row an ingredient and a column a kind and category."""
    groups = [(kind, category, group) for kind, summary in record["summary"].items() for category, group in summary.items()]
    if record["settings"]["ablation"]:
        return [_ablation(groups)]
    rows, bounds = [], []
    for kind, category, group in groups:
        before, count = group["before"], group["cases"]
        floors = (before.get(f"{bound}_ratio") for bound in ("floor", "in_plane"))
        bounds.append([kind, category, group["shapes"], count, 1e3 * before["chamfer"], *floors])
        for name, row in group["variants"].items():
            figures = [row[key] for key in ("mean_ratio", "median_ratio", "worst_ratio", "worse", "worse_by_5")]
            figures += [row["chamfer_excess"], row["dense_ratio"], before["f_score"], row["f_score"], before["emd"], row["emd"]]
            figures += [row[key] for key in ("iou_before", "iou", "median_seconds", "batch_seconds")]
            rows.append([kind, category, name, 1e3 * before["chamfer"], 1e3 * row["chamfer"], *figures])
    header = [
        "kind",
        "category",
        "variant",
        "before",
        "after",
        "ratio",
        "median",
        "worst",
        "worse",
        "by 5 %",
        "excess",
        "dense",
    ]
    header += ["F", "after", "EMD", "after", "IoU", "after", "s", "in a batch"]
    note = (
        "before, after: Chamfer x1000; ratio: after/before, mean of the cases' own; worse, by 5 %: cases over 1 and over 1.05; "
        "excess: ratio of the means less the floor that another sampling of the truth has; dense: ratio by 16,384 target "
        "points; s: median seconds a case"
    )
    bound_header = ["kind", "category", "shapes", "cases", "start", "floor / before", "all but depth right / before"]
    return [Table(header, rows, note=note), Table(bound_header, bounds)]


def _ablation(groups: list[tuple[str, str, dict[str, Any]]]) -> Table:
    def cell(row: dict[str, Any]) -> str:
        return f"{row['mean_ratio']:.2f} ({row['worse']}, {row['worst_ratio']:.2f})"

    header = ["", *(f"{category}, {kind}" for kind, category, _ in groups)]
    rows = [[name, *(cell(group["variants"][name]) for *_, group in groups)] for name in groups[0][2]["variants"]]
    rows.append(["Chamfer x1000 of the start", *(f"{1e3 * group['before']['chamfer']:.1f}" for *_, group in groups)])
    rows.append(["cases", *(str(group["cases"]) for *_, group in groups)])
    return Table(header, rows, note="mean of Chamfer after / before (cases that got worse, worst case)")


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Chamfer after / before of every case; a row of panels for each kind, a panel for each category."""
    grid = []
    for kind, summary in record["summary"].items():
        panels = []
        for category, group in summary.items():
            cases = select(record["cases"], kind, category)
            panels.append(Panel(f"{category}, {kind}", {name: ratios_of(cases, name) for name in group["variants"]}))
        grid.append(panels)
    draw_ratios(path, grid, overwrite)


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
    "says nothing of depth, so that even a perfect answer in the image plane leaves a good part of the error; symmetry and "
    "further masks are what reaches beyond it. Two samplings of one surface differ too: no ratio can fall below that floor. "
    "Starts that are right already show what a refinement costs where there is nothing to gain.",
    kept="after every group of shapes",
)
