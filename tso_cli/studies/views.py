"""How many masks of each object supervise a step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .figures import CATEGORIES, VIEWS, chamfer_of, claim, judged_categories, sigma_sq
from .trained import Setting

NAME, STEPS = "views", 800
REDUCED, FULL = ("car",), CATEGORIES
COUNTS = (1, 2, 3, 4, 5, 6, 8)
# The paper's own values for two masks and more lie within 5 % of each other.
CONSTANT = 1.1


def settings(categories: Sequence[str]) -> list[Setting]:
    """A network for each number of masks and each category."""
    return [
        Setting(_name(count), category, {"supervision": "masks", "views": count, "sigma_sq": sigma_sq(category)})
        for category in categories
        for count in COUNTS
    ]


def conclude(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Chamfer by category and number of masks beside the paper's, and what holds of its claims."""
    summary = {
        category: {str(count): chamfer_of(runs, _name(count), category) for count in COUNTS}
        for category in judged_categories(runs)
    }
    one = {category: values["1"] for category, values in summary.items()}
    two = {category: values["2"] for category, values in summary.items()}
    spread = {category: _spread([values[str(count)] for count in COUNTS[1:]]) for category, values in summary.items()}
    claims = [
        claim(
            "two masks of each object are better than one",
            all(two[category] < one[category] for category in summary),  # type: ignore[operator]
            ", ".join(f"{name} {one[name]:.2f} to {two[name]:.2f}{_paper(name)}" for name in summary),
        ),
        claim(
            f"more than two change little (largest at most {CONSTANT:g} times the smallest)",
            all(value <= CONSTANT for value in spread.values()),
            ", ".join(f"{name} {value:.2f} times" for name, value in spread.items()),
        ),
    ]
    return {"summary": summary, "paper": VIEWS, "claims": claims}


def _name(count: int) -> str:
    return f"V = {count}"


def _spread(values: list[float | None]) -> float:
    known = np.array(values, dtype=np.float64)
    return float(known.max() / known.min())


def _paper(category: str) -> str:
    return f" (paper {VIEWS[category][1]:.2f} to {VIEWS[category][2]:.2f})" if category in VIEWS else ""
