"""Losses of clouds by their views: functions of points [B, N, 3] that return [B]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..geometry.window import Array
from ..silhouette.bce import PixelWeights, mask_loss
from ..silhouette.depth import DepthTarget, depth_loss
from ..silhouette.mask_chamfer import MaskTarget, mask_chamfer_loss, mask_chamfer_of_points, resolvability
from ..silhouette.projection import CameraBatch, Projected, project
from .camera_moves import CameraMoves
from .resampled_view import ResampledView
from .smooth_field import SmoothField

Views = Sequence[Sequence[ResampledView]]
Resolvability = tuple[Tensor, ...]
"""For each `ViewGroup` [M, N] in [0, 1], how well its masks resolve the part of the cloud around each point."""


class SilhouetteObjective:
    """Weighted sum over views of the silhouette's cross-entropy (Eq. 4).

    Parameters
    ----------
    views : [B][V]; view v is of one kind (`ResampledView.kind`) for all clouds.
    counts : [B] points of each cloud, the rest is padding. like : [B, N, 3], gives precision and device.
    weights : [B, V] of the views' losses; None for 1.
    """

    def __init__(
        self,
        views: Views,
        counts: Tensor,
        like: Tensor,
        weights: Tensor | None = None,
        camera_moves: CameraMoves | None = None,
    ) -> None:
        self.views = [ViewBatch.of(column, like) for column in zip(*views, strict=True)]
        self._weights = None if weights is None else weights.to(like)
        self._camera_moves = camera_moves
        self._padded = bool((counts != like.shape[1]).any())
        self._is_point = _is_point(counts, like)
        self._targets = [PixelWeights.of(view.mask, view.known) for view in self.views]

    def projected(self, points: Tensor, view: int) -> Projected:
        """Where ``points`` [B, N, 3] fall in the view of that number, [B, N, 2] and [B, N]."""
        cameras = self.views[view].cameras
        if self._camera_moves is not None:
            cameras = self._camera_moves.apply(cameras, view)
        points_px, valid = (of_view[:, 0] for of_view in project(points, cameras))
        return Projected(points_px, valid & self._is_point if self._padded else valid)

    def __call__(self, points: Tensor) -> Tensor:
        """The loss [B] of the clouds ``points`` [B, N, 3]; infinite where a view shows no point at all."""
        losses = torch.stack(self.losses(points), 1)
        return (losses if self._weights is None else self._weights * losses).sum(1)

    def losses(self, points: Tensor) -> list[Tensor]:
        """The loss [B] by each view, without its weight."""
        losses = []
        for number, (view, target) in enumerate(zip(self.views, self._targets, strict=True)):
            points_px, valid = self.projected(points, number)
            # Without a visible point the loss would have no gradient: a cloud behind the camera would be perfect.
            losses.append(torch.where(valid.any(1), mask_loss(points_px, valid, target, view.sigma_sq), torch.inf))
        return losses


class ViewGroup(NamedTuple):
    """Views of one kind, G of each of B clouds, as one batch of M = B G masks: small clouds cost mostly by the operation."""

    target: MaskTarget  # M masks
    cameras: CameraBatch  # [B, G]
    weights: Tensor  # [B, G]
    counts: Tensor  # [M]
    depth: DepthTarget | None


class ViewTargets:
    """The masks and depth maps of all views of B clouds, prepared for the losses; parameters as `SilhouetteObjective`.

    Attributes
    ----------
    pixels : [B] foreground pixels and known depths of all views, of masks of 64, weighted like their losses.
    truncated : [B] whether an image border truncates the object in every view.
    """

    def __init__(self, views: Views, counts: Tensor, like: Tensor, weights: Tensor | None = None) -> None:
        kinds = [view.kind for view in views[0]]
        members = {kind: [v for v, other in enumerate(kinds) if other == kind] for kind in kinds}
        self.groups: list[ViewGroup] = []
        for group in members.values():
            batch = ViewBatch.of([of_cloud[v] for of_cloud in views for v in group], like)
            target = MaskTarget.of(batch.mask, batch.known, batch.bounds, batch.grain)
            of_group = torch.ones(len(views), len(group)) if weights is None else weights[:, group]
            depth = None if batch.depth is None else DepthTarget.of(batch.depth, target.inside, batch.cameras)
            cameras = batch.cameras.grouped(len(group))
            self.groups.append(ViewGroup(target, cameras, of_group.to(like), counts.repeat_interleave(len(group)), depth))
        self.is_point = _is_point(counts, like).unsqueeze(1)  # [B, 1, N]
        pixels, truncated = [], []
        for target, _, of_group, _, depth in self.groups:
            total = target.pixels() if depth is None else target.pixels() + depth.pixels()
            pixels.append((of_group * total.view_as(of_group)).sum(1))
            none = torch.zeros_like(of_group, dtype=torch.bool)
            truncated.append(none if target.truncated is None else target.truncated.view_as(of_group))
        self.pixels = torch.stack(pixels).sum(0)
        self.truncated = torch.cat(truncated, 1).all(1)

    def resolvability(self, points: Tensor, field: SmoothField) -> Resolvability:
        """Which parts of the clouds ``points`` the masks resolve; parts are the neighbourhoods of the field's nodes."""
        nodes = torch.take_along_dim(points.detach(), field.nodes.unsqueeze(-1), 1)
        of_groups = []
        for target, cameras, weights, _, _ in self.groups:
            points_px, _ = project(nodes, cameras)  # [B, G, M, 2]
            patches = field.patches.unsqueeze(1).expand(-1, weights.shape[1], -1, -1)
            patches_px = torch.take_along_dim(points_px.unsqueeze(2), patches.flatten(2).unsqueeze(2).unsqueeze(-1), 3)
            grain = target.grain.view(*weights.shape, 1)
            of_nodes = resolvability(patches_px.squeeze(2).unflatten(2, patches.shape[2:]), grain)
            of_groups.append(torch.stack([field.of_nearest_node(of_view) for of_view in of_nodes.unbind(1)], 1).flatten(0, 1))
        return tuple(of_groups)

    def observed(self, points: Tensor) -> Tensor:
        """[B, N] which of the points [B, N, 3] lie where some view says something: within its image, or before the camera."""
        seen = torch.zeros_like(points[..., 0], dtype=torch.bool)
        for target, cameras, weights, _, _ in self.groups:
            points_px, valid = project(points.detach(), cameras)
            by_view = target.observed(points_px.flatten(0, 1), valid.flatten(0, 1)).view_as(valid)
            seen = seen | (by_view & (weights > 0.0).unsqueeze(-1)).any(1)
        return seen


