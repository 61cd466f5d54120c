"""The mask term of the optimisation: views in the window of the object, projected and compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..errors import InputError
from ..geometry.camera import NEAR, Camera
from ..geometry.resampling import area_resize
from ..geometry.view import View
from ..geometry.window import Array, Box, window_of
from ..silhouette.bce import REFERENCE_PIXELS, PixelWeights, mask_loss
from ..silhouette.depth import DepthTarget, depth_loss
from ..silhouette.mask_chamfer import MaskTarget, mask_chamfer_loss, mask_chamfer_of_points, resolvability, sides
from ..silhouette.projection import CameraBatch, Projected, project
from .smooth_field import SmoothField

if TYPE_CHECKING:
    from .camera_moves import CameraMoves

# Cells along the side of the window that a view is worked on in.
CELLS = 64


@dataclass(frozen=True, eq=False)
class ResampledView:
    """A view as the loop sees it: its window (`window_of`) on a grid of square cells.

    Attributes
    ----------
    mask : [h, h]; known : [h, h] how much of each cell is known, None where all is. Beyond the image nothing is.
    camera : from normalised points to the cells; sigma_sq : of the projection, cells^2.
    box : edges of the window in pixels of the mask.
    bounds : left, top, right, bottom edges of the image, in cells: the window's own border cuts nothing.
    depth : [h, h] normalised, NaN where it is not known; None without a depth map.
    image : [h, h, 3] mean colour of the foreground in each cell, 0 where there is none; None without an image.
    """

    mask: Array
    known: Array | None
    camera: Camera
    sigma_sq: float
    box: Box
    bounds: Box
    depth: Array | None = None
    image: Array | None = None

    @property
    def grain(self) -> float:
        """Cells to a pixel of the mask where it was enlarged, else 1: nothing finer is known."""
        return max(1.0, self.camera.width / (self.box[2] - self.box[0]))

    @property
    def inside(self) -> NDArray[np.bool_]:
        """[h, w], pixels known to be foreground."""
        inside, _ = sides(torch.from_numpy(self.mask)[None], None if self.known is None else torch.from_numpy(self.known)[None])
        found: NDArray[np.bool_] = inside[0].numpy()
        return found

    @property
    def kind(self) -> tuple[int, int, str, float]:
        """What views must have in common to be worked on together."""
        return self.camera.width, self.camera.height, self.camera.model, self.sigma_sq

    @property
    def size(self) -> float:
        """Pixels of a 64x64 mask along a unit at the cloud's centre; outlines, and with them losses, grow with it."""
        camera = self.camera
        depth = 1.0 if camera.model == "orthographic" else max(float(camera.t[2]), NEAR)
        return float(np.sqrt(camera.K[0, 0] * camera.K[1, 1] * REFERENCE_PIXELS / (camera.width * camera.height)) / depth)


def resample_view(
    view: View, sigma_sq: float, centre: Array, scale: float, box: Box | None = None, cells: int = CELLS
) -> ResampledView:
    """Prepare ``view`` for a cloud normalised by ``(X - centre) / scale``.

    What lies in the window is averaged by area to the cells, or interpolated linearly where they are smaller than pixels.

    Parameters
    ----------
    sigma_sq : cells^2.
    box : edges of the window, a square; None for that of the mask alone.
    cells : along a side of the window.

    Raises
    ------
    InputError
        sigma_sq is under 0.01, or its square root over a quarter of the window; or no cell is known and foreground.
    """
    widest = (cells / 4.0) ** 2
    if not 0.01 <= sigma_sq <= widest:
        raise InputError(f"sigma_sq is {sigma_sq:g}, expected 0.01 to {widest:g}: squared cells of a window of {cells}x{cells}")
    box = window_of(view) if box is None else box
    camera = view.camera.cropped(box, cells, cells)
    mask, weight = area_resize(view.mask, box, cells, cells, weights=view.known, interpolate=True)
    image = None
    if view.image is not None:
        image = area_resize(view.image, box, cells, cells, weights=view.inside, interpolate=True)[0]
    depth = None if view.depth is None else _sampled(view.depth, box, cells) / scale
    known = None if view.known is None and weight.min() >= 1.0 - 1e-9 else weight
    found = ResampledView(
        mask, known, camera.for_normalised(centre, scale), sigma_sq, box, _image_in(box, view.camera, cells), depth, image
    )
    if not found.inside.any():
        raise InputError(
            f"{view.name}: no pixel is known to be foreground when it is worked on at {cells}x{cells}, expected "
            "some; its ignore map leaves less than half of each"
        )
    return found


