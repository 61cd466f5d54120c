"""`tso bench pareto`: seconds against accuracy, for every variant, swept over what a user can choose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ...errors import InputError
from ...evaluation.metrics import chamfer
from ...geometry.points import Array
from ...io.shipped import default_checkpoint, examples_folder
from ...network.model import BaseNetwork
from ...refinement.api import compile_loops
from ..stability.peers import PEERS
from ..studies.accuracy import CATEGORIES
from ..studies.cases import Case, CaseBuilder, kinds_of
from ..studies.shapes import Shape, shapes_of_part, view_aligned_network, weights_hash
from ..studies.summary import grouped, ratio_figures, rounded, standard_error
from ..study import (
    DEVICE,
    LIMIT,
    SEED,
    SPLIT,
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
from .pareto_chart import draw
from .speed import machine
from .timing import timed
from .ways import DEFAULT, PAPER, PREDICTION, PUBLISHED, PUBLISHED_SECONDS, STARTS, WAYS, Way

SHIPPED_SPLIT = Path(__file__).with_name("shipped_split.json")
CONVENTION = {
    "ratio": "Chamfer distance after / before, mean of the cases' own; squared distances, mean over points, both directions "
    "added, longest side 1, to as many target points",
    "standard error": "of the mean over shapes; views of one shape are averaged first",
    "seconds": "one call alone, after a warm-up, one thread, compiled loops (as for many objects in a process), without files; "
    "median over the cases",
    "front": "ways with one mask of which no other takes no longer and comes as near",
    "published": "the paper's figures, 3 to 6 % nearer in about a second, on its authors' data and machine",
    "plain settings": "1,024 points, one mask of 64x64 (of predictions the 64x64 crop that the network sees)",
}


def plan(
    progress: Progress, *, quick: bool, meshes: Path | None, split: Path | None, **settings: Any
) -> Plan:
    """Refine every case in every way, one call after the other; a job is a shape, so that a busy while slows all ways alike.

    Raises InputError without ``meshes``, unless ``quick``.
    """
    if quick:
        meshes, split = examples_folder() / "meshes", SHIPPED_SPLIT
        settings |= {"part": "test", "categories": (), "views": 1}
    if meshes is None:
        raise InputError(
            "--meshes is missing, expected a folder of meshes (or --quick, for the shipped examples)"
        )
    shapes = shapes_of_part(
        meshes, split, settings["part"], settings["categories"], settings["limit"]
    )
    network, about = view_aligned_network(default_checkpoint())
    builder = CaseBuilder(
        meshes, split, settings["views"], 64, 1024, settings["seed"], network, about
    )
    settings |= {"quick": quick, "categories": sorted({shape.category for shape in shapes})}
    settings |= {
        "shapes": [shape.name for shape in shapes],
        "ways": list(WAYS),
        "machine": machine(),
    }
    settings["network"] = weights_hash(network)
    compile_loops()
    warm = set[str]()

    @threadpool_limits.wrap(limits=1)
    def judge(shape: Shape) -> Cases:
        cases = []
        for kind in kinds_of(shape.category, tuple(STARTS)):
            ways = {name: way for name, way in WAYS.items() if kind in way.kinds}
            sizes = {(way.points, way.size) for way in ways.values()}
            built = {
                of: replace(builder, points=of[0], size=of[1]).cases(shape, kind) for of in sizes
            }
            for view in range(settings["views"]):
                rows = {}
                for name, way in ways.items():
                    case = built[way.points, way.size][view]
                    for _ in range(1 if name in warm else 2):
                        rows[name] = _judged(case, way, settings["device"], network)
                    warm.add(name)
                cases.append(
                    {
                        "kind": kind,
                        "category": shape.category,
                        "shape": shape.name,
                        "view": view,
                        "ways": rows,
                    }
                )
        return cases

    return Plan(settings, [({"shape": shape.name}, partial(judge, shape)) for shape in shapes])


def _judged(case: Case, way: Way, device: str, network: BaseNetwork | None) -> Record:
    results: list[Array] = []
    seconds = timed(lambda: results.append(way.refined(case, device, network)), "compiled")()
    before, after = (chamfer(points, case.target).chamfer for points in (case.initial, results[0]))
    return rounded({"ratio": after / before, "seconds": seconds})


def front(places: Sequence[tuple[float, float]]) -> list[int]:
    """The Pareto front: which of the (seconds, ratio) no other beats in one of the two and equals or beats in the other.

    They are in the order of the seconds; of equal ones all are there.
    """
    best, last, chosen = float("inf"), (float("nan"), float("nan")), []
    for number in sorted(range(len(places)), key=lambda i: places[i]):
        if places[number][1] < best or places[number] == last:
            chosen.append(number)
            best, last = places[number][1], places[number]
    return chosen


def conclude(cases: Cases) -> Record:
    """{"summary": {kind: {"cases", "shapes", "ways": {way: {...}}, "front": [way, ...]}}, "claims"}."""
    summary = {kind: _summary(of_kind) for kind, of_kind in grouped(cases, "kind").items()}
    return {"summary": summary, "claims": [*_claims(summary)]}


def _summary(cases: Cases) -> Record:
    by_shape = grouped(cases, "shape").values()
    ways = {}
    for name in cases[0]["ways"]:
        of_shapes = [
            np.mean([case["ways"][name]["ratio"] for case in of_shape]) for of_shape in by_shape
        ]
        seconds = float(np.median([case["ways"][name]["seconds"] for case in cases]))
        figures = ratio_figures(np.array([case["ways"][name]["ratio"] for case in cases]))
        ways[name] = rounded(
            {**figures, "standard_error": standard_error(of_shapes), "median_seconds": seconds}
        )
    alike = [name for name in ways if WAYS[name].masks == 1]
    chosen = [
        alike[i]
        for i in front([(ways[name]["median_seconds"], ways[name]["mean_ratio"]) for name in alike])
    ]
    return {"cases": len(cases), "shapes": len(by_shape), "ways": ways, "front": chosen}


def _claims(summary: Record) -> Iterator[Record]:
    for kind, group in summary.items():
        ours = group["ways"][DEFAULT]
        text = f"{ours['mean_ratio']:.3f} in {ours['median_seconds']:.2f} s; the front: {'; '.join(group['front'])}"
        yield claim(f"{STARTS[kind]}: the default is on the front", DEFAULT in group["front"], text)
        nearest = min((PAPER, *PEERS), key=lambda name: group["ways"][name]["mean_ratio"])
        theirs = group["ways"][nearest]
        text = f"{ours['mean_ratio']:.3f}; {nearest} {theirs['mean_ratio']:.3f} in {theirs['median_seconds']:.2f} s"
        holds = (
            ours["mean_ratio"] + ours["standard_error"]
            < theirs["mean_ratio"] - theirs["standard_error"]
        )
        yield claim(
            f"{STARTS[kind]}: the default is nearer than the paper's preset and other ways, beyond the errors",
            holds,
            text,
        )
    if PREDICTION in summary:
        ours = summary[PREDICTION]["ways"][DEFAULT]
        holds = ours["mean_ratio"] <= min(PUBLISHED) and ours["median_seconds"] <= PUBLISHED_SECONDS
        text = f"{ours['mean_ratio']:.3f} in {ours['median_seconds']:.2f} s"
        yield claim("predictions: nearer than the paper reports, and as quick", holds, text)


def tables(record: Record) -> list[Table]:
    """A table for each start, the quickest way first."""
    found = []
    for kind, group in record["summary"].items():
        rows = [
            [
                name,
                row["median_seconds"],
                row["mean_ratio"],
                row["standard_error"],
                row["worst_ratio"],
                row["worse"],
            ]
            + ["yes" if name in group["front"] else ""]
            for name, row in sorted(
                group["ways"].items(), key=lambda item: item[1]["median_seconds"]
            )
        ]
        header = ["way", "s", "ratio", "standard error", "worst", "worse", "front"]
        found.append(
            Table(
                header, rows, f"{STARTS[kind]}: {group['cases']} cases of {group['shapes']} shapes"
            )
        )
    of = record["settings"]["machine"]
    found.append(
        Table(
            ["measured on"],
            [[f"{of['cpu']}, {of['cores']} cores, device {record['settings']['device']}"]],
        )
    )
    return found


STUDY = Study(
    name="pareto",
    parts=(
        "pictures",
        "points, paper",
        "points, best",
        "network modes, paper",
        "network modes, best",
    ),
    tables=tables,
    draw=draw,
    reading="Down is nearer to the truth, left is quicker: what lies above and to the right of another point is not worth its "
    "time. The front is of ways that see one mask, since further masks are not a setting but more input; they bring more than "
    "any setting. Modes of the network start from its prediction, so that the two panels are not to be mixed.",
    convention=CONVENTION,
    options=(
        Option("--quick", "The shipped examples, one view.", bool, False),
        Option(
            "--meshes",
            "Folder with CATEGORY/NAME for every name of the split; not with --quick.",
            Path,
        ),
        SPLIT,
        part("test"),
        Option(
            "--category", "May be repeated.", default=CATEGORIES, multiple=True, name="categories"
        ),
        LIMIT,
        replace(VIEWS, default=1),
        SEED,
        DEVICE,
    ),
    plan=plan,
    conclude=conclude,
)
