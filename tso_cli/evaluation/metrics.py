"""Metrics that compare a cloud with a target cloud or a mask; exact, in float64, on the CPU.

The Chamfer distance uses SQUARED distances, mean over points; forward is target -> prediction,
backward prediction -> target. Nothing is centred or scaled here;
`tso_cli.geometry.points.normalise_longest_side` does this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..geometry.arrays import Array
from ..geometry.points import as_points, bounding_box_normalisation

# Most points for EMD: the cost matrix of an assignment holds N^2 numbers, and solving it takes
# about N^3 steps.
EMD_LIMIT = 5000
# Threshold of the F-score, in longest sides of the target.
F_SCORE_SHARE = 0.01


@dataclass(frozen=True)
class Chamfer:
    """Mean squared distances to the nearest point, in squared units of the clouds."""

    forward: float  # target -> prediction: what the prediction fails to cover
    backward: float  # prediction -> target: outliers of the prediction

    @property
    def chamfer(self) -> float:
        """The sum of both directions."""
        return self.forward + self.backward


@dataclass(frozen=True)
class FScore:
    """Fractions of points that are closer than ``threshold`` to the other cloud."""

    precision: float  # of the prediction's points
    recall: float  # of the target's points
    threshold: float  # in units of the clouds

    @property
    def f_score(self) -> float:
        """Harmonic mean of precision and recall; 0 if both are 0."""
        total = self.precision + self.recall
        return 2.0 * self.precision * self.recall / total if total > 0.0 else 0.0


def nearest_squared(queries: Array, data: Array) -> Array:
    """Squared distance [Q] from each of ``queries`` [Q, 3] to the nearest of ``data`` [N, 3]."""
    from scipy.spatial import cKDTree

    _, index = cKDTree(data).query(queries)
    # The squares of the tree's distances would be rounded twice.
    return np.square(queries - data[index]).sum(1)


def chamfer(prediction: ArrayLike, target: ArrayLike) -> Chamfer:
    """Chamfer distance of ``prediction`` [N, 3] and ``target`` [M, 3].

    Raises InputError for a cloud that is empty or not finite.
    """
    prediction, target = as_points(prediction, "prediction"), as_points(target, "target")
    forward = nearest_squared(target, prediction).mean()
    backward = nearest_squared(prediction, target).mean()
    return Chamfer(float(forward), float(backward))


def f_score(prediction: ArrayLike, target: ArrayLike, threshold: float | None = None) -> FScore:
    """F-score at a distance (Knapitsch et al., "Tanks and Temples", 2017); clouds as in `chamfer`.

    A point counts if it is closer than ``threshold`` to the other cloud; by default 1 % of the
    longest side of the target's bounding box.
    """
    prediction, target = as_points(prediction, "prediction"), as_points(target, "target")
    if threshold is None:
        threshold = F_SCORE_SHARE * bounding_box_normalisation(target, "target")[1]
    precision = np.sqrt(nearest_squared(prediction, target)) < threshold
    recall = np.sqrt(nearest_squared(target, prediction)) < threshold
    return FScore(float(precision.mean()), float(recall.mean()), float(threshold))


def emd(prediction: ArrayLike, target: ArrayLike, squared: bool = False) -> float:
    """Earth mover's distance of two clouds [N, 3].

    It is the mean (``squared``) distance under the optimal one-to-one assignment. Raises InputError
    as `chamfer` does, and if the clouds differ in size or have over 5,000 points.
    """
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    prediction, target = as_points(prediction, "prediction"), as_points(target, "target")
    if len(prediction) != len(target):
        raise InputError(
            f"EMD: found {len(prediction)} (prediction) and {len(target)} (target) points, "
            "expected clouds of equal size: thin both (`points` "
            f"{min(len(prediction), len(target), 1024)})"
        )
    if len(prediction) > EMD_LIMIT:
        raise InputError(
            f"EMD of {len(prediction)} points would take too long, expected at most {EMD_LIMIT}: "
            "thin both (`points` 1024)"
        )
    cost = cdist(prediction, target, "sqeuclidean" if squared else "euclidean")
    return float(cost[linear_sum_assignment(cost)].mean())


def iou(silhouette: ArrayLike, mask: ArrayLike, known: NDArray[np.bool_] | None = None) -> float:
    """Intersection over union of two images [H, W], whose foreground is > 0.5.

    Only ``known`` [H, W] pixels count (None: all). The IoU is 1 if both images are empty, and NaN
    if no pixel is known.
    """
    foreground, expected = np.asarray(silhouette) > 0.5, np.asarray(mask) > 0.5
    if known is not None:
        known = np.asarray(known, dtype=bool)
        foreground, expected = foreground & known, expected & known
    if not (expected.size if known is None else known.any()):
        return float("nan")
    union = int((foreground | expected).sum())
    return int((foreground & expected).sum()) / union if union else 1.0
