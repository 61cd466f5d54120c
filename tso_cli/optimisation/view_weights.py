"""Weights of several views: a view that the others contradict has a lower weight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.arrays import Array
from .objective import silhouette_loss
from .resampled_view import ResampledView

# With fewer views, none can be called the outlier.
FEWEST_VIEWS_TO_OUTVOTE = 3
# The next three were chosen on validation shapes with none or one of four views wrong.
# A loss up to this multiple of the median is tolerated ...
TOLERATED_LOSS = 1.5
# ... and so is any loss of a view whose gradient has this mean cosine with the others' gradients.
TOLERATED_COSINE = 0.1
# How steeply the weight falls beyond.
STEEPNESS = 4.0


def weights_of(views: Sequence[ResampledView], points: Array) -> list[float]:
    """`inlier_weights` of views, from the silhouettes of normalised ``points`` [N, 3]."""
    if len(views) < FEWEST_VIEWS_TO_OUTVOTE:
        return [1.0] * len(views)
    losses = [silhouette_loss(points, view, view.camera) for view in views]
    comparable = [
        value / view.magnification for (value, _), view in zip(losses, views, strict=True)
    ]
    gradients = [gradient.ravel() for _, gradient in losses]
    weights: list[float] = inlier_weights(np.array(comparable), np.array(gradients)).tolist()
    return weights


def inlier_weights(losses: Array, gradients: Array) -> Array:
    """Weights [V] of views. Some may show another object or have a wrong camera.

    A wrong view has a high loss, and a gradient that disagrees with the gradients of the other
    views. A high loss alone is no sign: where the cloud is wrong in depth, only a view from the
    side shows it, and its gradient leaves the other silhouettes as they are.

    Let q be the loss over the median of the losses, and c the mean cosine between the gradient and
    the other gradients, clamped to [0, 0.1]. The weight is min(1, 1.5 / q)^(4 (1 - c / 0.1)).

    ``losses`` [V], V >= 3, are comparable between views. ``gradients`` [V, D] are by the points.
    """
    ratio = losses / np.median(losses)
    unit = gradients / np.maximum(np.linalg.norm(gradients, axis=1, keepdims=True), 1e-12)
    cosine = ((unit * unit.sum(0)).sum(1) - 1.0) / (len(losses) - 1)
    disagreement = 1.0 - np.clip(cosine / TOLERATED_COSINE, 0.0, 1.0)
    weights: Array = (TOLERATED_LOSS / np.maximum(ratio, TOLERATED_LOSS)) ** (
        STEEPNESS * disagreement
    )
    return weights