def _image_in(box: Box, camera: Camera, cells: int) -> Box:
    """The edges of the image in cells of the window."""
    left, top, right, bottom = box
    across, down = cells / (right - left), cells / (bottom - top)
    return (
        (-0.5 - left) * across - 0.5,
        (-0.5 - top) * down - 0.5,
        (camera.width - 0.5 - left) * across - 0.5,
        (camera.height - 0.5 - top) * down - 0.5,
    )


def _sampled(depth: Array, box: Box, cells: int) -> Array:
    """``depth`` at the pixel nearest to each cell: a mean across an edge would lie in mid-air. NaN beyond the image."""
    left, top, right, bottom = box
    middle = (np.arange(cells) + 0.5) / cells
    rows = np.floor(top + middle * (bottom - top) + 0.5).astype(int)
    columns = np.floor(left + middle * (right - left) + 0.5).astype(int)
    height, width = depth.shape
    there = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))
    return np.where(there, depth[rows.clip(0, height - 1)[:, None], columns.clip(0, width - 1)], np.nan)


class SilhouetteObjective:
    """Weighted sum over views of the silhouette's cross-entropy (Eq. 4), for B clouds that are asked by views of their own.

    Parameters
    ----------
    views : [B][V] views of each cloud; view v is of one kind (`ResampledView.kind`) for all clouds.
    counts : [B] points of each cloud, those behind them are not there.
    like : [B, N, 3] tensor whose precision and device are used.
    weights : [B, V] of the views' losses; None for 1.

    Attributes
    ----------
    moves : corrections of the cameras, None where they are taken as given.
    """

    def __init__(
        self, views: Sequence[Sequence[ResampledView]], counts: Tensor, like: Tensor, weights: Tensor | None = None
    ) -> None:
        self.moves: CameraMoves | None = None
        self.weights = None if weights is None else weights.to(like)
        self.views = [ViewBatch.of(column, like) for column in zip(*views, strict=True)]
        size = like.shape[1]
        self.full = bool((counts == size).all())
        self.there = (torch.arange(size) < counts.unsqueeze(1)).to(like.device)  # [B, N]
        self._targets = [PixelWeights.of(view.mask, view.known) for view in self.views]

    def projected(self, points: Tensor, view: ViewBatch) -> Projected:
        """Where ``points`` [B, N, 3] fall in that view, [B, N, 2] and [B, N]."""
        cameras = view.cameras if self.moves is None else self.moves.apply(view.cameras, self.views.index(view))
        points_px, valid = (found[:, 0] for found in project(points, cameras))
        return Projected(points_px, valid if self.full else valid & self.there)

    def __call__(self, points: Tensor) -> Tensor:
        """The loss [B] of the clouds ``points`` [B, N, 3]; infinite where a view shows no point at all."""
        losses = torch.stack(self.losses(points), 1)
        return (losses if self.weights is None else self.weights * losses).sum(1)

    def losses(self, points: Tensor) -> list[Tensor]:
        """The loss [B] by each view, without its weight."""
        found = []
        for view, target in zip(self.views, self._targets, strict=True):
            points_px, valid = self.projected(points, view)
            # With no point to pull, the pixels that want one would ask for nothing: a cloud behind the camera would be perfect.
            found.append(torch.where(valid.any(1), mask_loss(points_px, valid, target, view.sigma_sq), torch.inf))
        return found


