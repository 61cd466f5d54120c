"""Does a low confidence show which results are worse than their start? And how it is fitted."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...diagnosis.confidence import LEAST_CONFIDENCE, MODEL, MOST_DEVIATIONS
from ...io.output import atomic_output
from ...kernels.dispatch import decided
from ...refinement import RefineConfig
from .. import options
from ..charts import draw_bars
from ..options import Option
from ..stability.axes import AXES
from ..stability.runs import Outcome, Run, outcomes_of
from ..study import Cases, Plan, Progress, Record, Study, Table, claim
from .cases import Case, CaseBuilder, kinds_of
from .refining import Variant
from .shapes import shapes_of_part
from .summary import grouped

CATEGORIES, KINDS = ("chair", "airplane", "car", "sofa", "table"), ("other", "near", "right")
SIZE, POINTS = 128, 1024
"""Pixels of the masks each way, points of the clouds."""
UNALTERED = AXES[0]
# The number of masks is drawn separately.
ALTERED = tuple(axis for axis in AXES if axis.group != "settings" and axis.masks <= 2)
HIGHEST_LEVEL = {"many points": 16384, "large picture": 2048}
"""Beyond these levels only the time changes."""
MASKS = (1, 1, 1, 1, 1, 2, 4)
"""The number of masks is drawn from these."""
DRAWS = 3
"""How often alterations are drawn for the fit, each time with other views.

