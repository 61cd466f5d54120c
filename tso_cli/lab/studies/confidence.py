"""Does the confidence of a result tell which results are worse than their start? And how it is fitted."""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...diagnosis.agreement import NAMED
from ...diagnosis.confidence import LEAST_CONFIDENCE, MODEL
from ...io.output import atomic_output
from ...kernels.dispatch import planned
from ...plots.style import COLOURS, INK, page
from ...refinement import RefineConfig
from ..stability.axes import AXES, Axis
from ..stability.runs import Run, outcomes_of
from ..study import (
    CATEGORY,
    COMMON,
    VIEWS,
    Cases,
    Option,
    Plan,
    Progress,
    Record,
    Study,
    Table,
    claim,
)
from .cases import Case, CaseBuilder, kinds_of
from .refining import Variant
from .shapes import shapes_of_part
from .summary import grouped

CATEGORIES, KINDS = ("chair", "airplane", "car", "sofa", "table"), ("other", "near", "right")
SIZE, POINTS = 128, 1024
"""Pixels of the masks each way, points of the clouds."""
# How many masks there are is drawn besides.
RIGHT, ALTERED = (
    AXES[0],
    tuple(axis for axis in AXES if axis.group != "settings" and axis.masks <= 2),
)
MOST = {"many points": 16384, "large picture": 2048}
"""Levels beyond which only the time changes."""
MASKS = (1, 1, 1, 1, 1, 2, 4)
"""Drawn from."""
DRAWS = 2
"""How often alterations are drawn for the fit, each time with other views."""
LEARNED = {"floor under the object": (20.0, 50.0, 100.0)}
"""Levels of an axis that are added to every case of the fit: drawn at random they are too rare to be learned."""
WHOLE = Variant(RefineConfig(accept_doubtful=True))
MANY = 1 << 60
"""Work that compiled loops pay for."""
WORSE = 1.05
HIDDEN, NETWORKS, EPOCHS, BATCH, RATE, DECAY = 128, 2, 100, 128, 1e-2, 0.05
"""Of the model: tanh units of a network, networks that it is the mean of, and how they are trained."""
BINS = 10
AIMS, LEAST_NAMED = {"all": 0.93, "camera and mask": 0.85}, 0.9
CONVENTION = {
    "worse": "Chamfer distance of the cloud's own points to the truth over 1.05 times that before",
    "AUC": "chance that a worse result has less confidence than one that is not",
    "right scenes": "as rendered, nothing altered; a start that is another shape is no mistake",
    "flagged": "doubtful, for want of confidence or for a suspected mistake",
    "mistake suspected": "of the result, or in the refusal; any, also another than was made",
    "named": "the gross mistake that was made is among those suspected",
    "gross": "mistakes of convention, as axes, units, transposed or inverted input; not in the other groups",
}


def alterations(
    case: Case, other: Case, count: int, seed: int, to_fit: bool = False
) -> Iterator[Run]:
    """A case as it is, and with ``count`` alterations, each at a random level; ``to_fit`` adds those of `LEARNED`.

    ``other`` has the mask of another object.
    """
    rng = np.random.default_rng(
        [seed, zlib.crc32(case.shape.encode()), zlib.crc32(case.kind.encode()), case.view]
    )
    for axis in (RIGHT, *rng.choice(np.array(ALTERED, dtype=object), count)):
        level = float(
            rng.choice([level for level in axis.levels if level <= MOST.get(axis.name, np.inf)])
        )
        yield _run(axis, level, case, other, rng)
    for axis in (axis for axis in ALTERED if to_fit and axis.name in LEARNED):
        yield from (_run(axis, level, case, other, rng) for level in LEARNED[axis.name])


def _run(axis: Axis, level: float, case: Case, other: Case, rng: np.random.Generator) -> Run:
    masks = int(rng.choice(MASKS))
    return Run(axis, level, case, other, np.random.default_rng(rng.integers(1 << 32)), masks)


