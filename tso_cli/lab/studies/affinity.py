"""Does the affinity loss remove outliers?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry.points import Array
from ...train.data import TrainingData
from ..packing import pack
from .figures import CATEGORIES, chamfer_of, claim, judged_categories, sigma_sq
from .judging import JUDGED_VIEWS, Predicted, object_axes
from .trained import Setting

NAME, STEPS = "affinity", 500
REDUCED, FULL = CATEGORIES, CATEGORIES
WITHOUT = "without"
# Each form at the weight that the study `lambda` finds good for it: as printed, the loss breaks down at 1.
FORMS = {"points": 1.0, "paper": 0.1}
OUTLIER_PX = 1.0
"""A projected point further than this from the mask, in pixels of the 64x64 crop, is an outlier."""
SHOWN = 1
"""Shapes of each category that the picture shows."""


def settings(categories: Sequence[str]) -> list[Setting]:
    """For each category a network without the loss and one with each form of it."""
    found = []
    for category in categories:
        masks = {"supervision": "masks", "sigma_sq": sigma_sq(category)}
        found.append(Setting(WITHOUT, category, {**masks, "affinity_weight": 0.0}))
        for form, weight in FORMS.items():
            found.append(Setting(_name(form), category, {**masks, "affinity_weight": weight, "affinity": form}))
    return found


def measure(predicted: list[Predicted], data: TrainingData) -> dict[str, Any]:
    """Share of outliers in views that the network was not given, by category; and what a picture of it needs."""
    shares: dict[str, list[float]] = {}
    pictures: list[dict[str, Any]] = []
    for shape in predicted:
        item = data.objects[shape.index]
        unseen = [data.prepared(shape.index, view) for view in range(JUDGED_VIEWS, len(item.views))]
        for number, cloud in enumerate(shape.points):
            points = object_axes(cloud, item.views[number].camera, shape.frame)
            pixels = [view.camera.project(points)[0] for view in unseen]
            found = [outliers(own, view.mask) for own, view in zip(pixels, unseen, strict=True)]
            shares.setdefault(shape.category, []).append(float(np.mean([own.mean() for own in found])))
            if number == 0 and sum(picture["category"] == shape.category for picture in pictures) < SHOWN:
                pictures.append(
                    {
                        "shape": shape.name,
                        "category": shape.category,
                        "points_px": pack(pixels[0], 1.0 / 32.0),
                        "outliers": pack(found[0], 1.0),
                        "mask": pack(unseen[0].mask, 1.0 / 255.0),
                    }
                )
    return {"outliers": {category: float(np.mean(values)) for category, values in shares.items()}, "pictures": pictures}


def outliers(pixels: Array, mask: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which of the projected points [N, 2] (column, row) lie further than `OUTLIER_PX` outside the mask (> 0.5) [H, W].

    A mask reaches half a pixel beyond the centres of its pixels. What falls outside the picture counts by the same distance.
    """
    from scipy.spatial import cKDTree

    rows, columns = np.nonzero(mask > 0.5)
    finite = np.asarray(np.isfinite(pixels).all(1))
    distance, _ = cKDTree(np.stack([columns, rows], axis=1)).query(np.where(finite[:, None], pixels, 0.0))
    return np.asarray(~finite | (distance > OUTLIER_PX + 0.5))


def conclude(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Outliers and Chamfer by category, with and without; and whether the loss lowers both."""
    categories = judged_categories(runs)
    share = {run["setting"]: {} for run in runs}  # type: dict[str, dict[str, float]]
    for run in runs:
        share[run["setting"]].update(run["outliers"])
    summary = {
        name: {
            category: {"outliers": share[name][category], "chamfer": chamfer_of(runs, name, category)}
            for category in categories
        }
        for name in share
    }
    claims = []
    for form in FORMS:
        for key, text in (("outliers", "has fewer outliers"), ("chamfer", "has a lower Chamfer distance")):
            before = {category: float(summary[WITHOUT][category][key] or 0.0) for category in categories}
            after = {category: float(summary[_name(form)][category][key] or 0.0) for category in categories}
            scale, unit = (100.0, " %") if key == "outliers" else (1.0, "")
            claims.append(
                claim(
                    f"a network trained with the affinity loss ({_name(form)}) {text}",
                    all(after[category] < before[category] for category in categories),
                    ", ".join(
                        f"{name} {scale * before[name]:.2f}{unit} to {scale * after[name]:.2f}{unit}" for name in categories
                    ),
                )
            )
    return {"summary": summary, "paper": {}, "claims": claims}


def _name(form: str) -> str:
    return f"{form}, lambda = {FORMS[form]:g}"
