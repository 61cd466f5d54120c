"""What the paper says of networks that it trained, and how a study compares with it. Chamfer x1000, the paper's protocol."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

CATEGORIES = ("airplane", "car", "chair")
SIGMA_SQ = {"airplane": 0.1, "car": 0.4, "chair": 0.4}
"""The paper's sigma^2 where a network sees one category; 0.4 where it sees all."""
SUPERVISION = {
    "3D points": {"airplane": 1.36, "car": 1.40, "chair": 3.98},
    "masks": {"airplane": 2.00, "car": 1.65, "chair": 4.42},
    "depth maps, Lin et al.": {"airplane": 2.01, "car": 2.50, "chair": 6.35},
    "3D points, all categories": {"airplane": 1.33, "car": 1.41, "chair": 3.94},
    "masks, all categories": {"airplane": 2.57, "car": 1.74, "chair": 5.09},
}
VIEWS = {
    "airplane": {1: 2.40, 2: 2.02, 3: 2.0, 4: 2.0, 5: 1.98, 6: 1.99, 8: 2.01},
    "car": {1: 3.47, 2: 1.68, 3: 1.65, 4: 1.65, 5: 1.68, 6: 1.65, 8: 1.68},
    "chair": {1: 4.53, 2: 4.41, 3: 4.35, 4: 4.36, 5: 4.43, 6: 4.42, 8: 4.56},
}
LAMBDA = {0.5e-4: 4.63, 1e-4: 4.42, 5e-4: 5.3}
"""The supplement states lambda scaled by 1e4."""


def sigma_sq(category: str) -> float:
    """The paper's sigma^2 for a network of one category; 0.4 for those it does not name."""
    return SIGMA_SQ.get(category, 0.4)


def chamfer_of(runs: Sequence[dict[str, Any]], setting: str, category: str, protocol: str = "capnet") -> float | None:
    """Chamfer distance x1000 on ``category`` of the network of ``setting``, None where there is none."""
    for run in runs:
        if run["setting"] == setting and category in run["judged"]:
            return float(1e3 * run["judged"][category][protocol]["chamfer"])
    return None


def mean_of(runs: Sequence[dict[str, Any]], setting: str, categories: Sequence[str]) -> float:
    """The mean of `chamfer_of` over categories; NaN where one is missing."""
    values = [chamfer_of(runs, setting, category) for category in categories]
    return float(np.mean([np.nan if value is None else value for value in values]))


def claim(text: str, holds: bool, found: str) -> dict[str, Any]:
    """One line of the answer: what the paper says, whether it holds here, and by which figures."""
    return {"claim": text, "holds": bool(holds), "found": found}


def judged_categories(runs: Sequence[dict[str, Any]]) -> list[str]:
    """Categories that some network was judged on, in the order of the runs."""
    return list(dict.fromkeys(category for run in runs for category in run["judged"]))
