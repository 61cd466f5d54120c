"""Cases altered, refined and judged."""

from __future__ import annotations

import time
import warnings
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import TsoError
from ...evaluation.metrics import chamfer
from ...geometry.camera import Array
from ...geometry.view import View
from ...refinement import RefineConfig, refine_batch
from ..studies.cases import Case
from ..studies.refining import Variant, uninterrupted
from ..study import Cases
from .axes import Axis
from .knees import DOUBTFUL, NON_FINITE, REFUSED, SILENT, WARNED, between, digits, figures, hardest_last

Peer = Callable[[Array, Sequence[View]], Array]
Way = Variant | Peer
# Pixels and points of the scenes that are refined in one call, at most: 8,192 pixels each way fill a quarter of a GiB.
AT_ONCE = 3e7


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a run. said : a letter of `knees`; verdict : the first letter of the
    result's, "?" where it has none; moved : mean, longest sides; took : seconds."""

    said: str
    points: Array | None = None
    verdict: str = "?"
    confidence: float | None = None
    iou_before: float | None = None
    iou_after: float | None = None
    moved: float | None = None
    took: float | None = None


NUMBERS = ("confidence", "iou_before", "iou_after", "moved", "took")


@dataclass(frozen=True, eq=False)
class Bench:
    """The cases and seeds that every axis is judged on."""

    cases: Sequence[Case]
    seeds: Sequence[int]

    def altered(self, axis: Axis, level: float, number: int, seed: int, config: RefineConfig) -> tuple[Case, RefineConfig]:
        """Case ``number`` at that level; one seed gives all levels the same random numbers."""
        case, other = self.cases[number], self.cases[(number + max(1, len(self.cases) // 2)) % len(self.cases)]
        rng = np.random.default_rng([seed, zlib.crc32(axis.name.encode()), zlib.crc32(case.shape.encode()), case.view])
        return axis.apply(case, level, rng, other, config)

    def judge(self, axis: Axis, name: str, way: Way, levels: Sequence[float], halvings: int = 0) -> Cases:
        """A row for each of ``levels``, and for those in which ``halvings`` bisections of each knee end."""
        rows = self._rows(axis, name, way, levels)
        for _ in range(halvings if axis.continuous else 0):
            by_level = {row["level"]: row for row in [*rows, *self._rows(axis, name, way, between(axis, rows))]}
            rows = [by_level[level] for level in hardest_last(axis, set(by_level))]
        return rows

    def _rows(self, axis: Axis, name: str, way: Way, levels: Sequence[float]) -> Cases:
        places = [(level, number, seed) for level in levels for number in range(len(self.cases)) for seed in self.seeds]
        config = way.config if isinstance(way, Variant) else RefineConfig()
        masks = max(axis.masks, way.masks if isinstance(way, Variant) else 1)
        outcomes: list[tuple[Outcome, float | None]] = []
        waiting: list[tuple[int, Case]] = []
        refined_with = config

        def refine_waiting() -> None:
            scenes = [(altered.initial, altered.views[:masks]) for _, altered in waiting]
            for (place, altered), outcome in zip(waiting, outcomes_of(scenes, way, refined_with), strict=True):
                outcomes[place] = outcome, _ratio(axis, self.cases[places[place][1]], altered, outcome.points)
            waiting.clear()

        for place, (level, number, seed) in enumerate(places):
            outcomes.append((Outcome(REFUSED), None))
            try:
                altered, settings = self.altered(axis, level, number, seed, config)
            except TsoError:
                continue
            size = sum(view.mask.size for _, case in waiting for view in case.views[:masks])
            if waiting and (settings != refined_with or size + altered.views[0].mask.size > AT_ONCE):
                refine_waiting()
            refined_with = settings
            waiting.append((place, altered))
        refine_waiting()
        runs = len(self.cases) * len(self.seeds)
        return [_row(axis, name, level, outcomes[i * runs : (i + 1) * runs]) for i, level in enumerate(levels)]


def _row(axis: Axis, name: str, level: float, outcomes: Sequence[tuple[Outcome, float | None]]) -> dict[str, Any]:
    """The level's figures, and the same numbers of every run; what no run has is left out."""
    said, verdicts = ("".join(getattr(outcome, key) for outcome, _ in outcomes) for key in ("said", "verdict"))
    numbers = {key: [digits(getattr(outcome, key)) for outcome, _ in outcomes] for key in NUMBERS}
    ratios = [digits(ratio) for _, ratio in outcomes]
    head = {"axis": axis.name, "variant": name, "level": level, **figures(said, ratios, numbers["took"]), "said": said}
    if verdicts.strip("?"):
        head["verdict"] = verdicts
    return {**head, "ratio": ratios, **{key: values for key, values in numbers.items() if any(v is not None for v in values)}}


def _ratio(axis: Axis, case: Case, altered: Case, points: Array | None) -> float | None:
    """Chamfer distance of the result's own points over that of the start; None where a point is no number."""
    if points is None or not np.isfinite(points).all():
        return None
    before = chamfer(axis.start(case, altered), altered.target).chamfer
    return chamfer(axis.own(case, points), altered.target).chamfer / before


def outcomes_of(scenes: Sequence[tuple[Array, Sequence[View]]], way: Way, config: RefineConfig) -> list[Outcome]:
    """What becomes of each scene, (points [N, 3], views), by a peer, or by the refinement with ``config``."""
    if not isinstance(way, Variant):
        return [_of_peer(way, *scene) for scene in scenes]
    # What is said on the way names the view.
    named = [(points, [replace(view, name=f"run {i}") for view in views]) for i, (points, views) in enumerate(scenes)]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        results = refine_batch(named, config) if named else []
    said = {str(warning.message).partition(":")[0] for warning in caught}
    return [_of_result(result, f"run {i}" in said) for i, result in enumerate(results)]


def _of_result(result: Any, warned: bool) -> Outcome:
    if isinstance(result, TsoError):
        return Outcome(REFUSED)
    verdict = uninterrupted(result).verdict
    said = WARNED if warned or result.warnings else SILENT
    if verdict == "doubtful" or result.suspects:
        said = DOUBTFUL
    if not np.isfinite(result.points).all() or result.stop_reason == "non_finite":
        said = NON_FINITE
    return Outcome(
        said,
        result.points,
        (verdict or "?")[0],
        result.confidence,
        result.iou_before,
        result.iou_after,
        result.moved_mean,
        sum(result.seconds.values()),
    )


def _of_peer(peer: Peer, points: Array, views: Sequence[View]) -> Outcome:
    begun = time.perf_counter()
    try:
        moved = peer(points, views)
    except TsoError:
        return Outcome(REFUSED)
    said = SILENT if np.isfinite(moved).all() else NON_FINITE
    return Outcome(said, moved, took=time.perf_counter() - begun)