def rows_of(runs: Iterable[Run]) -> list[tuple[Record, dict[str, float]]]:
    """Row and signs of the result of each run; what is no number is left out. Of a refusal, whether it names a mistake."""
    rows: list[tuple[Record, dict[str, float]]] = []
    with planned(MANY, MANY):
        for outcome in outcomes_of(runs, WHOLE):
            run, result, ratio = outcome.run, outcome.result, outcome.ratio()
            row: Record = {
                **{key: getattr(run.case, key) for key in ("category", "shape", "kind")},
                **{
                    "axis": run.axis.name,
                    "group": "gross" if run.axis.gross else run.axis.group,
                    "level": run.level,
                },
            }
            mistake = run.axis.mistake(run.level)
            if mistake:
                said = outcome.refusal if result is None else str(result.suspects)
                row["named"] = re.search(rf"--assume {mistake}\b(?!-)", said) is not None
            if result is None:
                rows.append((row | {"refused": True, "suspected": NAMED in outcome.refusal}, {}))
            elif ratio is not None:
                row |= {
                    **{"ratio": round(ratio, 4), "confidence": round(result.confidence or 0.0, 4)},
                    **{"flagged": result.verdict == "doubtful", "suspected": bool(result.suspects)},
                    **{
                        "iou_gain": round(result.iou_after - result.iou_before, 4),
                        "moved": result.best_step > 0,
                    },
                }
                rows.append((row, result.signs))
    return rows


def _jobs(
    meshes: Path, split: Path | None, part: str, settings: Record, to_fit: bool = False
) -> dict[str, Callable[[], list[Any]]]:
    """By shape of a part, what refines its cases."""
    shapes = shapes_of_part(meshes, split, part, settings["categories"], settings["limit"])
    builder = CaseBuilder(meshes, split, settings["views"], SIZE, POINTS, settings["seed"])
    before: list[Case] = []

    def refine_shape(number: int) -> list[Any]:
        shape, other = shapes[number], shapes[number - 1]
        before[:] = before or builder.cases(other, KINDS[0])
        cases = [
            case for kind in kinds_of(shape.category, KINDS) for case in builder.cases(shape, kind)
        ]
        drawn = (
            alterations(case, before[0], settings["alterations"], settings["seed"], to_fit)
            for case in cases
        )
        rows = rows_of(run for runs in drawn for run in runs)
        before[:] = cases
        return rows

    return {shape.name: partial(refine_shape, number) for number, shape in enumerate(shapes)}


def plan(
    progress: Progress, *, meshes: Path, split: Path | None, fit: Path | None, **settings: Any
) -> Plan:
    """Judge altered test shapes; with ``fit`` first fit the model to training and validation shapes, and write it there."""
    settings["categories"] = list(settings["categories"] or CATEGORIES)
    if fit is not None:
        rows: list[tuple[Record, dict[str, float]]] = []
        jobs: list[Callable[[], list[Any]]] = []
        for draw in range(DRAWS):
            drawn = settings | {"seed": settings["seed"] + draw}
            for part in ("train", "validation"):
                jobs += _jobs(meshes, split, part, drawn, to_fit=True).values()
        for number, job in enumerate(jobs, 1):
            rows += job()
            progress.report("fitting", number, len(jobs))
        with atomic_output(fit) as temporary:
            temporary.write_text(json.dumps(fitted(rows)))
    test = _jobs(meshes, split, "test", settings)
    work = [({"shape": name}, partial(_rows, job)) for name, job in test.items()]
    return Plan(settings, work)


def _rows(job: Callable[[], list[tuple[Record, dict[str, float]]]]) -> list[Record]:
    return [row for row, _ in job()]


