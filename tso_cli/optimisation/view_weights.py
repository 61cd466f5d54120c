"""Weights of several views.

A view that the others contradict has a lower weight. Views of the same side share their weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import Array, Bits
from ..geometry.camera import Camera
from ..losses.projection import pixels_under, project_differentiably
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
# Power of the cosine between viewing directions in the redundancy of two views.
REDUNDANCY_POWER = 8
TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class ViewWeights:
    """Weights of V views.

    ``inlier`` is under 1 for a view that the other views contradict (`inlier_weights`). ``loss``
    weighs the views' losses: the inlier weights, divided among redundant views (`shared_weights`).
    """

    inlier: list[float]
    loss: list[float]

    @classmethod
    def even(cls, views: int) -> ViewWeights:
        return cls([1.0] * views, [1.0] * views)

    @classmethod
    def of(cls, views: Sequence[ResampledView], points: Array) -> ViewWeights:
        """From the silhouettes of normalised ``points`` [N, 3]."""
        if len(views) == 1:
            return cls.even(1)
        inlier = np.ones(len(views))
        if len(views) >= FEWEST_VIEWS_TO_OUTVOTE:
            losses = [silhouette_loss(points, view, view.camera) for view in views]
            comparable = np.array(
                [value / view.magnification for (value, _), view in zip(losses, views, strict=True)]
            )
            inlier = inlier_weights(
                comparable, np.array([gradient.ravel() for _, gradient in losses])
            )
        return cls(inlier.tolist(), shared_weights(inlier, _redundancy(views, points)).tolist())


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


def shared_weights(inlier: Array, redundancy: Array) -> Array:
    """Loss weights [V]: redundant views together count as much as the most trusted of them.

    ``redundancy`` [V, V] in [0, 1] is the share of view v's content that view u has too.
    """
    others = redundancy * inlier
    shared: Array = inlier * others.max(1) / np.maximum(others.sum(1), TINY)
    return shared


def _redundancy(views: Sequence[ResampledView], points: Array) -> Array:
    """[V, V]: |cos|^8 of the angle between two cameras, times the share of points seen by both.

    Silhouettes from opposite sides are the same, flipped; surfaces and colours are not.
    """
    directions = np.stack([_direction_to(view.camera) for view in views])
    cosine = directions @ directions.T
    one_sided = np.array([view.depth is not None or view.image is not None for view in views])
    cosine = np.where(one_sided[:, None] & one_sided, np.maximum(cosine, 0.0), cosine)
    seen = np.stack([_seen(view, points) for view in views]).astype(float)  # [V, N]
    common = seen @ seen.T / np.maximum(seen.sum(1, keepdims=True), 1.0)
    redundancy: Array = np.abs(cosine) ** REDUNDANCY_POWER * common
    # A view that sees no point is redundant with itself all the same.
    np.fill_diagonal(redundancy, 1.0)
    return redundancy


def _seen(view: ResampledView, points: Array) -> Bits:
    """[N] which points fall on known pixels of the view."""
    projected = project_differentiably(points, view.camera)
    pixel, within = pixels_under(projected.points_px, projected.valid, *view.mask.shape)
    return within if view.known is None else within & (view.known.ravel()[pixel] >= 0.5)


def _direction_to(camera: Camera) -> Array:
    """Unit vector from the origin to a camera."""
    vector: Array = -camera.R[2] if camera.model != "perspective" else camera.position
    return vector / max(float(np.linalg.norm(vector)), 1e-9)
