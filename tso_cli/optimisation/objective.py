"""Losses of a cloud by its views: functions of points [N, 3] that return value and gradient.

A mask on its way to a loss is a `View` (pixels of the image), a `ResampledView` (cells of the
window around the object), a `MaskTarget` (what the loss looks up in the cells), and a `ViewTarget`
(the mask's and the depth map's targets with their camera and weight).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..geometry.arrays import Array
from ..geometry.camera import Camera
from ..losses.depth import DepthTarget, depth_loss
from ..losses.mask_chamfer import (
    REFERENCE_POINTS,
    MaskTarget,
    mask_chamfer,
    resolved_share,
)
from ..losses.nearest import nearest_few
from ..losses.projection import project_differentiably
from ..losses.silhouette import silhouette_bce
from .resampled_view import ResampledView

# Nearest points that are the part of a cloud around a point.
PART = 24


@dataclass(frozen=True, eq=False)
class SilhouetteObjective:
    """Weighted sum over views of the silhouette's cross-entropy (Eq. 4).

    It is infinite where a view shows no point.
    """

    views: Sequence[ResampledView]
    weights: Sequence[float]

    def __call__(self, points: Array) -> tuple[float, Array]:
        total, gradient = 0.0, np.zeros_like(points)
        for weight, view in zip(self.weights, self.views, strict=True):
            value, by_points = silhouette_loss(points, view, view.camera)
            total, gradient = total + weight * value, gradient + weight * by_points
        return total, gradient


def silhouette_loss(points: Array, view: ResampledView, camera: Camera) -> tuple[float, Array]:
    """The cross-entropy by one view, and its gradient [N, 3]."""
    projected = project_differentiably(points, camera)
    # Without a visible point there is no gradient: a cloud behind the camera would be perfect.
    if not projected.valid.any():
        return np.inf, np.zeros_like(points)
    value, gradient_px = silhouette_bce(
        projected.points_px, projected.valid, *view.pixel_weights, view.sigma_sq
    )
    return value, projected.pull_back(gradient_px)


@dataclass(frozen=True, eq=False)
class ViewTarget:
    """A view's mask and depth map, prepared for the losses, and the weight of the view's loss.

    ``resolved`` [N] is how far the mask resolves the part around each point; None for fully.
    """

    camera: Camera
    mask: MaskTarget
    depth: DepthTarget | None
    weight: float
    resolved: Array | None = None

    @classmethod
    def of(cls, view: ResampledView, weight: float) -> ViewTarget:
        depth = None
        if view.depth is not None:
            depth = DepthTarget.of(view.depth, view.target.inside, view.camera)
        return cls(view.camera, view.target, depth, weight)

    def loss(self, points: Array) -> tuple[float, Array]:
        """The losses of mask and depth map, without the view's weight, and their gradient."""
        projected = project_differentiably(points, self.camera)
        value, by_pixels = mask_chamfer(
            projected.points_px, projected.valid, self.mask, self.resolved
        )
        gradient = projected.pull_back(by_pixels)
        if self.depth is not None:
            more, further = depth_loss(points, projected, self.depth)
            value, gradient = value + more, gradient + further
        return value, gradient


@dataclass(frozen=True, eq=False)
class ViewTargets:
    """The targets of all views of a cloud."""

    views: tuple[ViewTarget, ...]

    @classmethod
    def of(cls, views: Sequence[ResampledView], weights: Sequence[float]) -> ViewTargets:
        return cls(
            tuple(ViewTarget.of(view, weight) for view, weight in zip(views, weights, strict=True))
        )

    @cached_property
    def pixels(self) -> float:
        """Foreground pixels and known depths of all views, times their weights, in pixels of 64."""
        return sum(
            view.weight * (view.mask.pixels + (view.depth.pixels if view.depth else 0.0))
            for view in self.views
        )

    def resolving(self, points: Array) -> ViewTargets:
        """The same, where parts of a cloud [N, 3] count as far as each mask resolves them."""
        near = nearest_few(points, points, min(PART, len(points)))

        def resolved(view: ViewTarget) -> ViewTarget:
            parts = project_differentiably(points, view.camera).points_px[near]
            share = resolved_share(parts, view.mask.cells_per_mask_pixel)
            return replace(view, resolved=share)

        return ViewTargets(tuple(map(resolved, self.views)))

    def loss(self, points: Array) -> tuple[float, Array]:
        """Weighted sum over views of `mask_chamfer` and, where there are maps, of `depth_loss`.

        Its gradient [N, 3] too. The sum is infinite where a view whose weight is not 0 shows no
        point.
        """
        total, gradient = 0.0, np.zeros_like(points)
        for view in self.views:
            if view.weight:
                value, by_points = view.loss(points)
                total, gradient = total + view.weight * value, gradient + view.weight * by_points
        return total, gradient


@dataclass(frozen=True, eq=False)
class PositionPrior:
    """What it costs the points of a cloud to leave ``initial`` [N, 3].

    ``weight`` is of squared distances, for a cloud of 1,024 points.
    """

    initial: Array
    weight: float

    def __call__(self, points: Array) -> tuple[float, Array]:
        shift, weight = points - self.initial, self.weight * REFERENCE_POINTS / len(points)
        return weight * float(np.square(shift).sum()), 2.0 * weight * shift
