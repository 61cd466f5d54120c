"""The photometric loss of clouds with colours: visible points lie where the photo has their colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from ..silhouette.mask_chamfer import REFERENCE_POINTS, REFERENCE_SIDE, robust
from ..silhouette.projection import CameraBatch, pixels_under, project
from .optimise import Objective
from .resampled_view import ResampledView

# A point is visible if it lies no further than this (longest side 1) behind the first within a pixel of it.
OCCLUSION_DEPTH = 0.015
# Robust scale of colour differences, of channels in [0, 1].
ROBUST_SCALE = 0.1
# Squared pixels of a mask of 64 per unit of squared colour.
WEIGHT = 3000.0
# The detail of a picture is what is finer than so many blurs: light changes slowly across an object, paint does not.
COARSE = 4.0
# Largest ratio of brightness, channel by channel, between photo and cloud, and of cloud and photo.
EXPOSURE = 5.0


class _Photo(NamedTuple):
    image: Tensor  # [h, w, 3]
    inside: Tensor  # [h, w] bool
    cameras: CameraBatch  # [1]
    weight: float


class _Comparison(NamedTuple):
    """What one photo is compared with during a stage."""

    photo: _Photo
    detail: Tensor  # [h, w, 3]
    expected: Tensor  # [N, 3] detail of the cloud, in the photo's exposure
    exposure: Tensor  # [3] photo / cloud
    agreement: Tensor  # correlation of the two details, at least 0


@dataclass(frozen=True, eq=False)
class PhotometricLoss:
    """Moves visible points of a cloud to where photos have their colours.

    Photo and cloud are compared by their detail: a Gaussian blur of standard deviation ``blur`` minus one of four times that.
    Each visible point costs ``3000 a rho(c)``, c the difference between its detail and the photo's where it projects,
    interpolated bilinearly, and ``rho(c) = c^2 s^2 / (s^2 + c^2)`` with s = 0.1 (Geman-McClure), since larger differences
    are another part or a shadow. The exposure of each channel is estimated and removed. The factor a is the correlation of
    the two details at the start of the stage: a photo of other paint says nothing. Visibility is computed at every call,
    without gradient.
    """

    photos: tuple[_Photo, ...]
    colours: Tensor  # [N, 3]

    @classmethod
    def of(
        cls, views: Sequence[ResampledView], weights: Sequence[float], colours: Tensor, like: Tensor
    ) -> PhotometricLoss | None:
        """The loss of one cloud with ``colours`` [N, 3] in [0, 1], in the precision of ``like``; None without an image."""
        photos = [
            _Photo(
                torch.as_tensor(view.image).to(like),
                torch.as_tensor(view.inside).to(like.device),
                CameraBatch.of([view.camera], like),
                weight,
            )
            for view, weight in zip(views, weights, strict=True)
            if view.image is not None
        ]
        return cls(tuple(photos), colours.to(like)) if photos else None

    @torch.no_grad()
    def at(self, points: Tensor, blur: float) -> Objective:
        """The loss of a stage that starts at ``points`` [1, N, 3]; ``blur`` is a standard deviation, px of a mask of 64.

        The cloud is blurred too, as an image of its visible points.
        """
        return partial(_loss, [self._compared(photo, points, blur) for photo in self.photos])

    def _compared(self, photo: _Photo, points: Tensor, blur: float) -> _Comparison:
        height, width = photo.inside.shape
        sigma = blur * max(height, width) / REFERENCE_SIDE
        photo_detail = _detail(photo.image, photo.inside.to(photo.image), sigma)
        points_px, visible = _visible(points, photo)
        place, _ = pixels_under(points_px, visible, height, width)
        count = visible[0].to(points).unsqueeze(1)
        total = points.new_zeros(height * width, 4)
        total.index_add_(0, place[0], torch.cat([self.colours * count, count], 1))
        drawn = total[:, 3].view(height, width)
        picture = _detail(total[:, :3].view(height, width, 3) / drawn.clamp_min(1.0).unsqueeze(2), drawn, sigma)
        of_cloud = _sampled(picture, points_px[0])
        of_photo = _sampled(photo_detail, points_px[0]) * count
        # Exposure by least squares; 1 for a channel that the cloud lacks.
        squared = (of_cloud.square() * count).sum(0)
        tiny = torch.finfo(of_cloud.dtype).tiny
        ratio = (of_photo * of_cloud).sum(0) / squared.clamp_min(tiny)
        exposure = torch.where(squared > 0.0, ratio, 1.0).clamp(1.0 / EXPOSURE, EXPOSURE)
        expected = of_cloud * exposure
        squares = of_photo.square().sum() * (expected.square() * count).sum()
        agreement = (of_photo * expected).sum().clamp_min(0.0) / squares.sqrt().clamp_min(tiny)
        return _Comparison(photo, photo_detail, expected, exposure, agreement)


def _loss(comparisons: Sequence[_Comparison], points: Tensor) -> Tensor:
    """[1] of the cloud ``points`` [1, N, 3], as if it had 1,024 points; differentiable in them."""
    total = points.new_zeros(1)
    for photo, photo_detail, expected, exposure, agreement in comparisons:
        points_px, visible = _visible(points, photo)
        # In units of the cloud's colours, so that the exposure of a photo does not change its weight.
        difference = (_sampled(photo_detail, points_px[0]) - expected) / exposure
        squared = torch.where(visible[0], difference.square().sum(1), 0.0)
        total = total + photo.weight * WEIGHT * agreement * robust(squared, ROBUST_SCALE).sum()
    return total * (REFERENCE_POINTS / points.shape[1])


def _visible(points: Tensor, photo: _Photo) -> tuple[Tensor, Tensor]:
    """Projections [1, N, 2] of ``points`` [1, N, 3], and which are on the mask and nearest to the camera, [1, N]."""
    (points_px, valid), cameras = project(points, photo.cameras), photo.cameras
    points_px, valid = points_px[:, 0], valid[:, 0]
    depth = (points.detach() @ cameras.R[0, 2] + cameras.t[0, 2])[0]
    height, width = photo.inside.shape
    place, on = pixels_under(points_px, valid, height, width)
    front = depth.new_full((height * width,), torch.inf)
    front = front.scatter_reduce(0, place[0], torch.where(on[0], depth, torch.inf), "amin").view(1, 1, height, width)
    front = -functional.max_pool2d(-front, 3, 1, 1).flatten()
    return points_px, on & photo.inside.flatten()[place] & (depth <= front[place] + OCCLUSION_DEPTH)


def _sampled(image: Tensor, points_px: Tensor) -> Tensor:
    """``image`` [H, W, C] at ``points_px`` [N, 2] (column, row), bilinear; beyond its border as at the border. [N, C]."""
    height, width = image.shape[:2]
    place = (2.0 * points_px + 1.0) / points_px.new_tensor([width, height]) - 1.0
    values = functional.grid_sample(
        image.permute(2, 0, 1).unsqueeze(0), place.view(1, 1, -1, 2), padding_mode="border", align_corners=False
    )
    return values[0, :, 0].T


def _detail(image: Tensor, weight: Tensor, sigma: float) -> Tensor:
    """A difference of Gaussians, of standard deviations ``sigma`` px and four times that."""
    return _blurred(image, weight, sigma) - _blurred(image, weight, COARSE * sigma)


def _blurred(image: Tensor, weight: Tensor, sigma: float) -> Tensor:
    """Gaussian blur of ``image`` [H, W, 3] among pixels of positive ``weight`` [H, W]; 0 far from all of them."""
    both = torch.cat([image * weight.unsqueeze(2), weight.unsqueeze(2)], 2)
    for axis in (0, 1):
        along = torch.arange(both.shape[axis], dtype=image.dtype, device=image.device)
        kernel = torch.exp(-0.5 * ((along.unsqueeze(1) - along) / sigma).square())
        both = torch.tensordot(kernel, both, dims=([1], [axis])).movedim(0, axis)
    return both[..., :3] / both[..., 3:].clamp_min(torch.finfo(image.dtype).tiny)
