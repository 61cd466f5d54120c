"""Where `tso train` does otherwise than the paper or its authors' code, and what their way changes: supervision with masks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .figures import CATEGORIES, chamfer_of, judged_categories
from .mean_shape import MEAN_SHAPE
from .trained import Setting

NAME, STEPS = "departures", 1000
REDUCED, FULL = ("chair",), CATEGORIES
AS_IS = "masks, objects' own axes"
SEEDS = 3
AGAIN = f"{AS_IS}, again"
"""Beside three seeds the first of them again: how far apart numbers are for no reason."""
RELU, UNBOUNDED, WHOLE = "ReLU on the latent", "no penalty beyond the crop", "whole pictures"
VIEW = "view frame"
NARROW = "sigma^2 0.1"
WHY = {
    RELU: ("a ReLU behind it (code; the supplement's table names none)", "none; `tso train` has the layers of the table"),
    UNBOUNDED: ("nothing", "points beyond the crop pay their distance to it: no pixel speaks against them"),
    WHOLE: ("whole 64x64 pictures, which show an object's size", "the object cut out, longest side 1; `--crop-share 0`"),
    VIEW: ("the objects' own axes", "those of the input camera, which a user's photo has; `--frame`"),
    NARROW: ("sigma^2 0.1 for aeroplanes alone, 0.4 for the rest", "0.4; `--sigma-sq`, `--category-sigma-sq airplane=0.1`"),
}
"""Setting -> what the paper or its code has, and what `tso train` does and why."""


def settings(categories: Sequence[str]) -> list[Setting]:
    """For each category a network as `tso train` makes it, several times, and with one thing done the other way at a time."""
    found = []
    masks = {"supervision": "masks"}
    for category in categories:
        found.append(Setting(MEAN_SHAPE, category, constant=True))
        found += [Setting(_seeded(repeat), category, masks, repeat=repeat) for repeat in range(SEEDS)]
        found += [
            Setting(AGAIN, category, masks),
            Setting(RELU, category, masks, latent_relu=True),
            Setting(UNBOUNDED, category, masks, bounded=False),
            Setting(WHOLE, category, masks, whole=True),
            Setting(VIEW, category, {**masks, "frame": "view"}),
            Setting(NARROW, category, {**masks, "sigma_sq": 0.1}),
        ]
    return found


def conclude(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Chamfer of each setting by category; of `AS_IS` the mean and each of its trainings."""
    categories = judged_categories(runs)
    summary: dict[str, dict[str, Any]] = {
        MEAN_SHAPE: {category: chamfer_of(runs, MEAN_SHAPE, category) for category in categories}
    }
    alike = [*(_seeded(repeat) for repeat in range(SEEDS)), AGAIN]
    own = {category: [chamfer_of(runs, name, category) for name in alike] for category in categories}
    summary[AS_IS] = {category: float(np.mean([v for v in values if v is not None])) for category, values in own.items()}
    summary |= {name: {category: chamfer_of(runs, name, category) for category in categories} for name in WHY}
    summary = {name: {"mean": float(np.mean(list(values.values()))), **values} for name, values in summary.items()}
    return {"summary": summary, "base": AS_IS, "seeds": own, "why": WHY, "paper": {}, "claims": []}


def _seeded(repeat: int) -> str:
    return AS_IS + (f", seed + {repeat}" if repeat else "")
