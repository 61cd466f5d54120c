"""Cases altered, refined and judged."""

from __future__ import annotations

import time
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from ...errors import TsoError
from ...evaluation.metrics import chamfer
from ...geometry.camera import Array
from ...geometry.view import View
from ...refinement import RefineConfig, RefineResult, refine_batch
from ..studies.cases import Case
from ..studies.refining import Variant, uninterrupted
from ..study import Cases
from .axes import Axis
from .knees import DOUBTFUL, NON_FINITE, REFUSED, SILENT, WARNED, digits, figures

Peer = Callable[[Array, Sequence[View]], Array]
Way = Variant | Peer
# Pixels of the scenes that are refined in one call, at most: 8,192 pixels each way fill a quarter of a GiB.
AT_ONCE = 3e7
# What a row says of each run -> the attribute of its result.
NUMBERS = {
    "confidence": "confidence",
    "iou_before": "iou_before",
    "iou_after": "iou_after",
    "moved": "moved_mean",
}


@dataclass(frozen=True, eq=False)
class Run:
    """A case to alter by an axis at a level, and to refine with so many ``masks``; ``other`` has those of another object."""

    axis: Axis
    level: float
    case: Case
    other: Case
    rng: np.random.Generator
    masks: int = 1

    def altered(self, config: RefineConfig) -> tuple[Case, RefineConfig]:
        """The case, with the masks that are seen, and settings; raises TsoError where it cannot be made."""
        case, config = self.axis.apply(self.case, self.level, self.rng, self.other, config)
        return replace(case, views=case.views[: max(self.masks, self.axis.masks)]), config


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a run. said : a letter of `knees`; points : [M, 3]; result : None of a peer; took : seconds.

    Of a case that was refused there is the ``refusal`` alone, in words.
    """

    run: Run
    said: str = REFUSED
    altered: Case | None = None
    points: Array | None = None
    result: RefineResult | None = None
    took: float | None = None
    refusal: str = ""

    def ratio(self) -> float | None:
        """Chamfer distance of the result's own points over that of the start as it was given, altered.

        None where there is no result, or a point is no number.
        """
        axis, case, altered = self.run.axis, self.run.case, self.altered
        if altered is None or self.points is None or not np.isfinite(self.points).all():
            return None
        before, after = (
            chamfer(axis.own(case, points), altered.target).chamfer
            for points in (altered.initial, self.points)
        )
        return after / before


def run_of(
    cases: Sequence[Case], axis: Axis, level: float, number: int, seed: int, masks: int = 1
) -> Run:
    """Case ``number`` at that level, beside another of them; one seed gives all levels the same random numbers."""
    case, other = cases[number], cases[(number + max(1, len(cases) // 2)) % len(cases)]
    rng = np.random.default_rng(
        [seed, zlib.crc32(axis.name.encode()), zlib.crc32(case.shape.encode()), case.view]
    )
    return Run(axis, level, case, other, rng, masks)


def judge(
    cases: Sequence[Case],
    seeds: Sequence[int],
    axis: Axis,
    name: str,
    way: Way,
    levels: Sequence[float],
) -> Cases:
    """A row for each level, of all seeds of each case."""
    masks = way.masks if isinstance(way, Variant) else 1
    runs = (
        run_of(cases, axis, *place, masks) for place in product(levels, range(len(cases)), seeds)
    )
    run_rows, count = (
        [_run_row(outcome) for outcome in outcomes_of(runs, way)],
        len(cases) * len(seeds),
    )
    return [
        _row(axis, name, level, run_rows[i * count : (i + 1) * count])
        for i, level in enumerate(levels)
    ]


def _run_row(outcome: Outcome) -> dict[str, Any]:
    """What a row says of a run."""
    verdict = getattr(outcome.result, "verdict", None) or "?"
    numbers = {key: digits(getattr(outcome.result, name, None)) for key, name in NUMBERS.items()}
    return {
        "said": outcome.said,
        "verdict": verdict[0],
        "ratio": digits(outcome.ratio()),
        **numbers,
        "took": digits(outcome.took),
    }


def _row(axis: Axis, name: str, level: float, run_rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The level's figures, and the same of every run; what no run has is left out."""
    of_runs = {key: [run[key] for run in run_rows] for key in run_rows[0]}
    said, verdicts, ratios = (
        "".join(of_runs.pop("said")),
        "".join(of_runs.pop("verdict")),
        of_runs.pop("ratio"),
    )
    head = {
        "axis": axis.name,
        "variant": name,
        "level": level,
        **figures(said, ratios, of_runs["took"]),
        "said": said,
    }
    if verdicts.strip("?"):
        head["verdict"] = verdicts
    return {
        **head,
        "ratio": ratios,
        **{key: values for key, values in of_runs.items() if any(v is not None for v in values)},
    }


def outcomes_of(runs: Iterable[Run], way: Way) -> Iterator[Outcome]:
    """What becomes of each run, in their order, by a peer or a refinement; those of equal settings are refined in one call."""
    given = way.config if isinstance(way, Variant) else RefineConfig()
    waiting: list[tuple[Run, Case | TsoError]] = []
    refined_with, size = given, 0
    for run in runs:
        try:
            altered, config = run.altered(given)
        except TsoError as error:
            waiting.append((run, error))
            continue
        pixels = sum(view.mask.size for view in altered.views)
        if size and (config != refined_with or size + pixels > AT_ONCE):
            yield from _refined(waiting, way, refined_with)
            waiting, size = [], 0
        waiting.append((run, altered))
        refined_with, size = config, size + pixels
    yield from _refined(waiting, way, refined_with)


def _refined(
    waiting: Sequence[tuple[Run, Case | TsoError]], way: Way, config: RefineConfig
) -> Iterator[Outcome]:
    # What is said on the way names the view.
    named = [
        replace(altered, views=tuple(replace(view, name=f"run {i}") for view in altered.views))
        for i, (_, altered) in enumerate(waiting)
        if isinstance(altered, Case)
    ]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        results: Iterator[RefineResult | TsoError] = iter(())
        if isinstance(way, Variant) and named:
            results = iter(refine_batch([(case.initial, case.views) for case in named], config))
    warned = {str(warning.message).partition(":")[0] for warning in caught}
    for i, (run, altered) in enumerate(waiting):
        if isinstance(altered, TsoError):
            yield Outcome(run, refusal=str(altered))
        elif isinstance(way, Variant):
            yield _of_result(run, altered, next(results), f"run {i}" in warned)
        else:
            yield _of_peer(run, altered, way)


def _of_result(run: Run, altered: Case, result: Any, warned: bool) -> Outcome:
    if isinstance(result, TsoError):
        return Outcome(run, refusal=str(result))
    said = WARNED if warned or result.warnings else SILENT
    if uninterrupted(result).verdict == "doubtful" or result.suspects:
        said = DOUBTFUL
    if not np.isfinite(result.points).all() or result.stop_reason == "non_finite":
        said = NON_FINITE
    return Outcome(run, said, altered, result.points, result, sum(result.seconds.values()))


def _of_peer(run: Run, altered: Case, peer: Peer) -> Outcome:
    begun = time.perf_counter()
    try:
        moved = peer(altered.initial, altered.views)
    except TsoError as error:
        return Outcome(run, refusal=str(error))
    said = SILENT if np.isfinite(moved).all() else NON_FINITE
    return Outcome(run, said, altered, moved, took=time.perf_counter() - begun)
