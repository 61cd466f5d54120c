"""What photos ask of a cloud that has colours: what is seen of it lies where the photo has its colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from ..silhouette.mask_chamfer import REFERENCE_POINTS, REFERENCE_SIDE, robust
from ..silhouette.projection import CameraBatch, pixels_under, project
from .objective import ResampledView

# Of points that fall within a pixel of each other those are seen that lie no further behind the first (longest side 1).
BEHIND = 0.015
# Colours, between 0 and 1 in each channel, that differ by many times this are likely those of different parts.
TOLERANCE = 0.1
# What a point costs whose colour is wrong, in squared pixels of an image of 64 to a unit of squared colour.
WEIGHT = 3000.0
# Of a picture only what is finer than so many times the blur counts: light changes slowly across an object, paint does not.
COARSE = 4.0
# How many times as bright as the cloud a channel of a photo may be, or as dark.
EXPOSURE = 5.0


@dataclass(eq=False)
class _Photo:
    """One view's image, and what was last found out by a look at the cloud."""

    image: Tensor  # [h, w, 3]
    inside: Tensor  # [h, w] bool
    cameras: CameraBatch  # [1]
    weight: float
    detail: Tensor | None = None  # [h, w, 3]
    wanted: Tensor | None = None  # [N, 3] detail of the cloud, as bright as that of the photo
    brightness: Tensor | None = None  # [3] photo / cloud
    agreement: Tensor | None = None  # correlation of the two, 0 where it is negative


class PhotometricLoss:
    """Draw the visible points of a cloud to where photos have their colours.

    Of both pictures, the photo and the one that the cloud makes, the detail is compared: what a Gaussian of standard deviation
    ``blur`` leaves and one of four times that takes away. Each point that a photo shows costs ``3000 a rho(c)``, c the
    difference between its detail and that of the photo where the point falls, interpolated bilinearly, and
    ``rho(c) = c^2 s^2 / (s^2 + c^2)`` with s = 0.1 (Geman and McClure): what differs more is likely another part, or lies in
    the shade. A channel's exposure may be another in each photo; it is taken out. The factor a is how well the details of all
    points that are seen agree, their correlation at the last look: paint that is another object's says nothing of this one.
    Which points are seen is found out anew at every call, and is no matter of the gradient.

    Parameters
    ----------
    views : of one cloud; those without an image ask nothing.
    weights : of each view.
    colours : [N, 3] of the points, in [0, 1].
    like : tensor whose precision and device are used.
    """

    def __init__(self, views: Sequence[ResampledView], weights: Sequence[float], colours: Tensor, like: Tensor) -> None:
        self._colours = colours.to(like)
        self._photos = [
            _Photo(
                torch.as_tensor(view.image).to(like),
                torch.as_tensor(view.inside).to(like.device),
                CameraBatch.of([view.camera], like),
                weight,
            )
            for view, weight in zip(views, weights, strict=True)
            if view.image is not None
        ]

    @torch.no_grad()
    def look(self, points: Tensor, blur: float) -> None:
        """Blur photos and cloud, and compare their brightness, for the calls from here on.

        Parameters
        ----------
        points : [1, N, 3] where the cloud is by now.
        blur : standard deviation, pixels of an image whose longer side has 64. The cloud is blurred alike: as a picture of the
            points that are seen, each on its pixel.
        """
        for photo in self._photos:
            height, width = photo.inside.shape
            sigma = blur * max(height, width) / REFERENCE_SIDE
            photo.detail = detail(photo.image, photo.inside.to(photo.image), sigma)
            points_px, seen = _seen(points, photo)
            place, _ = pixels_under(points_px, seen, height, width)
            count = seen[0].to(points)
            total = points.new_zeros(height * width, 4)
            total.index_add_(0, place[0], torch.cat([self._colours * count.unsqueeze(1), count.unsqueeze(1)], 1))
            drawn = total[:, 3].view(height, width)
            picture = detail(total[:, :3].view(height, width, 3) / drawn.clamp_min(1.0).unsqueeze(2), drawn, sigma)
            own = sampled(picture, points_px[0])
            # Least squares; a channel that the cloud lacks stays as it is.
            shown = sampled(photo.detail, points_px[0]) * count.unsqueeze(1)
            squared = (own.square() * count.unsqueeze(1)).sum(0)
            tiny = torch.finfo(own.dtype).tiny
            ratio = (shown * own).sum(0) / squared.clamp_min(tiny)
            photo.brightness = torch.where(squared > 0.0, ratio, 1.0).clamp(1.0 / EXPOSURE, EXPOSURE)
            photo.wanted = own * photo.brightness
            squares = shown.square().sum() * (photo.wanted.square() * count.unsqueeze(1)).sum()
            photo.agreement = (shown * photo.wanted).sum().clamp_min(0.0) / squares.sqrt().clamp_min(tiny)

    def __call__(self, points: Tensor) -> Tensor:
        """The loss [1] of the cloud ``points`` [1, N, 3], as if it had 1,024 points; differentiable in them."""
        total = points.new_zeros(1)
        for photo in self._photos:
            assert photo.detail is not None
            assert photo.wanted is not None
            assert photo.brightness is not None
            assert photo.agreement is not None
            points_px, seen = _seen(points, photo)
            # In units of the cloud's colours: the exposure of a photo does not say how much it counts.
            apart = (sampled(photo.detail, points_px[0]) - photo.wanted) / photo.brightness
            squared = torch.where(seen[0], apart.square().sum(1), 0.0)
            total = total + photo.weight * WEIGHT * photo.agreement * robust(squared, TOLERANCE).sum()
        return total * (REFERENCE_POINTS / points.shape[1])