class MaskChamferObjective:
    """Weighted sum over views of `mask_chamfer_loss`, for B clouds that are asked by views of their own, and of
    `depth_loss` where they have depth maps.

    Views of one kind are worked on together: for small clouds, what a step costs is mostly the number of its operations.

    Parameters
    ----------
    views, counts, like, weights : as `SilhouetteObjective`.
    """

    def __init__(
        self, views: Sequence[Sequence[ResampledView]], counts: Tensor, like: Tensor, weights: Tensor | None = None
    ) -> None:
        kinds = [view.kind for view in views[0]]
        members = {kind: [v for v, other in enumerate(kinds) if other == kind] for kind in kinds}
        self._groups = []
        self._depths: list[DepthTarget | None] = []
        for group in members.values():
            every = ViewBatch.of([own[v] for own in views for v in group], like)
            target = MaskTarget.of(every.mask, every.known, every.bounds, every.grain)
            cameras = every.cameras.grouped(len(group))
            share = torch.ones(len(views), len(group)) if weights is None else weights[:, group]
            self._groups.append((target, cameras, share.to(like), counts.repeat_interleave(len(group))))
            self._depths.append(None if every.depth is None else DepthTarget.of(every.depth, target.inside, every.cameras))
        self._there = (torch.arange(like.shape[1]) < counts.unsqueeze(1)).to(like.device).unsqueeze(1)  # [B, 1, N]
        self._shown: list[Tensor | None] = [None] * len(self._groups)
        found = []
        for (target, _, share, _), depth in zip(self._groups, self._depths, strict=True):
            pixels = target.pixels() if depth is None else target.pixels() + depth.pixels()
            found.append((share * pixels.view_as(share)).sum(1))
        self.pixels = torch.stack(found).sum(0)
        """[B] pixels of all views that ask, by mask or by depth, of images of 64, weighted like their losses."""
        cut = [
            torch.zeros_like(s, dtype=torch.bool) if t.truncated is None else t.truncated.view_as(s)
            for t, _, s, _ in self._groups
        ]
        self.cut = torch.cat(cut, 1).all(1)
        """[B] whether the border cuts the object in every view."""

    def look(self, points: Tensor, field: SmoothField) -> None:
        """Find out, for the calls from here on, which parts of the clouds ``points`` the views do not resolve."""
        nodes = torch.take_along_dim(points.detach(), field.nodes.unsqueeze(-1), 1)
        for number, (target, cameras, share, _) in enumerate(self._groups):
            points_px, _ = project(nodes, cameras)  # [B, G, M, 2]
            patches = field.patches.unsqueeze(1).expand(-1, share.shape[1], -1, -1)
            around = torch.take_along_dim(points_px.unsqueeze(2), patches.flatten(2).unsqueeze(2).unsqueeze(-1), 3)
            grain = target.grain.view(*share.shape, 1)
            shown = resolvability(around.squeeze(2).unflatten(2, patches.shape[2:]), grain)
            self._shown[number] = torch.stack([field.of_nearest_node(own) for own in shown.unbind(1)], 1).flatten(0, 1)

    def asked(self, points: Tensor) -> Tensor:
        """[B, N] which of the points [B, N, 3] some view tells something of."""
        found = torch.zeros_like(points[..., 0], dtype=torch.bool)
        for target, cameras, share, _ in self._groups:
            points_px, valid = project(points.detach(), cameras)
            asked = target.observed(points_px.flatten(0, 1), valid.flatten(0, 1)).view_as(valid)
            found = found | (asked & (share > 0.0).unsqueeze(-1)).any(1)
        return found

    def of_points(self, points: Tensor, reach: float) -> Tensor:
        """[B, N] what each point of the clouds adds to the masks' part of the loss."""
        total = torch.zeros_like(points[..., 0])
        for (target, cameras, share, counts), shown in zip(self._groups, self._shown, strict=True):
            points_px, valid = project(points.detach(), cameras)
            valid = (valid & self._there).flatten(0, 1)
            each = mask_chamfer_of_points(points_px.flatten(0, 1), valid, target, reach, counts, shown)
            total += (share.unsqueeze(-1) * each.view(*share.shape, -1)).sum(1)
        return total

    def __call__(self, points: Tensor, reach: float) -> Tensor:
        """The loss [B] of the clouds ``points`` [B, N, 3]; infinite where a view shows no point at all."""
        total = points.new_zeros(len(points))
        for (target, cameras, share, counts), shown, depth in zip(self._groups, self._shown, self._depths, strict=True):
            points_px, valid = project(points, cameras)
            points_px, valid = points_px.flatten(0, 1), (valid & self._there).flatten(0, 1)
            losses = mask_chamfer_loss(points_px, valid, target, reach, counts, shown)
            if depth is not None:
                each = points.repeat_interleave(share.shape[1], 0)
                losses = losses + depth_loss(each, Projected(points_px, valid), depth, reach, counts)
            # A view that does not count may show no point either.
            seen = target.observed(points_px.detach(), valid).any(1).view_as(share) | (share == 0.0)
            total = total + torch.where(seen, share * losses.view_as(share), torch.inf).sum(1)
        return total


@dataclass(frozen=True, eq=False)
class ViewBatch:
    """One view of each of B clouds."""

    mask: Tensor  # [B, h, w]
    known: Tensor | None  # [B, h, w]
    cameras: CameraBatch  # [B, 1]
    sigma_sq: float
    bounds: Tensor  # [B, 4]
    grain: Tensor  # [B]
    depth: Tensor | None = None  # [B, h, w]

    @classmethod
    def of(cls, views: Sequence[ResampledView], like: Tensor) -> ViewBatch:
        def stacked(arrays: list[Array]) -> Tensor:
            return torch.as_tensor(np.stack(arrays), dtype=like.dtype, device=like.device)

        first = views[0]
        if any(view.kind != first.kind for view in views):
            raise ValueError("views that are worked on together share size, model and sigma^2")
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
