"""What studies make of the figures of their cases: means, ratios, intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..study import Cases, Record

RESAMPLED_SETS, PERCENTILES = 4000, (2.5, 97.5)
"""Of shapes behind an interval; the ends of a 95 % interval."""


def rounded(values: Record) -> Record:
    """Floats with five digits: the sixth differs between machines."""
    return {
        name: float(f"{value:.5g}") if isinstance(value, (float, np.floating)) else value
        for name, value in values.items()
    }


def mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def standard_error(values: Iterable[float]) -> float:
    """Of the mean; 0 for a single value."""
    several = list(values)
    return float(np.std(several, ddof=1)) / len(several) ** 0.5 if len(several) > 1 else 0.0


def ratios_of(cases: Cases, variant: str) -> np.ndarray:
    """Chamfer after / before of every case."""
    return np.array(
        [case["variants"][variant]["chamfer"] / case["before"]["chamfer"] for case in cases]
    )


def ratio_of_means(cases: Cases, distances: Iterable[float]) -> float:
    """Mean of ``distances``, one for each case, over the mean Chamfer distance of the starts."""
    return mean(distances) / mean(case["before"]["chamfer"] for case in cases)


def ratio_figures(ratios: np.ndarray) -> Record:
    """Mean, median and worst of Chamfer after / before, and how many cases got worse."""
    return {
        "mean_ratio": float(ratios.mean()),
        "median_ratio": float(np.median(ratios)),
        "worst_ratio": float(ratios.max()),
        "worse": int((ratios > 1.0).sum()),
    }


def interval(
    shapes: Sequence[str], values: np.ndarray, weights: np.ndarray | None = None
) -> list[float]:
    """95 % interval of sum(values) / sum(weights), or of the mean without ``weights``.

    ``shapes`` names the shape of each value. Shapes are drawn with replacement, as views of one
    shape are not independent.
    """
    indices = np.unique(shapes, return_inverse=True)[1]
    totals, counts = np.bincount(indices, values), np.bincount(indices, weights)
    drawn = np.random.default_rng(0).integers(len(totals), size=(RESAMPLED_SETS, len(totals)))
    low, high = np.percentile(totals[drawn].sum(1) / counts[drawn].sum(1), PERCENTILES)
    return [float(low), float(high)]


def summarised(cases: Cases, keys: Sequence[str], figures: Callable[[Cases], Any]) -> Any:
    """Value of the first key -> value of the second -> ... -> the figures of those cases."""
    if not keys:
        return figures(cases)
    groups = grouped(cases, keys[0])
    return {value: summarised(group, keys[1:], figures) for value, group in groups.items()}


def nested_rows(groups: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> list[list[Any]]:
    """Of label -> label -> figures a row each: both labels and the figures."""
    return [
        [label, name, *figures.values()]
        for label, group in groups.items()
        for name, figures in group.items()
    ]


def grouped(cases: Cases, key: str) -> dict[str, Cases]:
    """The cases by their value of ``key``, in the order in which they come."""
    groups: dict[str, Cases] = {}
    for case in cases:
        groups.setdefault(case[key], []).append(case)
    return groups
