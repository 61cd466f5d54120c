"""How good a cloud is, against a target cloud or a mask. Exact, in float64, on the CPU.

Chamfer uses SQUARED distances, mean over points; forward is target -> prediction, backward prediction -> target.
Nothing is centred or scaled here: `tso_cli.geometry.points.normalise_longest_side` does that for protocols which ask for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..geometry.points import Array, as_points, bounding_box_normalisation

# The cost matrix of an assignment holds N^2 numbers, and solving it takes about N^3 steps.
EMD_LIMIT = 5000
# Share of the target's longest side.
F_SCORE_SHARE = 0.01


@dataclass(frozen=True)
class Chamfer:
    """Mean squared distances to the nearest point, in squared units of the clouds."""

    forward: float  # target -> prediction: what the prediction fails to cover
    backward: float  # prediction -> target: what it has too much of

    @property
    def chamfer(self) -> float:
        """The sum of both directions."""
        return self.forward + self.backward


@dataclass(frozen=True)
class FScore:
    """Shares in [0, 1] of points that have a counterpart nearer than ``threshold`` (in units of the clouds)."""

    precision: float  # of the prediction's points
    recall: float  # of the target's points
    threshold: float

    @property
    def f_score(self) -> float:
        """Harmonic mean of precision and recall; 0 where both are 0."""
        total = self.precision + self.recall
        return 2.0 * self.precision * self.recall / total if total > 0.0 else 0.0


def nearest_squared(queries: Array, data: Array) -> Array:
    """Squared distance [Q] from each of ``queries`` [Q, 3] to the nearest of ``data`` [N, 3]."""
    from scipy.spatial import cKDTree

    _, index = cKDTree(data).query(queries)
    # From the coordinates again: squaring the tree's square root would round twice.
    return np.square(queries - data[index]).sum(1)


def chamfer(prediction: ArrayLike, target: ArrayLike) -> Chamfer:
    """Chamfer distance, squared distances, mean over points.

    Parameters
    ----------
    prediction : [N, 3]
    target : [M, 3], in the unit of the prediction.

    Returns
    -------
    Chamfer
        Both directions and their sum. Counts may differ, points may coincide; a single point on either side is allowed.

    Raises
    ------
    InputError
        A cloud is empty, is not [N, 3] or holds a number that is not finite.
    """
    ours, theirs = as_points(prediction, "prediction"), as_points(target, "target")
    return Chamfer(float(nearest_squared(theirs, ours).mean()), float(nearest_squared(ours, theirs).mean()))


def f_score(prediction: ArrayLike, target: ArrayLike, threshold: float | None = None) -> FScore:
    """F-score at a distance: how much of each cloud lies nearer than ``threshold`` to the other.

    Parameters
    ----------
    prediction : [N, 3]
    target : [M, 3], in the unit of the prediction.
    threshold : distance in that unit, > 0, or None: 1 % of the longest side of the target's bounding box.

    Returns
    -------
    FScore
        1 for equal clouds, 0 where no point has a counterpart. The bound itself is outside (distance < threshold).

    Raises
    ------
    InputError
        As for `chamfer`; ``threshold`` is not a finite number > 0; or it is None and all target points are equal.
    """
    ours, theirs = as_points(prediction, "prediction"), as_points(target, "target")
    if threshold is None:
        threshold = F_SCORE_SHARE * bounding_box_normalisation(theirs, "target")[1]
    if not 0.0 < threshold < np.inf:
        raise InputError(f"F-score threshold is {threshold:g}, expected a distance > 0")
    precision = np.sqrt(nearest_squared(ours, theirs)) < threshold
    recall = np.sqrt(nearest_squared(theirs, ours)) < threshold
    return FScore(float(precision.mean()), float(recall.mean()), float(threshold))


def emd(prediction: ArrayLike, target: ArrayLike, squared: bool = False) -> float:
    """Earth mover's distance: mean distance of an optimal one-to-one assignment.

    Parameters
    ----------
    prediction, target : [N, 3] each, the same N, at most 5,000.
    squared : squared distances instead, in the cost that is minimised and in the mean.

    Returns
    -------
    float
        0 for equal clouds, whatever the order of their points.

    Raises
    ------
    InputError
        Counts differ or are too large for an exact answer, or as for `chamfer`.
    """
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    ours, theirs = as_points(prediction, "prediction"), as_points(target, "target")
    if len(ours) != len(theirs):
        raise InputError(
            f"EMD needs clouds of equal size, found {len(ours)} (prediction) and {len(theirs)} (target) points: "
            f"thin both with --points {min(len(ours), len(theirs), 1024)}"
        )
    if len(ours) > EMD_LIMIT:
        raise InputError(
            f"EMD of {len(ours)} points would take too long, expected at most {EMD_LIMIT}: thin both with --points 1024"
        )
    cost = cdist(ours, theirs, "sqeuclidean" if squared else "euclidean")
    if not np.isfinite(cost).all():
        raise InputError("EMD: the clouds are too far apart to measure in float64")
    return float(cost[linear_sum_assignment(cost)].mean())


def iou(silhouette: ArrayLike, mask: ArrayLike, known: NDArray[np.bool_] | None = None) -> float:
    """Intersection over union of a silhouette and a mask, foreground being > 0.5 in each.

    Parameters
    ----------
    silhouette, mask : [H, W] in [0, 1].
    known : [H, W] bool, False where the mask says nothing, or None when every pixel counts.

    Returns
    -------
    float
        In [0, 1]. 1 where both are empty (they agree); NaN where no pixel is known.

    Raises
    ------
    InputError
        The shapes differ.
    """
    ours, theirs = np.asarray(silhouette) > 0.5, np.asarray(mask) > 0.5
    counted = np.ones(theirs.shape, dtype=bool) if known is None else np.asarray(known, dtype=bool)
    if ours.ndim != 2 or not ours.shape == theirs.shape == counted.shape:
        shapes = ", ".join(str(list(a.shape)) for a in (ours, theirs, *(() if known is None else (counted,))))
        raise InputError(f"IoU needs images of one size [H, W], found {shapes}")
    if not counted.any():
        return float("nan")
    union = int(((ours | theirs) & counted).sum())
    return int((ours & theirs & counted).sum()) / union if union else 1.0
