"""Random draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

Range = tuple[float, float]


def chance(rng: np.random.Generator, probability: float) -> bool:
    """True with this probability."""
    return bool(rng.random() < probability)


def pick(rng: np.random.Generator, weights: Mapping[str, float]) -> str:
    """One of the keys, drawn by weight."""
    probabilities = np.array(list(weights.values()), dtype=np.float64)
    return list(weights)[int(rng.choice(len(weights), p=probabilities / probabilities.sum()))]


def draw(rng: np.random.Generator, ranges: Sequence[Range]) -> list[float]:
    """A number from each range (low, high)."""
    low, high = np.array(ranges).T
    return [float(value) for value in rng.uniform(low, high)]