def fitted(rows: Sequence[tuple[Record, dict[str, float]]], seed: int = 0) -> Record:
    """The model of `tso_cli.diagnosis.confidence` from rows and signs: the mean of small networks, by cross-entropy."""
    import torch

    chosen = [(row["ratio"] > WORSE, signs) for row, signs in rows if signs and row["moved"]]
    names = list(chosen[0][1])
    values = np.array([[signs[name] for name in names] for _, signs in chosen])
    worse = torch.tensor([float(is_worse) for is_worse, _ in chosen])
    mean, deviation = values.mean(0), values.std(0) + 1e-6
    standard = torch.tensor(np.clip((values - mean) / deviation, -4.0, 4.0), dtype=torch.float32)
    layers = []
    for network in range(NETWORKS):
        torch.manual_seed(seed + network)
        hidden, output = torch.nn.Linear(len(names), HIDDEN), torch.nn.Linear(HIDDEN, 1)
        adam = torch.optim.AdamW(
            [*hidden.parameters(), *output.parameters()], RATE, weight_decay=DECAY
        )
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, EPOCHS)
        for _ in range(EPOCHS):
            for batch in torch.randperm(len(worse)).split(BATCH):
                doubt = output(torch.tanh(hidden(standard[batch])))[:, 0]
                loss = torch.nn.functional.binary_cross_entropy_with_logits(doubt, worse[batch])
                adam.zero_grad()
                loss.backward()
                adam.step()
            schedule.step()
        layers.append(
            [
                part.detach().numpy()
                for part in (hidden.weight.T, hidden.bias, output.weight[0], output.bias)
            ]
        )
    weights, offsets, outputs, biases = zip(*layers, strict=True)
    model = {
        "mean": mean,
        "deviation": deviation,
        "hidden": np.concatenate(weights, 1),
        "offset": np.concatenate(offsets),
        "output": np.append(np.concatenate(outputs) / NETWORKS, np.mean(biases)),
    }
    return {
        "signs": names,
        **{key: np.round(numbers.astype(float), 4).tolist() for key, numbers in model.items()},
    }


def auc(confidence: NDArray[np.float64], worse: NDArray[np.bool_]) -> float | None:
    """The chance that a worse result has less confidence than one that is not, equal ones counting half; None of one sort."""
    from scipy.stats import rankdata

    count = int(worse.sum())
    if not 0 < count < len(worse):
        return None
    return float(
        (rankdata(-confidence)[worse].sum() - count * (count + 1) / 2)
        / (count * (len(worse) - count))
    )


def conclude(cases: Cases) -> Record:
    """AUC, and who is flagged, by group of alterations."""
    chosen = {
        "all": cases,
        "camera and mask": [case for case in cases if case["group"] in ("camera", "mask")],
    }
    chosen |= grouped(cases, "group") | {
        f"{name}, any": rows for name, rows in grouped(cases, "category").items()
    }
    chosen["right scenes"] = [case for case in cases if case["axis"] == RIGHT.name]
    summary = {name: _figures(rows) for name, rows in chosen.items() if refined(rows)}
    confidence, worse = (
        np.array([case[key] for case in refined(cases)]) for key in ("confidence", "ratio")
    )
    worse = worse > WORSE
    bins = np.minimum((confidence * BINS).astype(int), BINS - 1)
    reliability = [
        [
            int(here.sum()),
            *(
                [
                    round(float(confidence[here].mean()), 3),
                    round(float(1.0 - worse[here].mean()), 3),
                ]
            ),
        ]
        for here in (bins == number for number in range(BINS))
        if here.any()
    ]
    claims = [
        claim(
            f"AUC of {name} alterations is at least {least}",
            found["auc"] >= least,
            f"{found['auc']:.3f}",
        )
        for name, least in AIMS.items()
        if (found := summary.get(name)) and found["auc"] is not None
    ]
    suspected = summary["right scenes"]["suspected"]
    claims.append(
        claim(
            "no right scene is suspected of a mistake",
            not suspected,
            f"share suspected {suspected:.3f}",
        )
    )
    if gross := summary.get("gross"):
        for key in ("suspected", "named"):
            claims.append(
                claim(
                    f"over {LEAST_NAMED} of gross mistakes are {key}",
                    gross[key] > LEAST_NAMED,
                    f"{gross[key]:.3f}",
                )
            )
    return {"summary": summary, "reliability": reliability, "claims": claims}