The fit sees validation shapes alone: the learned prior was trained on the training shapes.
"""
RIGHT_MASKS = (1, 2, 4)
"""The fit sees each case without an alteration with so many masks."""
WHOLE_STEP = Variant(RefineConfig(accept_doubtful=True))
"""So much work that compiled loops pay."""
WORSE = 1.05
# The confidence is meant for users of whom so many have right input.
RIGHT_SHARE = 0.8
BINS = 10
LEAST_AUC, LEAST_NAMED = {"all": 0.93, "camera and mask": 0.85}, 0.92
# Smaller ratios count as this one in a mean of logarithms.
SMALLEST_RATIO = 1e-3
CONVENTION = {
    "worse": "Chamfer distance of the cloud's own points to the truth over 1.05 times the distance "
    "before",
    "AUC": "chance that a worse result has less confidence than one that is not worse",
    "right scenes": "as rendered, nothing altered; a start that is another shape is no mistake",
    "flagged": "doubtful, for low confidence or because of a finding",
    "finding": "of the result or the refusal; any, also another than the mistake that was made",
    "named": "the gross mistake that was made is among the findings",
    "gross": "mistakes of convention, as axes, units, transposed or inverted input; not in the "
    "other groups",
}
Row = tuple[Record, dict[str, float]]
"""What became of a run, and the features of its result."""


def alterations(
    case: Case, other: Case, count: int, seed: int, to_fit: bool = False
) -> Iterator[Run]:
    """A case as it is, and with ``count`` alterations, each at a random level.

    ``to_fit`` repeats the case as it is with `RIGHT_MASKS`. ``other`` has the mask of another
    object.
    """
    words = (zlib.crc32(word.encode()) for word in (case.shape, case.kind))
    rng = np.random.default_rng([seed, *words, case.view])
    for axis in (UNALTERED, *rng.choice(np.array(ALTERED, dtype=object), count)):
        most = HIGHEST_LEVEL.get(axis.name, np.inf)
        level = float(rng.choice([level for level in axis.levels if level <= most]))
        masks = int(rng.choice(MASKS))
        own = np.random.default_rng(rng.integers(1 << 32))
        if axis != UNALTERED or not to_fit:
            yield Run(axis, level, case, other, own, masks)
    for masks in RIGHT_MASKS if to_fit else ():
        yield Run(UNALTERED, 1.0, case, other, rng, masks)


def rows_of(runs: Iterable[Run]) -> list[Row]:
    """The rows of runs; a run whose result is no number is left out."""
    with decided(True):
        rows = map(row_of, outcomes_of(runs, WHOLE_STEP))
        return [row for row in rows if row is not None]


def row_of(outcome: Outcome) -> Row | None:
    """What became of a run, with the features of its result; None where it is no number."""
    run, result, ratio = outcome.run, outcome.result, outcome.ratio()
    row: Record = {key: getattr(run.case, key) for key in ("category", "shape", "kind")}
    row |= {"axis": run.axis.name, "group": "gross" if run.axis.gross else run.axis.group}
    row |= {"level": run.level}
    if mistake := run.axis.mistake(run.level):
        row["named"] = mistake in outcome.findings
    row["suspected"] = bool(outcome.findings)
    if result is None:
        return row | {"refused": True}, {}
    if ratio is None:
        return None
    # A start that is kept under a finding has no confidence; it is as it was.
    confidence = result.trust.confidence
    if confidence is None:
        confidence = float(result.fit.outcome == "unchanged")
    row |= {"ratio": round(ratio, 4), "confidence": round(confidence, 4)}
    row |= {"flagged": result.trust.verdict == "doubtful", "moved": result.fit.outcome == "moved"}
    row |= {"left": result.trust.verdict == "doubtful" and not result.trust.moves}
    row |= {"iou_gain": round(result.fit.iou_after - result.fit.iou_before, 4)}
    # What moved as one has a confidence of its own.
    return row, {} if result.move.explains else result.trust.features


def _jobs(
    meshes: Path, split: Path | None, part: str, settings: Record, to_fit: bool = False
) -> dict[str, Callable[[], list[Row]]]:
    """By shape of a part, the function that refines its altered cases.

    The mask of another object is that of the shape before it in the list, the last for the first.
    """
    count, seed = settings["alterations"], settings["seed"]
    shapes = shapes_of_part(meshes, split, part, settings["categories"], settings["limit"])
    builder = CaseBuilder(meshes, split, settings["views"], SIZE, POINTS, seed)

    # The first kind of the shape before is needed again, if its job has just run.
    @lru_cache(maxsize=2)
    def first_kind(number: int) -> list[Case]:
        return builder.cases(shapes[number], KINDS[0])

    def refine_shape(number: int) -> list[Row]:
        shape, other = shapes[number], first_kind(number - 1)[0]
        cases = [*first_kind(number)]
        for kind in kinds_of(shape.category, KINDS[1:]):
            cases += builder.cases(shape, kind)
        drawn = (alterations(case, other, count, seed, to_fit) for case in cases)
        return rows_of(run for runs in drawn for run in runs)

    return {shape.name: partial(refine_shape, number) for number, shape in enumerate(shapes)}


def plan(
    progress: Progress, *, meshes: Path, split: Path | None, fit: Path | None, **settings: Any
) -> Plan:
    """Refine altered test shapes.

    With ``fit`` first fit the model to validation shapes, and write it there.
    """
    settings["categories"] = list(settings["categories"])
    if fit is not None:
        jobs: list[Callable[[], list[Row]]] = []
        for draw in range(DRAWS):
            drawn = settings | {"seed": settings["seed"] + draw}
            jobs += _jobs(meshes, split, "validation", drawn, to_fit=True).values()
        rows: list[Row] = []
        for number, job in enumerate(jobs, 1):
            rows += job()
            progress.report("fitting", number, len(jobs))
        with atomic_output(fit) as temporary:
            temporary.write_text(json.dumps(fitted(rows)))
    test = _jobs(meshes, split, "test", settings)
    return Plan(settings, [({"shape": name}, partial(_records, job)) for name, job in test.items()])


def _records(job: Callable[[], list[Row]]) -> Cases:
    return [record for record, _ in job()]


def fitted(rows: Sequence[Row]) -> Record:
    """The model of `tso_cli.diagnosis.confidence`: a logistic regression.

    Its logits are calibrated for `RIGHT_SHARE` of right scenes.
    """
    chosen = [(row, features) for row, features in rows if features and row["moved"]]
    names = max((list(features) for _, features in chosen), key=len)
    # Where the learned prior gave no answer, some features are not known.
    chosen = [(row, features) for row, features in chosen if len(features) == len(names)]
    values = np.array([[features[name] for name in names] for _, features in chosen])
    worse = np.array([float(row["ratio"] > WORSE) for row, _ in chosen])
    right = np.array([row["axis"] == UNALTERED.name for row, _ in chosen])
    weights = np.where(right, RIGHT_SHARE / right.sum(), (1.0 - RIGHT_SHARE) / (~right).sum())
    mean, deviation = values.mean(0), values.std(0)
    standard = np.clip((values - mean) / deviation, -MOST_DEVIATIONS, MOST_DEVIATIONS)
    *slopes, offset = _logistic(standard, worse, np.full(len(worse), 1.0 / len(worse)))
    logits = standard @ slopes + offset
    scale, shift = _logistic(logits[:, None], worse, weights)
    terms = np.stack([mean, deviation, scale * np.array(slopes)], 1).round(4).tolist()
    offset = round(float(scale * offset + shift), 4)
    return {"offset": offset, "features": dict(zip(names, terms, strict=True))}


def _logistic(
    values: NDArray[np.float64], worse: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The slope of each column of ``values`` [N, F], and the offset, by weighted cross-entropy."""
    from scipy.optimize import minimize

    columns = np.column_stack([values, np.ones(len(values))])

    def loss(slopes: NDArray[np.float64]) -> float:
        logits = columns @ slopes
        return float((weights * (np.logaddexp(0.0, logits) - worse * logits)).sum())

    slopes: NDArray[np.float64] = minimize(loss, np.zeros(columns.shape[1])).x
    return slopes


