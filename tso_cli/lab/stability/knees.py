"""What the runs of one level say together, and where along an axis a refinement stops to work."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..study import Cases, Record
from .axes import AXES, Axis

AXIS = {axis.name: axis for axis in AXES}
WORSE = 1.05
"""A ratio over this is worse than the start."""
# Of the runs of a level that works, so many may be worse.
FEW = 0.05
FIGURES = ("median", "p95", "worst", "worse", "non_finite", "refused", "spoke", "silent", "seconds")
SILENT, WARNED, DOUBTFUL, REFUSED, NON_FINITE = "-wdrn"
"""What became of a run, a letter each: done and silent, warned, doubted by the tool itself, refused, not finite."""


def figures(
    said: str, ratios: Sequence[float | None], seconds: Sequence[float | None]
) -> dict[str, float | None]:
    """`FIGURES` of the runs of one level: ratios after / before, shares of the runs, median seconds.

    ``worse`` is the share over 1.05, ``spoke`` that with a warning, a doubt or a refusal, ``silent`` that worse and with none.
    A run without a ratio that was not refused counts as infinitely worse.
    """
    done = np.array(
        [
            np.inf if ratio is None else ratio
            for ratio, word in zip(ratios, said, strict=True)
            if word != REFUSED
        ]
    )
    median, high, worst = (
        np.quantile(done, (0.5, 0.95, 1.0), method="nearest") if len(done) else [np.nan] * 3
    )
    spoke = np.array([word in (WARNED, DOUBTFUL, REFUSED) for word in said])
    worse = np.array([got_worse(ratio, word) for ratio, word in zip(ratios, said, strict=True)])
    took = [value for value in seconds if value is not None]
    shares = [
        float(share) / len(said)
        for share in (worse.sum(), said.count(NON_FINITE), said.count(REFUSED), spoke.sum())
    ]
    values = [
        median,
        high,
        worst,
        *shares,
        float((worse & ~spoke).mean()),
        float(np.median(took)) if took else None,
    ]
    return {name: digits(value) for name, value in zip(FIGURES, values, strict=True)}


def got_worse(ratio: float | None, word: str) -> bool:
    """Whether a run with this ratio, of which the tool said ``word``, ended worse than it started."""
    return word != REFUSED and (ratio is None or ratio > WORSE)


def digits(value: float | None, count: int = 3) -> float | None:
    """With so many digits; None for what is no finite number."""
    return None if value is None or not np.isfinite(value) else float(f"{value:.{count}g}")


def speaks(row: Record) -> bool:
    """Whether the tool speaks up at this level: warns, doubts or refuses in at least half of the runs."""
    return bool(row["spoke"] >= 0.5)


def fails(row: Record) -> bool:
    return row["refused"] > 0.5 or row["median"] is None or row["median"] > WORSE


def works(row: Record) -> bool:
    return not fails(row) and row["worse"] <= FEW


def knee(rows: Cases) -> Record:
    """The levels of an axis that matter to a user, None where there is none, and the same in words.

    works_to : the last level before the first that does not work. fails_at : the first level that fails. speaks_from : the
    first level with a warning after the last failing one without (where none fails, the last one without). ``rows`` are those
    of all levels, from harmless to hopeless.
    """
    levels, flags = (
        [row["level"] for row in rows],
        {test: [test(row) for row in rows] for test in (works, speaks, fails)},
    )
    working = flags[works].index(False) if False in flags[works] else len(rows)
    judged = flags[fails] if True in flags[fails] else [True] * len(rows)
    silent = [place for place in range(len(rows)) if judged[place] and not flags[speaks][place]]
    warned = [
        place for place in range(max(silent, default=-1) + 1, len(rows)) if flags[speaks][place]
    ]
    speaking = min(warned, default=len(rows))
    failing = flags[fails].index(True) if True in flags[fails] else len(rows)
    places = {"works_to": working - 1, "speaks_from": speaking, "fails_at": failing}
    knee_levels: Record = {
        key: levels[i] if 0 <= i < len(rows) else None for key, i in places.items()
    }
    refused = failing < len(rows) and rows[failing]["refused"] > 0.5
    return {**knee_levels, "words": _words(AXIS[rows[0]["axis"]], knee_levels, levels, refused)}


def _words(axis: Axis, knee_levels: Record, levels: list[float], refused: bool) -> str:
    works_to, speaks_from, fails_at = (
        knee_levels["works_to"],
        knee_levels["speaks_from"],
        knee_levels["fails_at"],
    )
    if len(axis.levels) == 1:
        outcome = (
            "fails"
            if fails_at is not None
            else "works"
            if works_to is not None
            else "fails at times"
        )
        warned = (
            ", with a warning"
            if speaks_from is not None
            else ""
            if works_to is not None
            else ", without a word"
        )
        return "is refused" if refused else outcome + warned
    unit = f" {axis.unit}".rstrip()
    if works_to == levels[-1]:
        return f"works throughout, {_warns(speaks_from)}"
    works_words = (
        f"works to {works_to:g}{unit}"
        if works_to is not None
        else f"does not work at {levels[0]:g}{unit}"
    )
    failure = (
        "does not fail"
        if fails_at is None
        else f"{'is refused' if refused else 'fails'} at {fails_at:g}"
    )
    return f"{works_words}, {_warns(speaks_from)}, {failure}"


def _warns(speaks_from: float | None) -> str:
    return "never warns" if speaks_from is None else f"warns from {speaks_from:g}"
