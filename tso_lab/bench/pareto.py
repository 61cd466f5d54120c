"""`tso lab pareto`: accuracy against seconds, swept over what a user can choose."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.points import Array
from tso_cli.io.shipped import default_checkpoint
from tso_cli.network.model import BaseNetwork

from .. import options
from ..studies.accuracy import CATEGORIES
from ..studies.cases import Case, CaseBuilder, kinds_of
from ..studies.shapes import Shape, shapes_of_part, view_aligned_network, weights_hash
from ..studies.summary import grouped, ratio_figures, rounded, standard_error
from ..study import Cases, Plan, Progress, Record, Study, Table, claim
from .pareto_chart import draw
from .peers import PEERS
from .speed import machine
from .timing import timed
from .ways import (
    DEFAULT,
    PAPER,
    PREDICTION,
    PUBLISHED,
    PUBLISHED_SECONDS,
    STARTS,
    WAYS,
    Way,
)

CONVENTION = {
    "ratio": "Chamfer distance after / before, mean of the cases' ratios; squared distances, mean "
    "over points, both directions added, longest side 1, to as many target points",
    "standard error": "of the mean over shapes",
    "seconds": "one call alone, after a warm-up, one thread (as for many objects "
    "in a process), without files; median over the cases",
    "front": "a way with one mask is on it if no other takes no longer and comes as near",
    "published": "the paper's figures, 3 to 6 % nearer in about a second, on its authors' data and "
    "machine",
    "plain settings": "1,024 points, one mask of 64x64 (of predictions the 64x64 crop that the "
    "network sees)",
}


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    limit: int | None,
    seed: int,
    categories: Sequence[str] = CATEGORIES,
    ways: Mapping[str, Way] = WAYS,
) -> Plan:
    """Refine every case in every way, one call after the other.

    A job is one shape, so that a busy time slows all ways alike.
    """
    shapes = shapes_of_part(meshes, split, "test", categories, limit)
    network, about = view_aligned_network(default_checkpoint())
    builder = CaseBuilder(meshes, split, 1, 64, 1024, seed, network, about)
    settings: Record = {"limit": limit, "seed": seed, "machine": machine()}
    settings |= {"shapes": [shape.name for shape in shapes], "ways": list(ways)}
    settings |= {"network": weights_hash(network)}
    warm = set[str]()

    @threadpool_limits.wrap(limits=1)
    def measure(shape: Shape) -> Cases:
        cases = []
        for kind in kinds_of(shape.category, tuple(STARTS)):
            of_kind = {name: way for name, way in ways.items() if kind in way.kinds}
            scales = {(way.points, way.size) for way in of_kind.values()}
            built = {
                (points, size): replace(builder, points=points, size=size).cases(shape, kind)[0]
                for points, size in scales
            }
            rows = {}
            for name, way in of_kind.items():
                for _ in range(1 if name in warm else 2):
                    rows[name] = _timed(built[way.points, way.size], way, network)
                warm.add(name)
            names = {"kind": kind, "category": shape.category, "shape": shape.name}
            cases.append({**names, "ways": rows})
        return cases

    return Plan(settings, [({"shape": shape.name}, partial(measure, shape)) for shape in shapes])


def _timed(case: Case, way: Way, network: BaseNetwork | None) -> Record:
    results: list[Array] = []
    seconds = timed(lambda: results.append(way.refined(case, network)))()
    before, after = (chamfer(points, case.target).chamfer for points in (case.initial, results[0]))
    return rounded({"ratio": after / before, "seconds": seconds})


def front(places: Sequence[tuple[float, float]]) -> list[int]:
    """The Pareto front of (seconds, ratio), in the order of the seconds; of equal ones all.

    No other place is less in one of the two and at most equal in the other.
    """
    best, last, chosen = float("inf"), (float("nan"), float("nan")), []
    for number in sorted(range(len(places)), key=lambda i: places[i]):
        if places[number][1] < best or places[number] == last:
            chosen.append(number)
            best, last = places[number][1], places[number]
    return chosen


def conclude(cases: Cases) -> Record:
    """{"summary": {kind: {"cases", "ways": {way: {...}}, "front": [...]}}, "claims"}."""
    summary = {kind: _summary(of_kind) for kind, of_kind in grouped(cases, "kind").items()}
    return {"summary": summary, "claims": [*_claims(summary)]}


def _summary(cases: Cases) -> Record:
    ways = {}
    for name in cases[0]["ways"]:
        rows = [case["ways"][name] for case in cases]
        ratios = np.array([row["ratio"] for row in rows])
        figures = {**ratio_figures(ratios), "standard_error": standard_error(ratios)}
        figures |= {"median_seconds": float(np.median([row["seconds"] for row in rows]))}
        ways[name] = rounded(figures)
    one_mask = [name for name in ways if WAYS[name].masks == 1]
    places = [(ways[name]["median_seconds"], ways[name]["mean_ratio"]) for name in one_mask]
    chosen = [one_mask[i] for i in front(places)]
    return {"cases": len(cases), "ways": ways, "front": chosen}


def _claims(summary: Record) -> Iterator[Record]:
    for kind, group in summary.items():
        ways, start = group["ways"], STARTS[kind]
        ours = ways[DEFAULT]
        ratio, seconds = ours["mean_ratio"], ours["median_seconds"]
        text = f"{ratio:.3f} in {seconds:.2f} s; the front: {'; '.join(group['front'])}"
        yield claim(f"{start}: the default is on the front", DEFAULT in group["front"], text)
        nearest = min((PAPER, *PEERS), key=lambda name: ways[name]["mean_ratio"])
        other = ways[nearest]
        text = (
            f"{ratio:.3f}; {nearest} {other['mean_ratio']:.3f} in {other['median_seconds']:.2f} s"
        )
        highest = ratio + ours["standard_error"]
        holds = highest < other["mean_ratio"] - other["standard_error"]
        what = "the default is nearer than the paper's preset and other ways, beyond the errors"
        yield claim(f"{start}: {what}", holds, text)
        if kind == PREDICTION:
            text = "predictions: nearer than the paper reports, and as quick"
            holds = ratio <= min(PUBLISHED) and seconds <= PUBLISHED_SECONDS
            yield claim(text, holds, f"{ratio:.3f} in {seconds:.2f} s")


COLUMNS = {
    "median_seconds": "s",
    "mean_ratio": "ratio",
    "standard_error": "standard error",
    "worst_ratio": "worst",
    "worse": "worse",
}


def tables(record: Record) -> list[Table]:
    """A table for each start, the quickest way first."""
    found = []
    for kind, group in record["summary"].items():
        ordered = sorted(group["ways"].items(), key=lambda item: item[1]["median_seconds"])
        rows = [
            [name, *map(row.get, COLUMNS), "yes" if name in group["front"] else ""]
            for name, row in ordered
        ]
        title = f"{STARTS[kind]}: {group['cases']} shapes"
        found.append(Table(["way", *COLUMNS.values(), "front"], rows, title))
    of = record["settings"]["machine"]
    found.append(Table(["measured on"], [[f"{of['cpu']}, {of['cores']} cores"]]))
    return found


STUDY = Study(
    name="pareto",
    about="Every mode and preset, swept over steps, points, pixels and masks, and other "
    "ways to compare points with a mask.",
    parts=(
        "pictures",
        "points, paper",
        "points, best",
        "network modes, paper",
        "network modes, best",
    ),
    tables=tables,
    draw=draw,
    reading="Down is nearer to the truth, left is quicker: a point above and to the right of "
    "another one is not worth its time. The front is of ways that see one mask: further masks are "
    "not a setting but more input; they bring more than any setting. Modes of the network start "
    "from its prediction, so the two panels are not to be mixed.",
    convention=CONVENTION,
    options=options.COMMON,
    plan=plan,
    conclude=conclude,
)