def auc(confidence: NDArray[np.float64], worse: NDArray[np.bool_]) -> float | None:
    """The chance that a worse result has less confidence than one that is not worse.

    Equal confidences count half. None where all results are worse, or none is.
    """
    from scipy.stats import rankdata

    count = int(worse.sum())
    if not 0 < count < len(worse):
        return None
    ranks = rankdata(-confidence)[worse].sum()
    return float((ranks - count * (count + 1) / 2) / (count * (len(worse) - count)))


def conclude(cases: Cases) -> Record:
    """AUC, and how many are flagged, by group of alterations; reliability; claims."""
    both = [case for case in cases if case["group"] in ("camera", "mask")]
    chosen = {"all": cases, "camera and mask": both, **grouped(cases, "group")}
    chosen["right scenes"] = [case for case in cases if case["axis"] == UNALTERED.name]
    summary = {name: _figures(rows) for name, rows in chosen.items() if refined(rows)}
    found = {"summary": summary, "mixture": _mixture(cases), "reliability": _reliability(cases)}
    return {**found, "claims": claims(summary)}


def claims(summary: Record) -> list[Record]:
    answers = []
    for name, least in LEAST_AUC.items():
        value = summary[name]["auc"] if name in summary else None
        if value is not None:
            text = f"AUC of {name} alterations is at least {least}"
            answers.append(claim(text, value >= least, f"{value:.3f}"))
    share = summary["right scenes"]["suspected"]
    answers.append(claim("no right scene has a finding", not share, f"share {share:.3f}"))
    words = {"suspected": "have a finding", "named": "are named"}
    for key, word in words.items() if "gross" in summary else ():
        share, text = summary["gross"][key], f"over {LEAST_NAMED} of gross mistakes {word}"
        answers.append(claim(text, share > LEAST_NAMED, f"{share:.3f}"))
    return answers


def _mixture(cases: Cases) -> Record:
    """Of a mixture with `RIGHT_SHARE` of right scenes: what leaving some clouds changes.

    always, left : mean logarithm of the ratio if the points always move, and if the clouds that tso
        leaves stay as they are. worse, unflagged : share that gets worse, and without a word.
    """
    right = np.array([case["axis"] == UNALTERED.name for case in cases])
    if not right.any() or right.all():
        return {}
    share = np.where(right, RIGHT_SHARE / right.sum(), (1.0 - RIGHT_SHARE) / (~right).sum())
    # What is refused stays as it is.
    ratio = np.array([max(case.get("ratio", 1.0), SMALLEST_RATIO) for case in cases])
    flagged, left = (
        np.array([case.get(key, True) for case in cases]) for key in ("flagged", "left")
    )
    worse = ratio > WORSE
    return {
        "always": float((share * np.log(ratio)).sum()),
        "left": float((share * np.log(ratio))[~left].sum()),
        "worse": float(share[worse].sum()),
        "unflagged": float(share[worse & ~flagged].sum()),
    }


