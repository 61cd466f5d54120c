"""What the runs of one level say together, and where along an axis a refinement stops to work."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..study import Cases, Record
from .axes import AXES

AXIS = {axis.name: axis for axis in AXES}
WORSE = 1.05
"""A ratio over this is worse than the start."""
FEW = 0.05
"""Largest share of worse runs at a level that works."""
OFTEN = 0.5
"""tso warns at a level if it does so in this share of the runs."""
SILENT, WARNED, DOUBTFUL, REFUSED, NON_FINITE = "-wdrn"
"""What became of a run: done without a warning, warned, called doubtful, refused, not finite."""


def figures(said: str, ratios: Sequence[float | None]) -> dict[str, float | None]:
    """Of the runs of one level: the median ratio after / before, and shares of the runs.

    ``worse`` is the share over 1.05, ``spoke`` the share with a warning, a doubtful verdict or a
    refusal, ``silent`` the share that is worse without any. A run that was not refused and has no
    ratio counts as infinitely worse.
    """
    pairs = list(zip(ratios, said, strict=True))
    done = [np.inf if ratio is None else ratio for ratio, word in pairs if word != REFUSED]
    spoke = np.array([word in (WARNED, DOUBTFUL, REFUSED) for word in said])
    worse = np.array([got_worse(ratio, word) for ratio, word in pairs])
    values = {
        "median": np.quantile(done, 0.5, method="nearest") if done else None,
        "worse": float(worse.mean()),
        "refused": said.count(REFUSED) / len(said),
        "spoke": float(spoke.mean()),
        "silent": float((worse & ~spoke).mean()),
    }
    return {name: digits(value) for name, value in values.items()}


def got_worse(ratio: float | None, word: str) -> bool:
    """Whether a run with this ratio, of which tso said ``word``, ended worse than it started."""
    return word != REFUSED and (ratio is None or ratio > WORSE)


def digits(value: float | None, count: int = 3) -> float | None:
    """Rounded to ``count`` digits; None for what is no finite number."""
    return None if value is None or not np.isfinite(value) else float(f"{value:.{count}g}")


def warns(row: Record) -> bool:
    """Whether tso warns, doubts or refuses in at least half of the runs of this level."""
    return bool(row["spoke"] >= OFTEN)


def fails(row: Record) -> bool:
    return row["refused"] > 0.5 or row["median"] is None or row["median"] > WORSE


def works(row: Record) -> bool:
    return not fails(row) and row["worse"] <= FEW


def knee(rows: Cases) -> Record:
    """The levels of an axis that matter to a user, None where there is none.

    ``rows`` are those of all levels, from harmless to hopeless.

    works_to : the last level before the first that does not work.
    fails_at : the first level that fails; ``refused`` if most of its runs are refused.
    speaks_from : the first level with a warning from which on all failing levels have one; where
        none fails, from which on all have one.
    worst : largest median ratio of a level. silent : share of all runs that got worse silently.
    """
    levels = [row["level"] for row in rows]
    working, failing = [works(row) for row in rows], [fails(row) for row in rows]
    harmless = working.index(False) if False in working else len(rows)
    asked = failing if True in failing else [True] * len(rows)
    missed = [place for place, row in enumerate(rows) if asked[place] and not warns(row)]
    speaks = [row["level"] for row in rows[max(missed, default=-1) + 1 :] if warns(row)]
    fails_at = failing.index(True) if True in failing else None
    medians = [row["median"] for row in rows if row["median"] is not None]
    return {
        "works_to": levels[harmless - 1] if harmless else None,
        "speaks_from": speaks[0] if speaks else None,
        "fails_at": None if fails_at is None else levels[fails_at],
        "refused": fails_at is not None and rows[fails_at]["refused"] > 0.5,
        "worst": max(medians, default=None),
        "silent": digits(float(np.mean([row["silent"] for row in rows]))),
    }