def _seen(points: Tensor, photo: _Photo) -> tuple[Tensor, Tensor]:
    """Where ``points`` [1, N, 3] fall, [1, N, 2], and which are on the mask and nearest to the camera, [1, N]."""
    (points_px, valid), cameras = project(points, photo.cameras), photo.cameras
    points_px, valid = points_px[:, 0], valid[:, 0]
    depth = (points.detach() @ cameras.R[0, 2] + cameras.t[0, 2])[0]
    height, width = photo.inside.shape
    place, on = pixels_under(points_px, valid, height, width)
    front = depth.new_full((height * width,), torch.inf)
    front = front.scatter_reduce(0, place[0], torch.where(on[0], depth, torch.inf), "amin").view(1, 1, height, width)
    front = -functional.max_pool2d(-front, 3, 1, 1).flatten()
    return points_px, on & photo.inside.flatten()[place] & (depth <= front[place] + BEHIND)


def sampled(image: Tensor, points_px: Tensor) -> Tensor:
    """``image`` [H, W, C] at ``points_px`` [N, 2] (column, row), bilinear; beyond its border as at the border. [N, C]."""
    height, width = image.shape[:2]
    place = (2.0 * points_px + 1.0) / points_px.new_tensor([width, height]) - 1.0
    found = functional.grid_sample(
        image.permute(2, 0, 1).unsqueeze(0), place.view(1, 1, -1, 2), padding_mode="border", align_corners=False
    )
    return found[0, :, 0].T


def detail(image: Tensor, share: Tensor, sigma: float) -> Tensor:
    """What is coarser than ``sigma`` px and finer than four times that; as `blurred`, of which it is the difference."""
    return blurred(image, share, sigma) - blurred(image, share, COARSE * sigma)


def blurred(image: Tensor, share: Tensor, sigma: float) -> Tensor:
    """The mean of ``image`` [H, W, 3] around each pixel, by a Gaussian of ``sigma`` px and the ``share`` [H, W] of each pixel.

    Colours of what has no share do not run in; a pixel that is far from all that has keeps 0.
    """
    both = torch.cat([image * share.unsqueeze(2), share.unsqueeze(2)], 2)
    for axis in (0, 1):
        along = torch.arange(both.shape[axis], dtype=image.dtype, device=image.device)
        kernel = torch.exp(-0.5 * ((along.unsqueeze(1) - along) / sigma).square())
        both = torch.tensordot(kernel, both, dims=([1], [axis])).movedim(0, axis)
    return both[..., :3] / both[..., 3:].clamp_min(torch.finfo(image.dtype).tiny)
