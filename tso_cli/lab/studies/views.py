"""How many masks of each object supervise a step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .figures import CATEGORIES, VIEWS, chamfer_of, claim, judged_categories, mean_of, sigma_sq
from .mean_shape import MEAN_SHAPE
from .trained import Setting

NAME, STEPS = "views", 2000
REDUCED, FULL = ("car",), CATEGORIES
COUNTS = (1, 2, 3, 4, 5, 6, 8)
# The paper's own values for two masks and more lie within 5 % of each other.
CONSTANT = 1.1
# Networks for the comparison that the study is about, one and two masks, which differ in their seed alone.
SEEDS = 3


def settings(categories: Sequence[str]) -> list[Setting]:
    """For each category a network for each number of masks, several for one and two; and the answer without a network."""
    found = []
    for category in categories:
        masks = {"supervision": "masks", "sigma_sq": sigma_sq(category)}
        found.append(Setting(MEAN_SHAPE, category, constant=True))
        for count in COUNTS:
            for repeat in range(SEEDS if count <= 2 else 1):
                found.append(Setting(_name(count, repeat), category, {**masks, "views": count}, repeat=repeat))
    return found


def conclude(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Chamfer by category and number of masks (the mean over seeds) beside the paper's, and what holds of its claims."""
    categories = judged_categories(runs)
    seeds = {category: {str(count): _repeated(runs, count, category) for count in COUNTS} for category in categories}
    summary = {category: {count: float(np.mean(values)) for count, values in own.items()} for category, own in seeds.items()}
    one, two = ({category: seeds[category][count] for category in categories} for count in "12")
    spread = {category: _spread([values[str(count)] for count in COUNTS[1:]]) for category, values in summary.items()}
    claims = [
        claim(
            "two masks of each object are better than one, whatever the seed",
            all(max(two[category]) < min(one[category]) for category in categories),
            ", ".join(f"{name} {_listed(one[name])} to {_listed(two[name])}{_gain(name, summary)}" for name in categories),
        ),
        claim(
            f"more than two change little (largest at most {CONSTANT:g} times the smallest)",
            all(value <= CONSTANT for value in spread.values()),
            ", ".join(f"{name} {value:.2f} times" for name, value in spread.items()),
        ),
    ]
    constant = {category: mean_of(runs, MEAN_SHAPE, [category]) for category in categories}
    claims.append(
        claim(
            "masks teach more than the mean shape",
            all(max(values.values()) < constant[category] for category, values in summary.items()),
            ", ".join(
                f"{name} {max(values.values()):.2f} at most against {constant[name]:.2f}"
                + ("" if max(values.values()) < constant[name] else ", not there")
                for name, values in summary.items()
            ),
        )
    )
    paper = {category: {str(count): value for count, value in values.items()} for category, values in VIEWS.items()}
    return {"summary": summary, "seeds": seeds, "constant": constant, "paper": paper, "claims": claims}


def _name(count: int, repeat: int = 0) -> str:
    return f"V = {count}" + (f", seed + {repeat}" if repeat else "")


def _repeated(runs: list[dict[str, Any]], count: int, category: str) -> list[float]:
    values = [chamfer_of(runs, _name(count, repeat), category) for repeat in range(SEEDS)]
    return [value for value in values if value is not None]


def _listed(values: Sequence[float]) -> str:
    return "/".join(f"{value:.2f}" for value in values)


def _spread(values: Sequence[float]) -> float:
    return float(max(values) / min(values))


def _gain(category: str, summary: dict[str, dict[str, float]]) -> str:
    """How much lower two masks are than one, here and in the paper."""
    theirs = f", paper {_percent(VIEWS[category][2] / VIEWS[category][1])}" if category in VIEWS else ""
    return f" ({_percent(summary[category]['2'] / summary[category]['1'])}{theirs})"


def _percent(ratio: float) -> str:
    return f"{100.0 * (ratio - 1.0):+.0f} %"
