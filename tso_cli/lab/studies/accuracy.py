"""How much nearer to the truth a refinement comes, and how often further away: every preset and variant on unseen shapes."""

from __future__ import annotations

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
from ..charts import Panel, draw_cases, draw_ratios
from ..study import (
    CHECKPOINT,
    COMMON,
    DEVICE,
    VIEWS,
    Cases,
    Option,
    Plan,
    Progress,
    Record,
    Study,
    Table,
    claim,
    part,
)
from .cases import JUDGED, KINDS, LEVELS, SAMPLES, Case, CaseBuilder, kinds_of
from .refining import (
    COMBINED,
    DEFAULT,
    MASKS,
    NETWORK_MODES,
    NO_SYMMETRY,
    PAPER,
    TWO_MASKS,
    Variant,
    alone,
    refined,
    variants_of,
)
from .shapes import Shape, shapes_of_part, view_aligned_network, weights_hash
from .summary import grouped, interval, mean, ratio_figures, ratios_of, rounded, summarised

CATEGORIES = ("chair", "airplane", "car", "sofa", "table")
GROUP = 32
"""Cases that are refined in one call."""
STARTS = (
    "Where the starts are from. May be repeated.  [default: all; with --ablation all but right]"
)
F_THRESHOLD = 0.02
# Of a row of the table, beside Chamfer.
FIGURES = (
    "mean_ratio",
    "median_ratio",
    "worst_ratio",
    "worse",
    "floor_ratio",
    "start_f_score",
    "f_score",
    "iou_before",
    "iou",
)
# Mean Chamfer after / before that is aimed at, one random 64x64 mask, starts from other shapes.
AIMS = {
    "chair": {DEFAULT: 0.50, NO_SYMMETRY: 0.75, TWO_MASKS: 0.40},
    "airplane": {DEFAULT: 0.40, NO_SYMMETRY: 0.60, TWO_MASKS: 0.30},
    "car": {DEFAULT: 0.80, NO_SYMMETRY: 0.87, TWO_MASKS: 0.70},
}
# Already right stays right: mean and worst ratio of starts near the sampling floor.
NEAR_MEAN, NEAR_WORST = 1.00, 1.05
# Times the level of such starts: one further off is not near.
NEAR_ENOUGH = 1.5
# Over everything: share of cases made worse, and the worst of them.
WORSE_SHARE, WORST = 0.02, 1.05
NETWORK_TIMES, NETWORK_BEST = 2.0, 0.75
CONVENTION = {
    "chamfer": "squared distances, mean over points, forward + backward, longest side 1; to as many target points",
    "f_score": f"share of points with a counterpart nearer than {F_THRESHOLD}, harmonic mean of both directions, 16,384 target "
    "points",
    "iou": IOU_MEANS,
    "floor": "Chamfer distance of another sampling of the true surface",
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
        raise InputError(
            f"points is {points}, expected {about.points}, as many as the network predicts, for kind network"
        )
    builder = CaseBuilder(
        meshes, split, settings["views"], settings["size"], points, settings["seed"], network, about
    )
    variants = {kind: variants_of(kind, settings["ablation"]) for kind in kinds}
    settings |= {
        "categories": list(categories),
        "kinds": list(kinds),
        "shapes": [shape.name for shape in shapes],
    }
    settings["network"] = weights_hash(network) if network else None
    settings["variants"] = {kind: list(of_kind) for kind, of_kind in variants.items()}

    def judge(kind: str, group: list[Shape]) -> Cases:
        cases = [case for shape in group for case in builder.cases(shape, kind)]
        return judge_group(cases, variants[kind], settings["device"], network)

    jobs, size = [], max(1, GROUP // settings["views"])
    for category in categories:
        members = [shape for shape in shapes if shape.category == category]
        for kind, start in product(kinds_of(category, kinds), range(0, len(members), size)):
            group = members[start : start + size]
            jobs.append(({"kind": kind, "shape": group[0].name}, partial(judge, kind, group)))
    if not jobs:
        raise InputError(
            f"kinds are {', '.join(kinds)}, expected some that {', '.join(categories)} have"
        )

    def draw_extremes(record: Record) -> None:
        if pictures is not None:
            draw_cases(pictures, _extremes(record, builder, shapes), progress.overwrite)

    return Plan(settings, jobs, finish=draw_extremes)


def judge_group(
    cases: list[Case], variants: dict[str, Variant], device: str, network: BaseNetwork | None
) -> Cases:
    """Refine cases of one kind and category with every variant."""
    records: Cases = []
    for case in cases:
        names = {key: getattr(case, key) for key in ("kind", "category", "shape", "view")}
        records.append(
            {
                **names,
                "before": rounded({**_scores(case.initial, case), "floor": case.floor}),
                "variants": {},
            }
        )
    for name, variant in variants.items():
        results = refined(cases, variant, device, network)
        for case, record, result in zip(cases, records, results, strict=True):
            row = {
                **_scores(result.points, case),
                "iou_before": result.iou_before,
                "iou": result.iou_after,
            }
            record["variants"][name] = rounded(row)
    return records


def _scores(points: Array, case: Case) -> dict[str, float]:
    distance, score = chamfer(points, case.target), f_score(points, case.dense, F_THRESHOLD)
    return {"chamfer": distance.chamfer, "f_score": score.f_score}


def _extremes(
    record: Record, builder: CaseBuilder, shapes: list[Shape]
) -> list[tuple[str, Case, Array]]:
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
    summary = summarised(cases, ("kind", "category"), _means)
    return {
        "summary": summary,
        "claims": claims(cases, summary) if TWO_MASKS in cases[0]["variants"] else [],
    }


def claims(cases: Cases, summary: Record) -> list[Record]:
    """The targets, whether they are met, and the figures that say so; only of kinds that were studied."""
    kinds = grouped(cases, "kind")
    answers = []
    if "other" in kinds:
        answers += [*_aims(summary["other"]), _beyond_the_paper(kinds["other"])]
    answers += _stays_right(grouped(kinds.get("near", []), "category"))
    # What starts at the floor can only get worse.
    starts = {kind: group for kind, group in kinds.items() if kind != "right"}
    if starts:
        groups = {
            f"{kind}, {variant}": ratios_of(group, variant)
            for kind, group in starts.items()
            for variant in MASKS
        }
        # The many that two and four masks hardly ever harm must not hide what one does.
        one_mask = np.concatenate([ratios_of(group, DEFAULT) for group in starts.values()])
        share = float((one_mask > 1.0).mean())
        answers.append(
            _rarely_worse("points mode, all starts, with one, two and four masks", groups, share)
        )
    if "network" in kinds:
        names = (*(f"{mode}, {DEFAULT}" for mode in NETWORK_MODES), *COMBINED)
        groups = {name: ratios_of(kinds["network"], name) for name in names}
        answers += [
            _rarely_worse("network modes, and points mode after them", groups),
            *_network(kinds["network"]),
        ]
    return answers


def _aims(summary: Record) -> list[Record]:
    answers = []
    for category in (name for name in AIMS if name in summary):
        variants, floor = summary[category]["variants"], summary[category]["before"]["floor_ratio"]
        for variant, aim in AIMS[category].items():
            ratio = variants[variant]["mean_ratio"]
            text = f"{ratio:.3f}; the paper's preset {variants[PAPER]['mean_ratio']:.3f}, sampling floor {floor:.2f}"
            answers.append(
                claim(f"{category}: {variant}: mean ratio at most {aim:.2f}", ratio <= aim, text)
            )
    return answers


def _beyond_the_paper(cases: Cases) -> Record:
    """Whole 95 % intervals, over shapes, of the difference of the mean ratios."""
    texts, highest = [], []
    for category, group in sorted(grouped(cases, "category").items()):
        for variant in (DEFAULT, NO_SYMMETRY, TWO_MASKS):
            gained = ratios_of(group, variant) - ratios_of(group, PAPER)
            highest.append(interval([case["shape"] for case in group], gained)[1])
            texts.append(f"{category}, {variant} {gained.mean():+.3f}, at most {highest[-1]:+.3f}")
    text = (
        "every column lies below the paper's preset in every category (95 % interval over shapes)"
    )
    return claim(text, max(highest) < 0.0, "; ".join(texts))


def _stays_right(by_category: dict[str, Cases]) -> list[Record]:
    answers = []
    for category, level in LEVELS["near"].items():
        near = [
            case
            for case in by_category.get(category, [])
            if case["before"]["chamfer"] <= NEAR_ENOUGH * level
        ]
        if near:
            ratios = ratios_of(near, DEFAULT)
            text = f"{category} near the truth: mean ratio at most {NEAR_MEAN:.2f}, worst at most {NEAR_WORST:.2f}"
            holds = ratios.mean() <= NEAR_MEAN and ratios.max() <= NEAR_WORST
            figures = f"{ratios.mean():.3f}, {ratios.max():.3f}; {len(near)} cases up to {1e3 * NEAR_ENOUGH * level:.1f} off"
            answers.append(claim(text, holds, figures))
    return answers


def _rarely_worse(what: str, groups: dict[str, np.ndarray], share: float = 0.0) -> Record:
    """``groups`` : label -> ratios; ``share`` : of a group that may not be hidden by the others."""
    ratios = np.concatenate(list(groups.values()))
    of_all = float((ratios > 1.0).mean())
    figures = [f"{100.0 * of_all:.1f} % of {len(ratios)}, worst {ratios.max():.3f}"]
    figures += [
        f"{name}: {(values > 1.0).sum()} of {len(values)}, {values.max():.3f}"
        for name, values in groups.items()
    ]
    text = f"{what}: under {100.0 * WORSE_SHARE:g} % of cases are made worse, none by over {100.0 * (WORST - 1.0):.0f} %"
    return claim(
        text, max(share, of_all) < WORSE_SHARE and ratios.max() <= WORST, "; ".join(figures)
    )


def _network(cases: Cases) -> list[Record]:
    """Relative gains from the network's prediction; the paper has no latent variant, which is held against its best."""
    ratio = {name: float(ratios_of(cases, name).mean()) for name in cases[0]["variants"]}
    theirs = {
        "points": ratio[PAPER],
        **{mode: ratio[f"{mode}, {PAPER}"] for mode in NETWORK_MODES if mode != "latent"},
    }
    ours = {
        "points": ratio[DEFAULT],
        **{mode: ratio[f"{mode}, {DEFAULT}"] for mode in NETWORK_MODES},
    }
    theirs["latent"] = min(theirs.values())
    holds = all(
        1.0 - ours[mode] >= NETWORK_TIMES * (1.0 - theirs[mode]) and ours[mode] < 1.0
        for mode in ours
    )
    text = ", ".join(f"{mode} {theirs[mode]:.3f} to {ours[mode]:.3f}" for mode in ours)
    combinations = (
        DEFAULT,
        NO_SYMMETRY,
        *COMBINED,
        *(f"{mode}, {DEFAULT}" for mode in NETWORK_MODES),
    )
    best = min(combinations, key=lambda name: ratio[name])
    best_text = f"the best combination comes to {NETWORK_BEST} or less"
    return [
        claim(
            "from the network's prediction every variant gains at least twice what the paper's settings do",
            holds,
            text,
        ),
        claim(best_text, ratio[best] <= NETWORK_BEST, f"{best} {ratio[best]:.3f}"),
    ]


def _means(cases: Cases) -> Record:
    before = {key: mean(case["before"][key] for case in cases) for key in ("chamfer", "f_score")}
    before["floor_ratio"] = mean(
        case["before"]["floor"] / case["before"]["chamfer"] for case in cases
    )
    variants = {}
    for name in cases[0]["variants"]:
        rows = [case["variants"][name] for case in cases]
        row = {
            key: mean(row[key] for row in rows)
            for key in ("chamfer", "f_score", "iou_before", "iou")
        }
        variants[name] = rounded(row | ratio_figures(ratios_of(cases, name)))
    return {"cases": len(cases), "before": before, "variants": variants}


def tables(record: Record) -> list[Table]:
    """What each variant reaches; of an ablation a row an ingredient and a column a kind and category."""
    groups = [
        (kind, category, group)
        for kind, summary in record["summary"].items()
        for category, group in summary.items()
    ]
    if record["settings"]["ablation"]:
        return [_ablation(groups)]
    rows = []
    for kind, category, group in groups:
        before = group["before"]
        for name, row in group["variants"].items():
            start = [
                kind,
                category,
                group["cases"],
                name,
                1e3 * before["chamfer"],
                1e3 * row["chamfer"],
            ]
            figures = {
                **row,
                "floor_ratio": before["floor_ratio"],
                "start_f_score": before["f_score"],
            }
            rows.append([*start, *(figures[key] for key in FIGURES)])
    header = [
        "kind",
        "category",
        "cases",
        "variant",
        "before",
        "after",
        "ratio",
        "median",
        "worst",
        "worse",
        "floor",
    ]
    note = (
        "before, after: Chamfer x1000; ratio: after/before, mean of the cases' own; worse: cases over 1; floor: ratio that "
        "another sampling of the truth has"
    )
    return [Table([*header, "F", "after", "IoU", "after"], rows, note=note)]


def _ablation(groups: list[tuple[str, str, Record]]) -> Table:
    def cell(row: Record) -> str:
        return f"{row['mean_ratio']:.2f} ({row['worse']}, {row['worst_ratio']:.2f})"

    header = ["", *(f"{category}, {kind}" for kind, category, _ in groups)]
    rows = [
        [name, *(cell(group["variants"][name]) for *_, group in groups)]
        for name in groups[0][2]["variants"]
    ]
    rows.append(
        [
            "Chamfer x1000 of the start",
            *(f"{1e3 * group['before']['chamfer']:.1f}" for *_, group in groups),
        ]
    )
    rows.append(["cases", *(str(group["cases"]) for *_, group in groups)])
    return Table(
        header, rows, note="mean of Chamfer after / before (cases that got worse, worst case)"
    )


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Ratios of all cases, a row of panels for each kind."""
    grid: list[list[Panel]] = []
    for kind, of_kind in grouped(record["cases"], "kind").items():
        groups = grouped(of_kind, "category").items()
        ratios = {
            category: {name: ratios_of(cases, name) for name in cases[0]["variants"]}
            for category, cases in groups
        }
        grid.append([Panel(f"{category}, {kind}", rows) for category, rows in ratios.items()])
    draw_ratios(path, grid, overwrite)


STUDY = Study(
    name="accuracy",
    about="Starts are another shape's cloud as wrong as a trained network's (other), one near the truth (near), the first "
    "with an object that the border truncates (cut), the truth sampled once more (right), and the network's prediction "
    "(network).",
    parts=(
        "pictures",
        "points, paper",
        "points, best",
        "network modes, paper",
        "network modes, best",
    ),
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
        Option(
            "--category", "May be repeated.", default=CATEGORIES, multiple=True, name="categories"
        ),
        Option("--kind", STARTS, str, (), KINDS, multiple=True, name="kinds"),
        VIEWS,
        Option("--size", "Of the masks, pixels each way.", int, 64, least=16, most=1024),
        Option("--points", "Of initial and target clouds, 1024 to 16384.", int, 1024),
        Option("--ablation", "Change one ingredient of the default preset at a time.", bool, False),
        Option(
            "--pictures",
            "Draw the worst, the median and the best case of each category here (.png).",
            Path,
        ),
        DEVICE,
    ),
    plan=plan,
    conclude=conclude,
)
