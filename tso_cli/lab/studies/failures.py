"""The paper's two failures: aeroplanes too narrow under a shared sigma^2, cars deformed in depth under one mask."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...errors import InputError
from ...evaluation.metrics import chamfer
from ...geometry.points import Array
from ...train.data import TrainingData
from ..packing import pack
from .figures import CATEGORIES, SIGMA_SQ, chamfer_of, claim
from .judging import Predicted, camera_axes, object_axes
from .material import ALL
from .trained import Setting

NAME, STEPS = "failures", 900
REDUCED, FULL = CATEGORIES, CATEGORIES
PLANE, CAR = "airplane", "car"
SHARED, OWN = "all categories, sigma^2 0.4", "all categories, sigma^2 0.1 for aeroplanes"
ALONE_WIDE, ALONE = "aeroplanes alone, sigma^2 0.4", "aeroplanes alone, sigma^2 0.1"
ONE, FOUR = "one mask", "four masks"
# The part of the length, from the nose, where there is neither wing nor tail; and fewer points than this show no width.
NOSE, FEWEST = (0.08, 0.28), 5
SPREAD = (5.0, 95.0)
RIGHT = 0.95
"""A size over this share of another is not told apart from it."""
SHOWN_STEP = 1.0 / 16_384.0


def settings(categories: Sequence[str]) -> list[Setting]:
    """Networks of aeroplanes, alone and among the others, under both kernels; of cars under one and four masks.

    Raises InputError if neither is among ``categories``.
    """
    if not {PLANE, CAR} & set(categories):
        raise InputError(f"the failures are of {PLANE} and {CAR}, found {', '.join(categories)}, expected one of the two")
    found = []
    masks = {"supervision": "masks"}
    if PLANE in categories:
        own = {**masks, "sigma_sq": SIGMA_SQ[PLANE]}
        if len(categories) > 1:
            by_category = {**masks, "category_sigma_sq": {PLANE: SIGMA_SQ[PLANE]}}
            found += [Setting(SHARED, ALL, masks), Setting(OWN, ALL, by_category)]
        found += [Setting(ALONE_WIDE, PLANE, masks), Setting(ALONE, PLANE, own)]
    if CAR in categories:
        found += [Setting(ONE, CAR, {**masks, "views": 1}), Setting(FOUR, CAR, {**masks, "views": 4})]
    return found


def measure(predicted: list[Predicted], data: TrainingData) -> dict[str, Any]:
    """Sizes of unseen aeroplanes and errors in depth of unseen cars; and the clouds of one of each for a picture."""
    planes, cars = [], []
    found: dict[str, Any] = {"clouds": {}}
    for shape in predicted:
        for view, pair in enumerate(zip(shape.points, shape.target, strict=True)):
            camera = data.objects[shape.index].views[view].camera
            if shape.category == PLANE:
                points, target = (object_axes(cloud, camera, shape.frame) for cloud in pair)
                planes.append(aeroplane_sizes(points, target))
            elif shape.category == CAR:
                points, target = (camera_axes(cloud, camera, shape.frame) for cloud in pair)
                cars.append(depth_errors(points, target))
            else:
                continue
            if shape.category not in found["clouds"]:
                shown = {"points": pack(points, SHOWN_STEP), "target": pack(target, SHOWN_STEP)}
                found["clouds"][shape.category] = {"shape": shape.name, **shown}
    if planes:
        found["aeroplanes"] = {key: float(np.nanmedian([sizes[key] for sizes in planes])) for key in planes[0]}
    if cars:
        found["cars"] = {key: float(np.mean([errors[key] for errors in cars])) for key in cars[0]}
    return found


def aeroplane_sizes(points: Array, target: Array) -> dict[str, float]:
    """Sizes of a predicted aeroplane [N, 3] over those of the true one [M, 3]: body width, body height, wing span, length.

    y is up. The truth decides which of x and z goes across (its mirror image in that axis is the nearer one) and at which end
    the nose is (it is narrower than the tail). Sizes are from the 5th to the 95th percentile, those of the body between 8 and
    28 % of the length from the nose. NaN where fewer than 5 points show one.
    """
    across = min((0, 2), key=lambda axis: chamfer(target * np.where(np.arange(3) == axis, -1.0, 1.0), target).chamfer)
    along = 2 - across
    low, high = target[:, along].min(), target[:, along].max()
    place = (target[:, along] - low) / (high - low)
    ends = [target[place < 0.2, across], target[place > 0.8, across]]
    nose_first = np.ptp(ends[0]) <= np.ptp(ends[1])

    def body(cloud: Array) -> Array:
        share = (cloud[:, along] - low) / (high - low)
        share = share if nose_first else 1.0 - share
        return cloud[(share > NOSE[0]) & (share < NOSE[1])]

    ours, true = body(points), body(target)
    return {
        "body_width": _ratio(ours[:, across], true[:, across]),
        "body_height": _ratio(ours[:, 1], true[:, 1]),
        "span": _ratio(points[:, across], target[:, across]),
        "length": _ratio(points[:, along], target[:, along]),
    }


def depth_errors(points: Array, target: Array) -> dict[str, float]:
    """How far a prediction [N, 3] errs along and across the line of sight; both clouds in camera axes (z away from it).

    ``depth`` and ``across`` are mean squares of the components of the vectors to the nearest points, in both directions
    summed, per axis; ``extent`` is the depth of the prediction over that of the truth (5th to 95th percentile).
    """
    from scipy.spatial import cKDTree

    squares = np.zeros(3)
    for one, other in ((points, target), (target, points)):
        squares += np.square(one - other[cKDTree(other).query(one)[1]]).mean(0)
    return {
        "depth": float(squares[2]),
        "across": float(squares[:2].mean()),
        "extent": _ratio(points[:, 2], target[:, 2]),
    }


def conclude(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """The sizes and errors of every network, and whether the failures show here."""
    summary: dict[str, Any] = {}
    for run in runs:
        category = CAR if run["setting"] in (ONE, FOUR) else PLANE
        own = run.get("cars" if category == CAR else "aeroplanes", {})
        summary[run["setting"]] = {**own, "chamfer": chamfer_of(runs, run["setting"], category)}
    claims = []
    for wide, narrow, where in ((SHARED, OWN, "trained with other categories"), (ALONE_WIDE, ALONE, "trained alone")):
        if wide in summary and narrow in summary:
            one, other = summary[wide]["body_width"], summary[narrow]["body_width"]
            found = f"body width {one:.2f} of the true one under 0.4, {other:.2f} under 0.1"
            span = f"wing span {summary[wide]['span']:.2f} and {summary[narrow]['span']:.2f}"
            claims += [
                claim(f"aeroplanes {where} have too narrow a body under sigma^2 = 0.4", one < RIGHT, found),
                claim(f"aeroplanes {where} have a wider body under sigma^2 = 0.1", one < RIGHT * other, f"{found}; {span}"),
            ]
    if ONE in summary and FOUR in summary:
        depth, across = (summary[ONE][key] / summary[FOUR][key] for key in ("depth", "across"))
        claims.append(
            claim(
                "cars trained with one mask are deformed in depth, more than across, and more masks correct it",
                depth > 1.0 and depth > across,
                f"squared error in depth {depth:.2f} times that with four masks, across {across:.2f} times; "
                f"extent in depth {summary[ONE]['extent']:.2f} and {summary[FOUR]['extent']:.2f} of the true one",
            )
        )
    return {"summary": summary, "paper": {}, "claims": claims}


def _ratio(ours: Array, true: Array) -> float:
    if min(len(ours), len(true)) < FEWEST:
        return float("nan")
    sizes = [float(np.diff(np.percentile(values, SPREAD))[0]) for values in (ours, true)]
    return sizes[0] / sizes[1] if sizes[1] > 0.0 else float("nan")