def _reliability(cases: Cases) -> list[list[float]]:
    """By bin of confidence: number of results, mean confidence, share that is not worse."""
    rows = refined(cases)
    confidence = np.array([row["confidence"] for row in rows])
    worse = np.array([row["ratio"] for row in rows]) > WORSE
    bins = np.minimum((confidence * BINS).astype(int), BINS - 1)
    table = []
    for here in (bins == number for number in range(BINS)):
        if here.any():
            means = float(confidence[here].mean()), float(1.0 - worse[here].mean())
            table.append([int(here.sum()), *(round(value, 3) for value in means)])
    return table


def refined(cases: Cases) -> Cases:
    """The cases that were not refused."""
    return [case for case in cases if not case.get("refused")]


def _figures(cases: Cases) -> Record:
    rows = refined(cases)

    def column(key: str) -> NDArray[Any]:
        return np.array([row[key] for row in rows])

    worse, flagged = column("ratio") > WORSE, column("flagged")
    named = [case["named"] for case in cases if "named" in case]
    return {
        "results": len(rows),
        "worse": float(worse.mean()),
        "auc": auc(column("confidence"), worse),
        "auc_iou_gain": auc(column("iou_gain"), worse),
        "flagged": float(flagged.mean()),
        "flagged_of_worse": float(flagged[worse].mean()) if worse.any() else None,
        "refused": len(cases) - len(rows),
        "suspected": float(np.mean([case["suspected"] for case in cases])),
        "named": float(np.mean(named)) if named else None,
    }


def tables(record: Record) -> list[Table]:
    header = ["altered", "results", "worse", "AUC", "AUC of IoU gain", "flagged", "of the worse"]
    header += ["refused", "finding", "named"]
    rows = [[name, *row.values()] for name, row in record["summary"].items()]
    reliability = ["results", "confidence", "not worse"]
    mixture = [list(record["mixture"].values())] if record["mixture"] else []
    columns = ["log ratio, always moved", "as tso does", "worse", "worse, not flagged"]
    note = f"{RIGHT_SHARE:.0%} right scenes; mean logarithm of after / before, and shares"
    return [
        Table(header, rows),
        Table(columns, mixture, "Mixture", note),
        Table(reliability, record["reliability"], title="Reliability"),
    ]


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Reliability by bin of confidence, and the AUC by group of alterations."""
    reliability = {
        f"{stated:.2f}": {"confidence": stated, "not worse": true}
        for _, stated, true in record["reliability"]
    }
    areas = {
        name: {"confidence": row["auc"], "IoU gain": row["auc_iou_gain"]}
        for name, row in record["summary"].items()
    }
    panels = {"share that is not worse by over 5 %, by confidence": reliability, "AUC": areas}
    draw_bars(path, panels, overwrite)


STUDY = Study(
    name="confidence",
    about="Test shapes with a wrong mask, camera, cloud or picture, each altered in one way at a "
    "random level, refined with the default. A result with a confidence under "
    f"{LEAST_CONFIDENCE:g} is doubtful. The confidence was fitted to validation "
    "shapes (--fit).",
    parts=("points, best",),
    tables=tables,
    draw=draw,
    reading="A rising IoU says nothing. A cloud that is out of place and a camera that is out of "
    "place give the same picture, so no feature can separate them: moved clouds are called "
    "doubtful though they come out better, and moved cameras are sometimes believed.",
    convention=CONVENTION,
    options=(
        *options.COMMON,
        options.views(2),
        options.categories(*CATEGORIES),
        Option("--alterations", "Of each case.", int, 24, least=1),
        Option("--fit", f"Fit the model first and write it here; in use is {MODEL.name}.", Path),
    ),
    plan=plan,
    conclude=conclude,
)