@dataclass(frozen=True, eq=False)
class MaskChamferObjective:
    """Weighted sum over views of `mask_chamfer_loss`, and of `depth_loss` where views have depth maps.

    ``robust_scale`` is in pixels of a mask of 64; without ``resolvability`` all parts count.
    """

    targets: ViewTargets
    robust_scale: float
    resolvability: Resolvability | None = None

    def __call__(self, points: Tensor) -> Tensor:
        """The loss [B] of the clouds ``points`` [B, N, 3]; infinite where a view shows no point at all."""
        total = points.new_zeros(len(points))
        for group, resolved in self._groups():
            target, cameras, weights, counts, depth = group
            points_px, valid = project(points, cameras)
            points_px, valid = points_px.flatten(0, 1), (valid & self.targets.is_point).flatten(0, 1)
            losses = mask_chamfer_loss(points_px, valid, target, self.robust_scale, counts, resolved)
            if depth is not None:
                each = points.repeat_interleave(weights.shape[1], 0)
                losses = losses + depth_loss(each, Projected(points_px, valid), depth, self.robust_scale, counts)
            # A view without weight may show no point.
            shown = target.observed(points_px.detach(), valid).any(1).view_as(weights) | (weights == 0.0)
            total = total + torch.where(shown, weights * losses.view_as(weights), torch.inf).sum(1)
        return total

    def per_point(self, points: Tensor) -> Tensor:
        """[B, N] what each point adds to the masks' part of the loss."""
        total = torch.zeros_like(points[..., 0])
        for (target, cameras, weights, counts, _), resolved in self._groups():
            points_px, valid = project(points.detach(), cameras)
            valid = (valid & self.targets.is_point).flatten(0, 1)
            each = mask_chamfer_of_points(points_px.flatten(0, 1), valid, target, self.robust_scale, counts, resolved)
            total += (weights.unsqueeze(-1) * each.view(*weights.shape, -1)).sum(1)
        return total

    def _groups(self) -> list[tuple[ViewGroup, Tensor | None]]:
        groups = self.targets.groups
        return list(zip(groups, self.resolvability or [None] * len(groups), strict=True))


@dataclass(frozen=True, eq=False)
class ViewBatch:
    """One view of each of B clouds, as tensors."""

    mask: Tensor  # [B, h, w]
    known: Tensor | None  # [B, h, w]
    cameras: CameraBatch  # [B, 1]
    sigma_sq: float
    bounds: Tensor  # [B, 4]
    grain: Tensor  # [B]
    depth: Tensor | None = None  # [B, h, w]

    @classmethod
    def of(cls, views: Sequence[ResampledView], like: Tensor) -> ViewBatch:
        """Raises ValueError where the views are not of one kind."""

        def stacked(arrays: list[Array]) -> Tensor:
            return torch.as_tensor(np.stack(arrays), dtype=like.dtype, device=like.device)

        first = views[0]
        if any(view.kind != first.kind for view in views):
            raise ValueError("views of one batch share size, camera model and sigma^2")
        known = None
        if any(view.known is not None for view in views):
            known = stacked([np.ones_like(view.mask) if view.known is None else view.known for view in views])
        depth = None
        if any(view.depth is not None for view in views):
            depth = stacked([np.full_like(view.mask, np.nan) if view.depth is None else view.depth for view in views])
        cameras = CameraBatch.of([view.camera for view in views], like).one_each()
        bounds = stacked([np.array(view.bounds) for view in views])
        grain = stacked([np.array(view.grain) for view in views])
        return cls(stacked([view.mask for view in views]), known, cameras, first.sigma_sq, bounds, grain, depth)


def _is_point(counts: Tensor, like: Tensor) -> Tensor:
    """[B, N] which rows are points, not padding."""
    return (torch.arange(like.shape[1]) < counts.unsqueeze(1)).to(like.device)