def refined(cases: Cases) -> Cases:
    """Those that were not refused."""
    return [case for case in cases if not case.get("refused")]


def _figures(cases: Cases) -> Record:
    rows = refined(cases)
    confidence, ratio = (
        np.array([row[key] for row in rows], dtype=float) for key in ("confidence", "ratio")
    )
    worse, flagged = ratio > WORSE, np.array([row["flagged"] for row in rows])
    iou = auc(np.array([row["iou_gain"] for row in rows]), worse)
    return {
        "results": len(rows),
        "worse": float(worse.mean()),
        "auc": auc(confidence, worse),
        "auc_iou_gain": iou,
        "flagged": float(flagged.mean()),
        "flagged_of_worse": float(flagged[worse].mean()) if worse.any() else None,
        "refused": len(cases) - len(rows),
        "suspected": float(np.mean([case["suspected"] for case in cases])),
        "named": float(np.mean(named))
        if (named := [case["named"] for case in cases if "named" in case])
        else None,
    }


def tables(record: Record) -> list[Table]:
    header = ["altered", "results", "worse", "AUC", "AUC of IoU gain", "flagged", "of the worse"]
    header += ["refused", "mistake suspected", "named"]
    return [
        Table(header, [[name, *row.values()] for name, row in record["summary"].items()]),
        Table(["results", "confidence", "not worse"], record["reliability"], title="Reliability"),
    ]


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Confidence and what came of it; and how many of the worse are flagged for how many of the others."""
    with page(path, overwrite, (9.0, 3.8), dpi=100) as figure:
        left, right = figure.subplots(1, 2)
        _, said, true = np.array(record["reliability"]).T
        left.plot([0, 1], [0, 1], color=INK, linewidth=0.8)
        left.plot(said, true, "o-", color=COLOURS[0])
        left.set(
            xlabel="confidence",
            ylabel="share that is not worse by over 5 %",
            xlim=(0, 1),
            ylim=(0, 1),
        )
        groups = {
            "all alterations": None,
            "camera": "camera",
            "mask": "mask",
            "gross mistakes": "gross",
        }
        for (label, group), colour in zip(groups.items(), COLOURS, strict=False):
            rows = [case for case in refined(record["cases"]) if group in (None, case["group"])]
            order = np.argsort([row["confidence"] for row in rows], kind="stable")
            worse = np.array([row["ratio"] > WORSE for row in rows])[order]
            if 0 < worse.sum() < len(worse):
                right.plot(
                    np.cumsum(~worse) / (~worse).sum(),
                    np.cumsum(worse) / worse.sum(),
                    color=colour,
                    label=label,
                )
        right.set(
            xlabel="share of the others flagged",
            ylabel="share of the worse flagged",
            xlim=(0, 1),
            ylim=(0, 1),
        )
        right.legend(frameon=False, fontsize=8, loc="lower right")


STUDY = Study(
    name="confidence",
    about="Test shapes with a wrong mask, camera, cloud or picture, each altered in one way at a random level, refined with "
    f"the default. A result of confidence under {LEAST_CONFIDENCE:g} is doubtful. It was fitted to training and validation "
    "shapes (--fit).",
    parts=("points, best",),
    tables=tables,
    draw=draw,
    reading="A rising IoU says nothing. A cloud beside its place and a camera beside its place are one and the same picture, "
    "so no sign can tell them apart: moved clouds are doubted though they come out better, and moved cameras are sometimes "
    "believed.",
    convention=CONVENTION,
    options=(
        *COMMON,
        VIEWS,
        replace(CATEGORY, help="May be repeated.  [default: 5]"),
        Option("--alterations", "Of each case.", int, 24, least=1),
        Option(
            "--fit",
            f"Fit the model first and write it here; the one in use is {MODEL.name} in refinement/.",
            Path,
        ),
    ),
    plan=plan,
    conclude=conclude,
)
