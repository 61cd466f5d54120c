"""What the paper's studies measure of predicted clouds: outliers, sizes, errors in depth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.points import Array
from tso_cli.train.data import TrainingData

from ..study import Record
from .material import INPUT_VIEWS, Predicted

OUTLIER_PX = 1.0
"""A projected point further than this outside the mask of the 64x64 crop is an outlier."""
BODY = (0.08, 0.28)
"""Where, from the nose in lengths, an aeroplane has neither wing nor tail."""
FEWEST = 5
"""Points that show a size."""
ENDS = (5.0, 95.0)
"""Percentiles that a size is measured between."""


def outlier_shares(predicted: list[Predicted], data: TrainingData) -> Record:
    """Mean fraction of outliers in views that the network was not given, by category."""
    fractions: dict[str, list[float]] = {}
    for shape in predicted:
        numbers = range(INPUT_VIEWS, len(data.objects[shape.index].views))
        views = [data.prepared(shape.index, number) for number in numbers]
        for points in shape.points:
            shares = [outliers(view.camera.project(points)[0], view.mask).mean() for view in views]
            fractions.setdefault(shape.category, []).append(float(np.mean(shares)))
    return {"outliers": {category: float(np.mean(means)) for category, means in fractions.items()}}


def outliers(pixels: Array, mask: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which projected points [N, 2] (column, row) are over `OUTLIER_PX` outside the mask [H, W].

    Distances are from the edge of the mask, half a pixel beyond the centres of its pixels (> 0.5).
    A point that is not finite is an outlier.
    """
    finite = np.asarray(np.isfinite(pixels).all(1))
    inside = cKDTree(np.argwhere(mask > 0.5)[:, ::-1])
    distance, _ = inside.query(np.where(finite[:, None], pixels, 0.0))
    return np.asarray(~finite | (distance > OUTLIER_PX + 0.5))


def sizes(predicted: list[Predicted], data: TrainingData) -> Record:
    """Sizes of unseen aeroplanes (medians) and errors of unseen cars (means)."""
    planes, cars = [], []
    for shape in predicted:
        for view, (points, target) in enumerate(zip(shape.points, shape.target, strict=True)):
            if shape.category == "airplane":
                planes.append(aeroplane_sizes(points, target))
            if shape.category == "car":
                turn = data.objects[shape.index].views[view].camera.R.T
                cars.append(depth_errors(points @ turn, target @ turn))
    groups: dict[str, tuple[list[dict[str, float]], Any]]
    groups = {"aeroplanes": (planes, np.nanmedian), "cars": (cars, np.mean)}
    return {
        key: {name: float(average([row[name] for row in rows])) for name in rows[0]}
        for key, (rows, average) in groups.items()
        if rows
    }


def aeroplane_sizes(points: Array, target: Array) -> dict[str, float]:
    """Sizes of a predicted aeroplane [N, 3] over the true sizes [M, 3]: body, span, length.

    y is up. Of x and z, the axis across is the one in which the truth is more symmetric; the nose
    is at its narrower end. Sizes are from the 5th to the 95th percentile; the body's are taken
    between nose and wing. NaN where fewer than 5 points show one.
    """
    flips = {axis: target * (1.0 - 2.0 * np.eye(3)[axis]) for axis in (0, 2)}
    across = min(flips, key=lambda axis: chamfer(flips[axis], target).chamfer)
    along = 2 - across
    low, high = target[:, along].min(), target[:, along].max()
    place = (target[:, along] - low) / (high - low)
    nose_first = np.ptp(target[place < 0.2, across]) <= np.ptp(target[place > 0.8, across])

    def body(cloud: Array) -> Array:
        behind = (cloud[:, along] - low) / (high - low)
        behind = behind if nose_first else 1.0 - behind
        return cloud[(behind > BODY[0]) & (behind < BODY[1])]

    bodies = body(points), body(target)
    of_body = {"body_width": _ratio(*bodies, across), "body_height": _ratio(*bodies, 1)}
    whole = {"span": _ratio(points, target, across), "length": _ratio(points, target, along)}
    return of_body | whole


def depth_errors(points: Array, target: Array) -> dict[str, float]:
    """Errors of a prediction [N, 3] along and across the line of sight, in axes of the camera.

    ``depth`` and ``across`` are mean squares of the components of the vectors to the nearest
    points, both directions added, per axis; ``extent`` is predicted over true depth.
    """
    squares = np.zeros(3)
    for queries, cloud in ((points, target), (target, points)):
        squares += np.square(queries - cloud[cKDTree(cloud).query(queries)[1]]).mean(0)
    errors = {"depth": float(squares[2]), "across": float(squares[:2].mean())}
    return errors | {"extent": _ratio(points, target, 2)}


def _ratio(points: Array, target: Array, axis: int) -> float:
    if min(len(points), len(target)) < FEWEST:
        return float("nan")
    size, true = (float(np.diff(np.percentile(c[:, axis], ENDS))[0]) for c in (points, target))
    return size / true if true > 0.0 else float("nan")
