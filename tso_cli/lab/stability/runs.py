"""Cases altered, refined, and compared with the truth."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from ...commands.sentences import Words
from ...diagnosis.examine import NoOverlapError
from ...diagnosis.findings import Finding
from ...errors import TsoError
from ...evaluation.metrics import chamfer
from ...geometry.camera import Array
from ...geometry.view import View
from ...refinement import RefineConfig, RefineResult, refine_batch
from ..interrupts import uninterrupted
from ..studies.cases import Case
from ..studies.refining import Variant
from ..study import Cases, Record
from .axes import Axis
from .knees import DOUBTFUL, NON_FINITE, REFUSED, SILENT, WARNED, digits, figures

Peer = Callable[[Array, Sequence[View]], Array]
Way = Variant | Peer
PIXELS_AT_ONCE = 3e7
"""Most that are refined in one call: 8,192 pixels each way fill a quarter of a GiB."""


def findings_of(source: RefineResult | TsoError) -> tuple[str, ...]:
    """The names of what a result or a refusal finds to be suspicious, without their values."""
    findings: Sequence[Finding] = ()
    if isinstance(source, NoOverlapError):
        findings = source.diagnosis.suspicious
    elif isinstance(source, RefineResult):
        findings = [finding for finding in source.findings if finding.suspicious]
    # An assumption that is taken back names no mistake.
    names = ("" if finding.without else finding.name for finding in findings)
    return tuple(name.partition("=")[0] for name in names)


@dataclass(frozen=True, eq=False)
class Run:
    """A case to alter by an axis at a level, and to refine with ``masks`` masks.

    ``other`` has the masks of another object.
    """

    axis: Axis
    level: float
    case: Case
    other: Case
    rng: np.random.Generator
    masks: int = 1

    def altered(self, config: RefineConfig) -> tuple[Case, RefineConfig]:
        """The case, with the masks that are seen, and settings; TsoError where it has none."""
        case, config = self.axis.apply(self.case, self.level, self.rng, self.other, config)
        return replace(case, views=case.views[: max(self.masks, self.axis.masks)]), config


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a run.

    said : a letter of `knees`. points : [M, 3], None if it was refused. result : None of a peer.
    findings : names of hypotheses, of the result or the refusal.
    """

    run: Run
    said: str = REFUSED
    altered: Case | None = None
    points: Array | None = None
    result: RefineResult | None = None
    findings: tuple[str, ...] = ()

    def ratio(self) -> float | None:
        """Chamfer distance of the result's own points over the distance of the altered start.

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
    """Case ``number`` at that level; one seed gives all levels the same random numbers."""
    case, other = cases[number], cases[(number + max(1, len(cases) // 2)) % len(cases)]
    words = (zlib.crc32(word.encode()) for word in (axis.name, case.shape))
    return Run(axis, level, case, other, np.random.default_rng([seed, *words, case.view]), masks)


def level_rows(
    cases: Sequence[Case],
    seeds: Sequence[int],
    axis: Axis,
    name: str,
    way: Way,
    levels: Sequence[float],
) -> Cases:
    """A row for each level: its figures, and what became of all seeds of each case."""
    masks = way.masks if isinstance(way, Variant) else 1
    places = product(levels, range(len(cases)), seeds)
    runs = (run_of(cases, axis, *place, masks) for place in places)
    found = [(outcome.said, digits(outcome.ratio())) for outcome in outcomes_of(runs, way)]
    count, rows = len(cases) * len(seeds), []
    for i, level in enumerate(levels):
        letters, ratios = zip(*found[i * count : (i + 1) * count], strict=True)
        row: Record = {"axis": axis.name, "variant": name, "level": level}
        row |= figures("".join(letters), ratios)
        rows.append({**row, "said": "".join(letters), "ratio": list(ratios)})
    return rows


def outcomes_of(runs: Iterable[Run], way: Way) -> Iterator[Outcome]:
    """What becomes of each run, in their order; runs of equal settings are refined in one call."""
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
        if size and (config != refined_with or size + pixels > PIXELS_AT_ONCE):
            yield from _refined(waiting, way, refined_with)
            waiting, size = [], 0
        waiting.append((run, altered))
        refined_with, size = config, size + pixels
    yield from _refined(waiting, way, refined_with)


def _refined(
    waiting: Sequence[tuple[Run, Case | TsoError]], way: Way, config: RefineConfig
) -> Iterator[Outcome]:
    cases = [altered for _, altered in waiting if isinstance(altered, Case)]
    results: Iterator[RefineResult | TsoError] = iter(())
    if isinstance(way, Variant) and cases:
        results = iter(refine_batch([(case.initial, case.views) for case in cases], config))
    for run, altered in waiting:
        if isinstance(altered, TsoError):
            yield Outcome(run, findings=findings_of(altered))
        elif isinstance(way, Variant):
            yield outcome_of(run, altered, next(results))
        else:
            yield _of_peer(run, altered, way)


def outcome_of(run: Run, altered: Case, result: Any) -> Outcome:
    """What became of a run with this result or error."""
    findings = findings_of(result)
    if isinstance(result, TsoError):
        return Outcome(run, findings=findings)
    words = Words([view.name for view in result.views])
    said = WARNED if words.warnings(result) else SILENT
    if uninterrupted(result).trust.verdict == "doubtful" or findings:
        said = DOUBTFUL
    if not np.isfinite(result.points).all() or result.fit.stop_reason == "non_finite":
        said = NON_FINITE
    return Outcome(run, said, altered, result.points, result, findings)


def _of_peer(run: Run, altered: Case, peer: Peer) -> Outcome:
    try:
        moved = peer(altered.initial, altered.views)
    except TsoError:
        return Outcome(run)
    said = SILENT if np.isfinite(moved).all() else NON_FINITE
    return Outcome(run, said, altered, moved)
