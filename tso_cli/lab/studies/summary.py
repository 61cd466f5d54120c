"""What the studies make of the figures of their cases: means, ratios, intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ..study import Cases

RESAMPLED, ENDS = 4000, (2.5, 97.5)
"""Resampled sets of shapes behind an interval, and the percentiles at its ends."""


def rounded(values: dict[str, Any]) -> dict[str, Any]:
    """Floats with five digits: the sixth differs between machines."""
    return {name: float(f"{value:.5g}") if isinstance(value, (float, np.floating)) else value for name, value in values.items()}


def mean(values: Iterable[float | None]) -> float | None:
    """The mean; None where a value is missing."""
    numbers = list(values)
    return None if None in numbers else float(np.mean(numbers))  # type: ignore[arg-type]


def ratio_figures(ratios: np.ndarray) -> dict[str, Any]:
    """Mean, median and worst of Chamfer after / before, and how many cases got worse."""
    return {
        "mean_ratio": float(ratios.mean()),
        "median_ratio": float(np.median(ratios)),
        "worst_ratio": float(ratios.max()),
        "worse": int((ratios > 1.0).sum()),
    }


def interval(shapes: Sequence[str], values: np.ndarray, weights: np.ndarray | None = None) -> list[float]:
    """95 % interval of sum(values) / sum(weights) over shapes drawn with replacement: views of one shape are not independent.

    ``shapes`` names the shape of each value; without ``weights`` the interval is that of the mean.
    """
    indices = np.unique(shapes, return_inverse=True)[1]
    totals, counts = np.bincount(indices, values), np.bincount(indices, weights)
    drawn = np.random.default_rng(0).integers(len(totals), size=(RESAMPLED, len(totals)))
    low, high = np.percentile(totals[drawn].sum(1) / counts[drawn].sum(1), ENDS)
    return [float(low), float(high)]


def by_category(cases: Cases) -> dict[str, Cases]:
    """The cases of each category, in the order in which they come."""
    groups: dict[str, Cases] = {}
    for case in cases:
        groups.setdefault(case["category"], []).append(case)
    return groups
