"""How much nearer to the truth a refinement comes, and how often it does harm, on unseen shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from tso_cli.evaluation.footprint import IOU_MEANS
from tso_cli.evaluation.metrics import chamfer, f_score
from tso_cli.geometry.points import Array
from tso_cli.io.output import check_output
from tso_cli.io.shipped import default_checkpoint

from .. import options
from ..charts import Panel, draw_cases, ratios
from ..harm.scenes import STARTS, Gallery, gallery
from ..options import option
from ..study import Cases, Plan, Progress, Record, Study, Table, claim
from .bounds import across_the_view
from .cases import (
    ABLATION,
    BY_MASKS,
    DEFAULT,
    KINDS,
    LEVELS,
    MASKS,
    NO_SYMMETRY,
    PAPER,
    POINTS,
    TWO_MASKS,
    Case,
    CaseBuilder,
    Variant,
    alone,
    farthest_point_subset,
    kinds_of,
    refined,
    with_prior,
)
from .shapes import Shape, prior_hash, shapes_of_part, view_aligned_network, weights_hash
from .summary import (
    grouped,
    interval,
    mean,
    ratio_figures,
    ratio_of_means,
    ratios_of,
    rounded,
    summarised,
)

CATEGORIES = ("chair", "airplane", "car", "sofa", "table")
UNSEEN, UNSEEN_CATEGORY = "unseen", "other kinds"
"""Kind and category of the cases of shapes in no list."""
SIZE, COUNT = 64, 1024
"""Pixels of the masks each way, points of the clouds."""
CASES_A_CALL = 32
F_THRESHOLD = 0.02


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    pictures: Path | None,
    prior: Path,
    unseen: Path | None = None,
    kinds: tuple[str, ...] = (),
    points: Mapping[str, Variant] = POINTS,
    **settings: Any,
) -> Plan:
    """Refine every case of every kind with every variant, and compare it with the truth.

    ``unseen`` : a folder of meshes whose cases are a kind of their own. ``prior`` is "learned",
    "none" or a file, for the variants of the default preset in points mode.
    """
    ablation, categories = settings["ablation"], settings["categories"]
    kinds = kinds or tuple(kind for kind in KINDS if kind != "right" or not ablation)
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    network, about = None, None
    if "network" in kinds:
        network, about = view_aligned_network(default_checkpoint())
    views, seed = settings["views"], settings["seed"]
    builder = CaseBuilder(meshes, split, views, SIZE, COUNT, seed, network, about)
    variants = with_prior(ABLATION if ablation else points, str(prior))
    settings |= {"categories": list(categories), "kinds": list(kinds)}
    settings |= {"shapes": [shape.name for shape in shapes]}
    settings["network"] = weights_hash(network) if network else None
    settings |= {"prior": prior.name, "prior_weights": prior_hash(prior)}
    settings["variants"] = list(variants)

    def refine_group(kind: str, group: list[Shape]) -> Cases:
        cases = [case for shape in group for case in builder.cases(shape, kind)]
        return refine_cases(cases, variants)

    def refine_unseen(scenes: Gallery, numbers: Sequence[int], view: int) -> Cases:
        return refine_cases([unseen_case(scenes, number, view) for number in numbers], variants)

    jobs, at_once = [], max(1, CASES_A_CALL // views)
    for category in categories:
        members = [shape for shape in shapes if shape.category == category]
        for kind, start in product(kinds_of(category, kinds), range(0, len(members), at_once)):
            group = members[start : start + at_once]
            shared: Record = {"kind": kind, "shape": group[0].name}
            jobs.append((shared, partial(refine_group, kind, group)))
    for view in range(views) if unseen else ():
        scenes = gallery(None, None, "", unseen, seed + view)
        for start in range(0, len(scenes.shapes), CASES_A_CALL):
            numbers = range(start, min(start + CASES_A_CALL, len(scenes.shapes)))
            shared = {"kind": UNSEEN, "shape": scenes.shape(start).name, "view": view}
            jobs.append((shared, partial(refine_unseen, scenes, numbers, view)))
    if pictures is None:
        return Plan(settings, jobs)
    check_output(pictures, progress.overwrite)

    def draw_extremes(record: Record) -> None:
        rows = _extremes(record, builder, shapes, variants[DEFAULT])
        draw_cases(pictures, rows, progress.overwrite)

    return Plan(settings, jobs, finish=draw_extremes)


def unseen_case(scenes: Gallery, number: int, view: int) -> Case:
    """The case of a shape of the gallery, with all its masks."""
    exact, other = (scenes.scene(number, start, MASKS) for start in STARTS)
    target = farthest_point_subset(other.dense, COUNT)
    floor = chamfer(exact.initial, target).chamfer
    return Case(
        UNSEEN,
        UNSEEN_CATEGORY,
        scenes.shape(number).name,
        view,
        "the truth, warped",
        other.initial,
        target,
        other.dense,
        other.views,
        floor,
    )


def refine_cases(cases: list[Case], variants: Mapping[str, Variant]) -> Cases:
    """Refine cases of one kind and category with every variant."""
    records: Cases = []
    for case in cases:
        before = rounded({**_distances(case.initial, case), "floor": case.floor})
        # A start that is right has nothing to gain.
        bound = {} if case.kind == "right" else rounded({"bound": across_the_view(case)})
        records.append({**case.names, "before": before, **bound, "variants": {}})
    for name, variant in variants.items():
        results = refined(cases, variant)
        for case, record, result in zip(cases, records, results, strict=True):
            ious = {"iou_before": result.fit.iou_before, "iou": result.fit.iou_after}
            record["variants"][name] = rounded({**_distances(result.points, case), **ious})
    return records


def _distances(points: Array, case: Case) -> dict[str, float]:
    distance, score = chamfer(points, case.target), f_score(points, case.dense, F_THRESHOLD)
    return {"chamfer": distance.chamfer, "f_score": score.f_score}


def _extremes(
    record: Record, builder: CaseBuilder, shapes: list[Shape], variant: Variant
) -> list[tuple[str, Case, Array]]:
    """(title, case, points) of the worst and the median case of each category, refined once more.

    They are of the first kind in ``record``; ``variant`` is the default.
    """
    by_name = {shape.name: shape for shape in shapes}
    kind, cases_of_kind = next(iter(grouped(record["cases"], "kind").items()))
    rows = []
    for category, cases in grouped(cases_of_kind, "category").items():
        ratios = ratios_of(cases, DEFAULT)
        order = np.argsort(ratios)[::-1]
        # A single case is the worst one.
        for place, name in {order[len(order) // 2]: "median", order[0]: "worst"}.items():
            shape = by_name[cases[place]["shape"]]
            case = builder.cases(shape, kind)[cases[place]["view"]]
            result = alone(case, variant, None)
            title = f"{category}, {name}: {ratios[place]:.2f}, {shape.name.partition('/')[2][:16]}"
            rows.append((title, case, result.points))
    return rows


# The targets, and whether the cases meet them.

ALL = "all"
"""All categories of a kind together."""
# Kind -> category -> variant -> mean Chamfer after / mean Chamfer before that is aimed at.
AIMS = {
    "other": {
        "chair": {DEFAULT: 0.50, TWO_MASKS: 0.40},
        "airplane": {DEFAULT: 0.40, TWO_MASKS: 0.30},
        "car": {DEFAULT: 0.75, TWO_MASKS: 0.68},
    },
    "near": {"airplane": {DEFAULT: 0.75}},
    "right": {ALL: {DEFAULT: 1.01}},
    "network": {ALL: {DEFAULT: 0.80}},
}
# Aims for starts near the truth: mean and worst ratio.
NEAR_MEAN, NEAR_WORST = 1.00, 1.05
# A start counts as near up to this many times its category's level.
NEAR_ENOUGH = 1.5
# Aims for harm: the share of cases stays below this, and the worst ratio is at most this.
WORSE_SHARE, WORST = 0.02, 1.05
# The share of all cases of the default preset that may have a ratio over `WORST`.
CLEARLY_WORSE_SHARE = 0.01


def claims(cases: Cases) -> list[Record]:
    """The targets, whether they are met, and the figures; only of kinds that were studied."""
    kinds = grouped(cases, "kind")
    answers = [aim for kind in AIMS if kind in kinds for aim in _aims(kind, kinds[kind])]
    if "other" in kinds:
        answers.append(_beyond_the_paper(kinds["other"]))
    answers += _stays_right(grouped(kinds.get("near", []), "category"))
    answers += [_rarely_clearly_worse(kind, group, WORSE_SHARE) for kind, group in kinds.items()]
    answers.append(_rarely_clearly_worse("all starts", cases, CLEARLY_WORSE_SHARE))
    # A start at the floor can only get worse.
    starts = {kind: group for kind, group in kinds.items() if kind != "right"}
    if starts:
        groups = {
            f"{kind}, {variant}": ratios_of(group, variant)
            for kind, group in starts.items()
            for variant in BY_MASKS
        }
        # Two and four masks hardly ever do harm; they must not hide the harm of one mask.
        one_mask = np.concatenate([ratios_of(group, DEFAULT) for group in starts.values()])
        what = "points mode, all starts, with one, two and four masks"
        answers.append(_rarely_worse(what, groups, float((one_mask > 1.0).mean())))
    return answers


def _aims(kind: str, cases: Cases) -> list[Record]:
    """Ratios of means; the mean of ratios says how much single cases differ from them."""

    def ratio_after(group: Cases, variant: str) -> float:
        return ratio_of_means(group, (case["variants"][variant]["chamfer"] for case in group))

    categories = {**grouped(cases, "category"), ALL: cases}
    answers = []
    for category in (name for name in AIMS[kind] if name in categories):
        group = categories[category]
        against = [f"the paper's preset {ratio_after(group, PAPER):.3f}"]
        if all("bound" in case for case in group):
            bound = ratio_of_means(group, (case["bound"] for case in group))
            against.append(f"bound of one mask {bound:.2f}")
        floor = ratio_of_means(group, (case["before"]["floor"] for case in group))
        against.append(f"sampling floor {floor:.2f}")
        for variant, aim in AIMS[kind][category].items():
            ratio, mean_ratio = ratio_after(group, variant), ratios_of(group, variant).mean()
            text = f"{kind}, {category}: {variant}: ratio of means at most {aim:.2f}"
            figures = f"{ratio:.3f}, mean of ratios {mean_ratio:.3f}; {', '.join(against)}"
            answers.append(claim(text, ratio <= aim, figures))
    return answers


def _beyond_the_paper(cases: Cases) -> Record:
    """Whole 95 % intervals, over shapes, of the difference of the mean ratios."""
    texts, highest = [], []
    for category, group in sorted(grouped(cases, "category").items()):
        for variant in (DEFAULT, NO_SYMMETRY, TWO_MASKS):
            gained = ratios_of(group, variant) - ratios_of(group, PAPER)
            highest.append(interval([case["shape"] for case in group], gained)[1])
            texts.append(f"{category}, {variant} {gained.mean():+.3f}, at most {highest[-1]:+.3f}")
    text = "every column lies below the paper's preset in every category"
    return claim(f"{text} (95 % interval over shapes)", max(highest) < 0.0, "; ".join(texts))


def _stays_right(by_category: dict[str, Cases]) -> list[Record]:
    answers = []
    for category, level in LEVELS["near"].items():
        most = NEAR_ENOUGH * level
        near = [case for case in by_category.get(category, []) if case["before"]["chamfer"] <= most]
        if near:
            ratios = ratios_of(near, DEFAULT)
            text = f"{category} near the truth: mean ratio at most {NEAR_MEAN:.2f}"
            text += f", worst at most {NEAR_WORST:.2f}"
            holds = ratios.mean() <= NEAR_MEAN and ratios.max() <= NEAR_WORST
            figures = f"{ratios.mean():.3f}, {ratios.max():.3f}; {len(near)} cases"
            answers.append(
                claim(text, holds, f"{figures} with Chamfer x1000 up to {1e3 * most:.1f}")
            )
    return answers


def _rarely_worse(what: str, groups: dict[str, np.ndarray], share: float = 0.0) -> Record:
    """``groups`` : label -> ratios; ``share`` : of a group that the others may not hide."""
    ratios = np.concatenate(list(groups.values()))
    of_all = float((ratios > 1.0).mean())
    figures = [f"{100.0 * of_all:.1f} % of {len(ratios)}, worst {ratios.max():.3f}"]
    for name, values in groups.items():
        figures.append(f"{name}: {(values > 1.0).sum()} of {len(values)}, {values.max():.3f}")
    text = f"{what}: under {100.0 * WORSE_SHARE:g} % of cases are made worse"
    text += f", none by over {100.0 * (WORST - 1.0):.0f} %"
    holds = max(share, of_all) < WORSE_SHARE and ratios.max() <= WORST
    return claim(text, holds, "; ".join(figures))


def _rarely_clearly_worse(kind: str, cases: Cases, limit: float) -> Record:
    """Of one kind of start, or all, with one mask; the share must be under the ``limit``."""
    ratios = ratios_of(cases, DEFAULT)
    share = float((ratios > WORST).mean())
    text = f"{kind}: {DEFAULT}: under {100.0 * limit:g} % of cases become worse by over "
    figures = f"{100.0 * share:.1f} % of {len(ratios)}, worst {ratios.max():.3f}"
    return claim(f"{text}{100.0 * (WORST - 1.0):.0f} %", share < limit, figures)


def conclude(cases: Cases) -> Record:
    """{"summary": {kind: {category: {"cases", "before", "variants"}}}, "claims"}.

    A category has a "bound_ratio" too, mean bound over mean before, where its cases have a bound.
    An ablation makes no claims.
    """
    summary = summarised(cases, ("kind", "category"), _means)
    ablation = TWO_MASKS not in cases[0]["variants"]
    return {"summary": summary, "claims": [] if ablation else claims(cases)}


def _means(cases: Cases) -> Record:
    before = {key: mean(case["before"][key] for case in cases) for key in ("chamfer", "f_score")}
    floors = (case["before"]["floor"] / case["before"]["chamfer"] for case in cases)
    before["floor_ratio"] = mean(floors)
    variants = {}
    for name in cases[0]["variants"]:
        rows = [case["variants"][name] for case in cases]
        keys = ("chamfer", "f_score", "iou_before", "iou")
        means = {key: mean(row[key] for row in rows) for key in keys}
        variants[name] = rounded(means | ratio_figures(ratios_of(cases, name)))
    bound = {}
    if all("bound" in case for case in cases):
        bound["bound_ratio"] = ratio_of_means(cases, (case["bound"] for case in cases))
    return {"cases": len(cases), "before": before, **rounded(bound), "variants": variants}


def tables(record: Record) -> list[Table]:
    """A row for each variant; of an ablation one table for all categories."""
    summary = record["summary"]
    if record["settings"]["ablation"]:
        groups = {
            f"{category}, {kind}": group
            for kind, of_kind in summary.items()
            for category, group in of_kind.items()
        }
        return [Table(["", *groups], _rows(groups), note=CELLS)]
    rows = []
    for category in dict.fromkeys(category for of_kind in summary.values() for category in of_kind):
        of_kinds = {kind: of_kind.get(category) for kind, of_kind in summary.items()}
        rows += [[category, *row] for row in _rows(of_kinds)]
    return [Table(["category", "variant", *summary], rows, note=CELLS)]


CELLS = "mean of Chamfer after / before (number of cases that got worse, worst ratio); floor: the "
CELLS += "ratio of another sampling of the truth; bound: mean Chamfer of the best deformation "
CELLS += "across the view / mean Chamfer of the start"
LAST_ROWS = ("bound", "floor", "start, Chamfer x1000", "cases")


def _rows(groups: dict[str, Record | None]) -> list[list[str | None]]:
    """Rows of variants, then of the start; a column for each of ``groups``."""
    cells = {key: _cells(group) if group else {} for key, group in groups.items()}
    names = dict.fromkeys(name for column in cells.values() for name in column)
    return [
        [name, *(column.get(name) for column in cells.values())]
        for name in sorted(names, key=LAST_ROWS.__contains__)
    ]


def _cells(group: Record) -> dict[str, str]:
    ratios = "{mean_ratio:.2f} ({worse}, {worst_ratio:.2f})"
    before, variants = group["before"], group["variants"].items()
    bound = {"bound": f"{group['bound_ratio']:.2f}"} if "bound_ratio" in group else {}
    last = f"{before['floor_ratio']:.2f}", f"{1e3 * before['chamfer']:.1f}", str(group["cases"])
    cells = {name: ratios.format_map(figures) for name, figures in variants}
    return cells | bound | dict(zip(LAST_ROWS[1:], last, strict=True))


def grid(record: Record) -> list[list[Panel]]:
    """Ratios of all cases, a row of panels for each kind."""
    rows = []
    for name, group in grouped(record["cases"], "kind").items():
        panels = []
        for category, cases in grouped(group, "category").items():
            of_variants = {variant: ratios_of(cases, variant) for variant in cases[0]["variants"]}
            panels.append(Panel(f"{category}, {name}", of_variants))
        rows.append(panels)
    return rows


STUDY = Study(
    name="accuracy",
    values={"F_THRESHOLD": F_THRESHOLD, "IOU_MEANS": IOU_MEANS},
    parts=("pictures", "points, paper", "points, best", "network modes, paper"),
    tables=tables,
    draw=ratios(grid),
    options=(
        *options.COMMON,
        options.part("test"),
        options.categories(*CATEGORIES),
        options.views(2),
        options.PRIOR,
        options.UNSEEN,
        option("--ablation", "Change one ingredient of the default preset at a time.", bool, False),
        option(
            "--pictures", "Draw the worst and the median case of each category here (.png).", Path
        ),
    ),
    plan=plan,
    conclude=conclude,
)
