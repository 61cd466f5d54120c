"""Losses of a cloud by its views: functions of points [N, 3] that return value and gradient.

A mask on its way to a loss is a `View` (pixels of the image), a `ResampledView` (cells of the
window around the object), a `MaskTarget` (what the loss looks up in the cells), a `ViewTarget`
(the mask's and the depth map's targets with their camera and weight), and, where the work is worth
it, a `CompiledView` (the same as contiguous arrays for the compiled loop).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..cloud.smooth_field import SmoothField
from ..geometry.arrays import Array
from ..geometry.camera import NEAR, Camera
from ..kernels.dispatch import use_compiled
from ..losses.depth import DepthTarget, depth_loss
from ..losses.mask_chamfer import (
    COVERED_WITHIN,
    REFERENCE_POINTS,
    MaskTarget,
    mask_chamfer,
    resolvability,
)
from ..losses.projection import project_differentiably
from ..losses.silhouette import silhouette_bce
from .resampled_view import ResampledView

if TYPE_CHECKING:
    from ..kernels.mask_chamfer_numba import CompiledView


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
    """A view's mask and depth map, prepared for the losses, and the weight of the view's loss."""

    camera: Camera
    mask: MaskTarget
    depth: DepthTarget | None
    weight: float

    @classmethod
    def of(cls, view: ResampledView, weight: float) -> ViewTarget:
        depth = None
        if view.depth is not None:
            depth = DepthTarget.of(view.depth, view.target.inside, view.camera)
        return cls(view.camera, view.target, depth, weight)

    @cached_property
    def compiled(self) -> CompiledView:
        """For the compiled loop, in contiguous arrays: others would be compiled anew."""
        from ..kernels.mask_chamfer_numba import CompiledView

        camera, mask = self.camera, self.mask
        near = -np.inf if camera.model == "orthographic" else NEAR
        return CompiledView(
            K=np.ascontiguousarray(camera.K),
            R=np.ascontiguousarray(camera.R),
            t=np.ascontiguousarray(camera.t),
            near=near,
            inside=np.ascontiguousarray(mask.inside),
            outside=np.ascontiguousarray(mask.outside),
            nearest_in_column=np.ascontiguousarray(mask.nearest_in_column),
            bounds=np.array(mask.bounds),
            truncated=mask.truncated,
            within=COVERED_WITHIN * mask.cells_per_mask_pixel,
            scale=mask.scale,
            reference_points=REFERENCE_POINTS,
        )


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

    @property
    def truncated(self) -> bool:
        """Whether an image border truncates the object in every view."""
        return all(view.mask.truncated for view in self.views)

    def resolvability(self, points: Array, field: SmoothField) -> list[Array]:
        """For each view [N] in [0, 1], how well its mask resolves the part around each point.

        A point takes the value of its node's neighbourhood.
        """
        nodes = points[field.nodes]
        found = []
        for view in self.views:
            patches = project_differentiably(nodes, view.camera).points_px[field.patches]
            found.append(
                field.of_nearest_node(resolvability(patches, view.mask.cells_per_mask_pixel))
            )
        return found


@dataclass(frozen=True, eq=False)
class MaskChamferObjective:
    """Weighted sum over views of `mask_chamfer`, and of `depth_loss` where views have depth maps.

    ``robust_scale`` is in pixels of a mask of 64. Without ``resolvability`` all parts count. The
    sum is infinite where a view whose weight is not 0 shows no point.
    """

    targets: ViewTargets
    robust_scale: float
    resolvability: list[Array] | None = None

    def __call__(self, points: Array) -> tuple[float, Array]:
        costs, gradient, observed = self._of_masks(points)
        total = float(costs.sum()) if observed else np.inf
        for view in self.targets.views:
            if view.depth is not None and view.weight > 0.0:
                value, by_points = depth_loss(
                    points,
                    project_differentiably(points, view.camera),
                    view.depth,
                    self.robust_scale,
                )
                total, gradient = total + view.weight * value, gradient + view.weight * by_points
        return total, gradient

    def _of_masks(self, points: Array) -> tuple[Array, Array, bool]:
        """What each point adds, [N], the gradient [N, 3], and whether all views observe points."""
        costs, gradient, observed = np.zeros(len(points)), np.zeros_like(points), True
        for number, view in enumerate(self.targets.views):
            if view.weight == 0.0:
                continue
            resolved = self.resolvability[number] if self.resolvability else None
            if use_compiled():
                from ..kernels.mask_chamfer_numba import mask_chamfer as compiled

                observed &= compiled(
                    points, view.compiled, self.robust_scale, resolved, view.weight, costs, gradient
                )
            else:
                projected = project_differentiably(points, view.camera)
                pixels, valid = projected.points_px, projected.valid
                of_points, gradient_px = mask_chamfer(
                    pixels, valid, view.mask, self.robust_scale, resolved
                )
                costs += view.weight * of_points
                gradient += view.weight * projected.pull_back(gradient_px)
                observed &= bool(view.mask.observed(pixels, valid).any())
        return costs, gradient, observed
