"""Does a low confidence show which results are worse than their start? And how it is fitted."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tso_cli.diagnosis.confidence import MODEL, MOST_DEVIATIONS
from tso_cli.diagnosis.trust import LEAST_CONFIDENCE, MOST_OF_DOUBTFUL
from tso_cli.errors import InputError, TsoError
from tso_cli.io.output import atomic_output
from tso_cli.refinement import RefineConfig, refine

from .. import options
from ..charts import Rows, bars
from ..harm.scenes import Gallery, Scene, gallery
from ..harm.study import BETTER, VIEWS, WORSE, altered, distance
from ..harm.troubles import TROUBLES, Trouble
from ..options import option
from ..study import Cases, Plan, Progress, Record, Study, Table, claim, uninterrupted
from .summary import grouped, rounded

Floats = NDArray[np.float64]
Row = tuple[Record, dict[str, float]]
"""What became of a scene, and the features of its result."""
JOBS = [(trouble, start) for trouble in TROUBLES for start in trouble.starts]

RIGHT = ("nothing wrong", "depth right")
"""With these, a start of another shape is a right scene."""
RIGHT_VIEWS, RIGHT_TIMES = (1, 2, 4), 17
"""Numbers of masks where nothing is wrong; so many of these scenes for one of another kind."""
SCENES, FITTED_SCENES = 6, 20
"""Of each trouble and start: those of the record, and those of the fit."""
ACCEPTING = RefineConfig(accept_doubtful=True)
# The confidence is meant for users of whom so many have right input.
RIGHT_SHARE = 0.5
PENALTIES, FOLDS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2), 5
"""Of squared slopes, of which the fit takes what predicts shapes best that it did not see."""
LIMITS = (0.5, 0.6, 0.7, 0.8, LEAST_CONFIDENCE, 0.9)
BINS = 10
REFUSED = {"ratio": 1.0, "confidence": 0.0, "moved": False, "finding": True, "flagged": True}
REFUSED |= {"left": True, "iou_gain": 0.0}
"""What is refused stays as it was."""
LEAST_AUC, MOST_WITHHELD = 0.85, 0.005


def is_right(row: Record) -> bool:
    """Whether a scene is one of a user without a trouble."""
    return row["trouble"] in RIGHT and row["start"] == "other"


def rows_of(scenes: Gallery, trouble: Trouble, start: str, count: int) -> Iterator[Row]:
    """The scenes of a trouble and start, refined; more of those in which nothing is wrong."""
    views: tuple[int, ...] = VIEWS
    if (trouble.name, start) == (RIGHT[0], "other"):
        count, views = count * RIGHT_TIMES, RIGHT_VIEWS
    for number in range(count):
        names, scene = altered(scenes, trouble, start, number, views[number % len(views)])
        yield row_of({**names, "group": trouble.group}, scene)


def row_of(names: Record, scene: Scene | InputError) -> Row:
    """What became of a scene, with the features of its result."""
    if isinstance(scene, InputError):
        return {**names, "refused": True}, {}
    try:
        result = uninterrupted(refine(scene.initial, scene.views, config=ACCEPTING))
    except TsoError as error:
        return row_of(names, InputError(str(uninterrupted(error))))
    trust, fit = result.trust, result.fit
    finding = any(item.suspicious for item in result.findings)
    doubtful = trust.verdict == "doubtful"
    # What stays as it was has no confidence under a finding.
    confidence = float(not doubtful) if trust.confidence is None else trust.confidence
    row = {
        "ratio": distance(result.points, scene) / distance(scene.initial, scene),
        "confidence": confidence,
        "moved": fit.outcome == "moved",
        "finding": finding,
        "flagged": doubtful or finding,
        "left": doubtful and not trust.moves,
        "iou_gain": fit.iou_after - fit.iou_before,
    }
    return {**names, **rounded(row)}, trust.features


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    part: str,
    unseen: Path | None,
    per: int,
    seed: int,
    fit: Path | None,
    fitted_scenes: int = FITTED_SCENES,
    jobs: Sequence[tuple[Trouble, str]] = JOBS,
) -> Plan:
    """Refine scenes of a part of the split.

    With ``fit`` first fit the model to scenes of the training shapes, and write it there.
    """
    if fit is not None:
        scenes, rows = gallery(meshes, split, "train", None, seed), list[Row]()
        for number, job in enumerate(jobs, 1):
            rows += rows_of(scenes, *job, fitted_scenes)
            progress.report("fitting", number, len(jobs))
        with atomic_output(fit) as temporary:
            temporary.write_text(json.dumps(fitted(rows)))
    scenes = gallery(meshes, split, part, unseen, seed)
    settings = {"part": part, "per": per, "seed": seed}
    settings["shapes"] = [shape.name for shape in scenes.shapes]

    def records(trouble: Trouble, start: str) -> Cases:
        return [record for record, _ in rows_of(scenes, trouble, start, per)]

    work = [({"trouble": job[0].name, "start": job[1]}, partial(records, *job)) for job in jobs]
    return Plan(settings, work)


# The fit.


def fitted(rows: Sequence[Row]) -> Record:
    """The model of `tso_cli.diagnosis.confidence`: a logistic regression of worse results.

    Right scenes weigh `RIGHT_SHARE` together.
    """
    chosen = [(row, features) for row, features in rows if features and row["moved"]]
    names = max((list(features) for _, features in chosen), key=len)
    # Where the learned prior gave no answer, some features are not known.
    chosen = [(row, features) for row, features in chosen if len(features) == len(names)]
    values = np.array([[features[name] for name in names] for _, features in chosen])
    worse = np.array([float(row["ratio"] > WORSE) for row, _ in chosen])
    weights = _weights([row for row, _ in chosen])
    mean, deviation = values.mean(0), values.std(0)
    deviation[deviation == 0.0] = 1.0
    standard = np.clip((values - mean) / deviation, -MOST_DEVIATIONS, MOST_DEVIATIONS)
    folds = np.unique([row["shape"] for row, _ in chosen], return_inverse=True)[1] % FOLDS

    def held_out(penalty: float) -> float:
        """The cross-entropy of each fold after a fit to the others, added."""
        loss = 0.0
        for here in (folds == fold for fold in range(FOLDS)):
            fit = _logistic(standard[~here], worse[~here], weights[~here], penalty)
            loss += _cross_entropy(fit, standard[here], worse[here], weights[here])
        return loss

    *slopes, offset = _logistic(standard, worse, weights, min(PENALTIES, key=held_out))
    terms = np.stack([mean, deviation, slopes], 1).round(4).tolist()
    features = dict(zip(names, terms, strict=True))
    return {"offset": round(float(offset), 4), "features": features}


def _weights(rows: Cases) -> Floats:
    """Of rows, 1 in all: those of right scenes have `RIGHT_SHARE` together."""
    right = np.array([is_right(row) for row in rows])
    shares = RIGHT_SHARE / max(right.sum(), 1), (1.0 - RIGHT_SHARE) / max((~right).sum(), 1)
    weights = np.where(right, *shares)
    return np.asarray(weights / weights.sum())


def _cross_entropy(slopes: Floats, values: Floats, worse: Floats, weights: Floats) -> float:
    logits = values @ slopes[:-1] + slopes[-1]
    return float((weights * (np.logaddexp(0.0, logits) - worse * logits)).sum())


def _logistic(values: Floats, worse: Floats, weights: Floats, penalty: float) -> Floats:
    """The slope of each column of ``values`` [N, F], and the offset, by weighted cross-entropy."""
    from scipy.optimize import minimize

    def loss(slopes: Floats) -> float:
        size = penalty * float(np.square(slopes[:-1]).sum())
        return _cross_entropy(slopes, values, worse, weights) + size

    slopes: Floats = minimize(loss, np.zeros(values.shape[1] + 1)).x
    return slopes


# What the cases mean.


def auc(confidence: Floats, worse: NDArray[np.bool_]) -> float | None:
    """The chance that a worse result has less confidence than one that is not worse.

    Equal confidences count half. None where all results are worse, or none is.
    """
    from scipy.stats import rankdata

    worse_count, other_count = int(worse.sum()), int((~worse).sum())
    if not worse_count * other_count:
        return None
    ranks = rankdata(-confidence)[worse].sum()
    return float((ranks - worse_count * (worse_count + 1) / 2) / (worse_count * other_count))


def conclude(cases: Cases) -> Record:
    """Figures by kind of scene and by trouble; what each limit changes; reliability; claims."""
    right, trouble = (
        [case for case in cases if is_right(case) is wanted] for wanted in (True, False)
    )
    chosen = {"all": cases, "right scenes": right, "in trouble": trouble}
    for start, rows in grouped(trouble, "start").items():
        chosen[f"in trouble, {start}"] = rows
    chosen |= {name: rows for name, rows in grouped(trouble, "group").items() if name != "none"}
    named = [{**case, "name": f"{case['trouble']}, {case['start']}"} for case in cases]
    summary, by_trouble = (
        {name: _figures(rows) for name, rows in groups.items() if _ended(rows)}
        for groups in (chosen, grouped(named, "name"))
    )
    area, withheld = summary["all"]["auc"] or 0.0, summary["right scenes"]["withheld"]
    text = f"at most {MOST_WITHHELD:.1%} of the right scenes are better and left as they were"
    claims = [claim(f"AUC is at least {LEAST_AUC}", area >= LEAST_AUC, f"{area:.3f}")]
    claims.append(claim(text, withheld <= MOST_WITHHELD, f"{withheld:.3f}"))
    of_cases: Record = {"limits": _limits(cases), "mixture": _mixture(cases)}
    of_cases |= {"reliability": _reliability(cases), "claims": claims}
    return {"summary": summary, "troubles": by_trouble, **of_cases}


def _ended(cases: Cases) -> Cases:
    return [case for case in cases if not case.get("refused")]


def _columns(cases: Cases) -> dict[str, NDArray[Any]]:
    """By name the values of all cases."""
    return {
        key: np.array([case.get(key, value) for case in cases]) for key, value in REFUSED.items()
    }


def _figures(cases: Cases) -> Record:
    """Shares of the results of some cases; the AUC is of those that moved."""
    rows = _ended(cases)
    of = _columns(rows)
    worse, moved, flagged = of["ratio"] > WORSE, of["moved"], of["flagged"]
    return {
        "results": len(rows),
        "moved": float(moved.mean()),
        "worse": float(worse.mean()),
        "auc": auc(of["confidence"][moved], worse[moved]),
        "auc_iou_gain": auc(of["iou_gain"][moved], worse[moved]),
        "flagged": float(flagged.mean()),
        "flagged_of_worse": float(flagged[worse].mean()) if worse.any() else None,
        "silent": float((worse & ~flagged & ~of["left"]).mean()),
        "withheld": float(((of["ratio"] < BETTER) & of["left"]).mean()),
        "refused": len(cases) - len(rows),
    }


def _limits(cases: Cases) -> list[list[float]]:
    """For each limit of the confidence: what it changes, as shares of cases.

    Of right scenes those below it and their gains; of those in trouble, with a start of another
    shape, what is worse and not below it, and the gains below it; the log ratio if what is below
    it stays as it was.
    """
    of, weights = _columns(cases), _weights(cases)
    right = np.array([is_right(case) for case in cases])
    trouble = ~right & np.array([case["start"] == "other" for case in cases])
    worse, better, log = of["ratio"] > WORSE, of["ratio"] < BETTER, np.log(of["ratio"])
    table = []
    for limit in LIMITS:
        below = (of["confidence"] < limit) | (of["finding"] & of["left"])
        silent, gains = worse & ~below & ~of["finding"], better & below
        means = [share.mean() for share in (below[right], gains[right], silent[trouble])]
        table.append([limit, *means, gains[trouble].mean(), (weights * log)[~below].sum()])
    return table


def _mixture(cases: Cases) -> Record:
    """The log ratio if all points move, and as tso leaves some; shares worse, and not flagged."""
    of, share = _columns(cases), _weights(cases)
    log, worse = share * np.log(of["ratio"]), share * (of["ratio"] > WORSE)
    shares = {"always": log, "left": log * ~of["left"]}
    shares |= {"worse": worse, "unflagged": worse * ~of["flagged"]}
    return {name: float(values.sum()) for name, values in shares.items()}


def _reliability(cases: Cases) -> list[list[float]]:
    """By bin of confidence: number that moved, mean confidence, share that is not worse."""
    of = _columns([case for case in cases if case.get("moved")])
    confidence, worse = of["confidence"], of["ratio"] > WORSE
    bins = np.minimum((confidence * BINS).astype(int), BINS - 1)
    return [
        [int(here.sum()), confidence[here].mean(), 1.0 - worse[here].mean()]
        for here in (bins == number for number in np.unique(bins))
    ]


def tables(record: Record) -> list[Table]:
    header = ["results", "moved", "worse", "AUC", "AUC of IoU gain", "flagged", "of the worse"]
    header += ["silent", "withheld", "refused"]
    rows, troubles = (
        [[name, *row.values()] for name, row in record[key].items()]
        for key in ("summary", "troubles")
    )
    columns = ["log ratio, always moved", "as tso does", "worse", "worse, not flagged"]
    limits = ["limit", "right below", "right, better below", "in trouble, worse not below"]
    limits += ["in trouble, better below", "log ratio if below stays"]
    about = "In trouble: other starts."
    return [
        Table(["scenes", *header], rows),
        Table(limits, record["limits"], "Limits of the confidence", about),
        Table(columns, [list(record["mixture"].values())], "Mixture"),
        Table(["moved", "confidence", "not worse"], record["reliability"], "Reliability"),
        Table(["trouble, start", *header], troubles, "By trouble"),
    ]


def panels(record: Record) -> Rows:
    """Reliability by bin of confidence, and the AUC by kind of scene."""
    reliability = {
        f"{stated:.2f}": {"confidence": stated, "not worse": true}
        for _, stated, true in record["reliability"]
    }
    areas = {
        name: {"confidence": row["auc"], "IoU gain": row["auc_iou_gain"]}
        for name, row in record["summary"].items()
    }
    return {"share that is not worse by over 5 %, by confidence": reliability, "AUC": areas}


STUDY = Study(
    name="confidence",
    values={
        "WORSE": WORSE,
        "BETTER": BETTER,
        "RIGHT_SHARE": RIGHT_SHARE,
        "LEAST_CONFIDENCE": LEAST_CONFIDENCE,
        "MOST_OF_DOUBTFUL": MOST_OF_DOUBTFUL,
    },
    parts=("points, best",),
    tables=tables,
    draw=bars(panels),
    options=(
        options.MESHES,
        options.SPLIT,
        options.part("validation"),
        options.UNSEEN,
        option("--per", "Scenes for each trouble and start.", int, SCENES, least=1),
        options.SEED,
        option("--fit", f"Fit the model first and write it here; in use is {MODEL.name}.", Path),
    ),
    plan=plan,
    conclude=conclude,
)
