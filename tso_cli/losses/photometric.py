"""The photometric loss of coloured clouds: visible points lie where the photo has their colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.camera import Camera
from .mask_chamfer import REFERENCE_POINTS, REFERENCE_SIDE, robust
from .projection import Projected, pixels_under, project_differentiably

# A point is visible if it lies at most this far (longest side 1) behind the front point of its
# pixel and of the eight pixels around it.
OCCLUSION_DEPTH = 0.015
# Robust scale of colour differences, of channels in [0, 1]. Larger differences are another part of
# the object, or a shadow.
COLOUR_ROBUST_SCALE = 0.1
# Weight of the loss: squared pixels of a mask of 64 per unit of squared colour.
COLOUR_WEIGHT = 3000.0
# Standard deviation of the fine blur, px of a mask of 64.
BLUR = 0.5
# Detail is what a blur of this many times the fine blur removes: light changes slowly across an
# object, and paint changes fast.
COARSE_BLUR = 4.0
# Largest ratio, in each channel, of the brightness of photo and cloud, either way.
LARGEST_EXPOSURE = 5.0
TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, eq=False)
class Photo:
    """A photo of the object, and its view."""

    image: Array  # [h, w, 3] in [0, 1]
    inside: NDArray[np.bool_]  # [h, w] foreground
    camera: Camera
    weight: float  # of the view


@dataclass(frozen=True, eq=False)
class PhotometricTerm:
    """Moves visible points of a cloud to where a photo has their colours.

    Photo and cloud are compared by their detail: a Gaussian blur of standard deviation `BLUR`,
    minus a blur of four times this standard deviation. A visible point costs ``3000 a rho(c)``:

    1. c is the detail of the point minus the detail of the photo where the point projects,
       interpolated bilinearly. The exposure of each channel is estimated and removed.
    2. ``rho(c) = c^2 s^2 / (s^2 + c^2)`` with s = 0.1 (Geman and McClure).
    3. a is the correlation of the two details where the optimisation begins, because a photo of
       other paint says nothing.

    Visibility is computed at every call and has no gradient.
    """

    photo: Photo
    detail: Array  # [h, w, 3] of the photo
    expected: Array  # [N, 3] detail of the cloud, in the photo's exposure
    exposure: Array  # [3] photo / cloud
    agreement: float  # correlation of the two details, at least 0

    @classmethod
    def at(cls, photo: Photo, colours: Array, points: Array) -> PhotometricTerm:
        """The term of points that begin at ``points`` [N, 3] with ``colours`` [N, 3] in [0, 1].

        The cloud is blurred as an image of its visible points.
        """
        height, width = photo.inside.shape
        sigma = BLUR * max(height, width) / REFERENCE_SIDE
        detail = _detail(photo.image, photo.inside.astype(float), sigma)
        projected, visible = _visible(points, photo)
        place, _ = pixels_under(projected.points_px, visible, height, width)
        drawn = np.bincount(place, visible, height * width).astype(float).reshape(height, width)
        total = [
            np.bincount(place, colours[:, k] * visible, height * width).reshape(height, width)
            for k in range(3)
        ]
        picture = _detail(np.stack(total, -1) / np.maximum(drawn, 1.0)[..., None], drawn, sigma)
        of_cloud = _sampled(picture, projected.points_px)[0]
        of_photo = _sampled(detail, projected.points_px)[0] * visible[:, None]
        # Exposure by least squares; 1 for a channel in which the cloud has no detail.
        squared = (np.square(of_cloud) * visible[:, None]).sum(0)
        ratio = (of_photo * of_cloud).sum(0) / np.maximum(squared, TINY)
        exposure = np.clip(
            np.where(squared > 0.0, ratio, 1.0), 1.0 / LARGEST_EXPOSURE, LARGEST_EXPOSURE
        )
        expected = of_cloud * exposure
        squares = np.square(of_photo).sum() * (np.square(expected) * visible[:, None]).sum()
        agreement = max(float((of_photo * expected).sum()), 0.0) / max(
            float(np.sqrt(squares)), TINY
        )
        return cls(photo, detail, expected, exposure, agreement)

    def __call__(self, points: Array) -> tuple[float, Array]:
        """The loss of ``points`` [N, 3], as if the cloud had 1,024 points; its gradient [N, 3]."""
        projected, visible = _visible(points, self.photo)
        values, by_x, by_y = _sampled(self.detail, projected.points_px)
        # In units of the cloud's colours, so that the exposure of a photo does not change its
        # weight.
        difference = np.where(visible[:, None], (values - self.expected) / self.exposure, 0.0)
        cost, slope = robust(np.square(difference).sum(1), COLOUR_ROBUST_SCALE)
        factor = self.photo.weight * COLOUR_WEIGHT * self.agreement * REFERENCE_POINTS / len(points)
        by_value = (2.0 * factor * slope)[:, None] * difference / self.exposure
        gradient_px = np.stack([(by_value * by_x).sum(1), (by_value * by_y).sum(1)], 1)
        return factor * float(cost.sum()), projected.pull_back(gradient_px)


def _visible(points: Array, photo: Photo) -> tuple[Projected, NDArray[np.bool_]]:
    """The projection of ``points`` [N, 3], and which of them are visible on the mask, [N]."""
    projected = project_differentiably(points, photo.camera)
    depth = points @ photo.camera.R[2] + photo.camera.t[2]
    height, width = photo.inside.shape
    place, on = pixels_under(projected.points_px, projected.valid, height, width)
    front = np.full(height * width, np.inf)
    np.minimum.at(front, place[on], depth[on])
    padded = np.pad(front.reshape(height, width), 1, constant_values=np.inf)
    front = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).min((2, 3)).ravel()
    return projected, on & photo.inside.ravel()[place] & (depth <= front[place] + OCCLUSION_DEPTH)


def _sampled(image: Array, points_px: Array) -> tuple[Array, Array, Array]:
    """``image`` [H, W, C] at ``points_px`` [N, 2], and its derivatives by x and y: [N, C] each.

    Values are interpolated bilinearly; outside the image they equal the border.
    """
    last = np.array(image.shape[1::-1]) - 1.0
    place = np.clip(np.nan_to_num(points_px), 0.0, last)
    within = ((points_px > 0.0) & (points_px < last)).astype(float)
    low = np.minimum(place.astype(np.int64), np.maximum(last - 1.0, 0.0).astype(np.int64))
    high = np.minimum(low + 1, last.astype(np.int64))
    right, down = (place - low)[:, :1], (place - low)[:, 1:]
    (x0, y0), (x1, y1) = low.T, high.T
    top = image[y0, x0] * (1.0 - right) + image[y0, x1] * right
    bottom = image[y1, x0] * (1.0 - right) + image[y1, x1] * right
    by_x = (image[y0, x1] - image[y0, x0]) * (1.0 - down) + (image[y1, x1] - image[y1, x0]) * down
    return top * (1.0 - down) + bottom * down, by_x * within[:, :1], (bottom - top) * within[:, 1:]


def _detail(image: Array, weight: Array, sigma: float) -> Array:
    """A Gaussian blur of standard deviation ``sigma`` px, minus a blur of four times this."""
    return _blurred(image, weight, sigma) - _blurred(image, weight, COARSE_BLUR * sigma)


def _blurred(image: Array, weight: Array, sigma: float) -> Array:
    """Gaussian blur of ``image`` [H, W, 3] over pixels weighted by ``weight`` [H, W].

    It is 0 far from all pixels of positive weight.
    """
    both = np.concatenate([image * weight[..., None], weight[..., None]], 2)
    for axis in (0, 1):
        along = np.arange(both.shape[axis])
        kernel = np.exp(-0.5 * np.square((along[:, None] - along) / sigma))
        both = np.moveaxis(np.tensordot(kernel, both, (1, axis)), 0, axis)
    blurred: Array = both[..., :3] / np.maximum(both[..., 3:], TINY)
    return blurred
