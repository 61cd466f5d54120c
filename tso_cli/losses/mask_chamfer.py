"""Mask Chamfer loss: points cover each foreground pixel, and none lies outside the mask."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array, Bits
from ..geometry.resampling import nearest_cell
from .nearest import nearest
from .projection import pixels_under

# Lengths are stated in pixels of an image whose longer side has 64 pixels.
REFERENCE_SIDE = 64.0
# A point covers a pixel if its distance, px, to the pixel's centre is at most this: half the
# diagonal of a pixel, which is the largest distance from a point to the nearest centre.
COVERED_WITHIN = 0.7
# Standard deviation across a part, px, from which on pixels resolve it: a strip 2.8 px wide.
RESOLVED = 0.8
# The steps [9, 2] from a pixel to itself and to the eight around it.
NEIGHBOURS = np.argwhere(np.ones((3, 3))) - 1
# Points outside the mask weigh as if the cloud had this many points, because the density of a cloud
# says nothing about its error.
REFERENCE_POINTS = 1024.0


@dataclass(frozen=True, eq=False)
class MaskTarget:
    """A mask, prepared for the mask Chamfer loss.

    Attributes
    ----------
    inside, outside : [H, W] bool, pixels known to be foreground and background.
    bounds : left, top, right and bottom edge of the image that contains the mask, in pixels of the
        mask.
    cells_per_mask_pixel : factor, at least 1, by which the mask was enlarged: the pixels here are
        cells of the window, and the original mask knows no detail finer than this many cells.
    truncated : whether the object extends beyond the border of its image.
    """

    inside: Bits
    outside: Bits
    bounds: tuple[float, float, float, float]
    cells_per_mask_pixel: float = 1.0
    truncated: bool = False

    @classmethod
    def of(
        cls,
        mask: Array,
        known: Array | None = None,
        bounds: tuple[float, float, float, float] | None = None,
        cells_per_mask_pixel: float = 1.0,
        truncated: bool = False,
    ) -> MaskTarget:
        """From ``mask`` [H, W] in [0, 1] and ``known`` [H, W], where a pixel under 0.5 is unknown.

        ``bounds`` is None for the mask of a whole image.
        """
        height, width = mask.shape
        bounds = bounds or (-0.5, -0.5, width - 0.5, height - 0.5)
        return cls(*sides(mask, known), bounds, cells_per_mask_pixel, truncated)

    @property
    def scale(self) -> float:
        """Pixels of an image of 64 in one pixel of the mask."""
        return REFERENCE_SIDE / max(self.inside.shape)

    @property
    def pixels(self) -> float:
        """Area of the foreground, in pixels of an image of 64."""
        return float(self.inside.sum()) * self.scale**2

    @cached_property
    def nearest_foreground(self) -> NDArray[np.int64]:
        """[H, W, 2] row and column of the nearest foreground pixel."""
        height, width = self.inside.shape
        return np.stack(np.divmod(nearest_cell(self.inside, max(height, width)), width), -1)

    def observed(self, points_px: Array, valid: Bits) -> Bits:
        """[N] which points can be compared with the mask.

        If the object is truncated, these are the points in the image.
        """
        return valid & self.in_image(points_px) if self.truncated else valid

    def in_image(self, points_px: Array) -> Bits:
        """[N] which points [N, 2] fall in the image; the mask may show a part of it."""
        return np.asarray(((points_px >= self.bounds[:2]) & (points_px <= self.bounds[2:])).all(1))


def sides(mask: Array, known: Array | None = None) -> tuple[Bits, Bits]:
    """Pixels [H, W] known to be foreground, and known to be background.

    ``mask`` and ``known`` are as in `MaskTarget.of`.

    A foreground pixel is more than half covered. If an object is so thin that no pixel is half
    covered, a foreground pixel is covered more than half as much as the most covered pixel.
    """
    covered = mask if known is None else np.where(known >= 0.5, mask, 0.0)
    most = covered.max()
    inside = covered > 0.5 * (1.0 if most > 0.5 else most)
    return inside, ~inside if known is None else ~inside & (known >= 0.5)


def mask_chamfer(
    points_px: Array, valid: Bits, target: MaskTarget, resolved: Array | None = None
) -> tuple[float, Array]:
    """Attract points to uncovered foreground pixels, and points outside the mask to the mask.

    1. A foreground pixel attracts its nearest point if this point is further away than 0.7 px.
    2. A point on a background pixel is attracted by the nearest foreground pixel.
    3. If the border of the image truncates the object, a point beyond the border costs nothing, and
       neither does a pixel whose nearest point lies there.

    Each pair costs the square of its distance, in pixels of an image whose longer side has 64.

    Parameters
    ----------
    points_px, valid : [N, 2] column and row, [N] bool.
    resolved : [N] weights of points outside the mask (`resolved_share`); None for 1.

    Returns
    -------
    The loss, a sum over pixels of an image of 64 and over points, as if the cloud had 1,024 points;
    infinite if no point is observed. [N, 2] its gradient by ``points_px``.
    """
    gradient = np.zeros((len(points_px), 2))
    observed = target.observed(points_px, valid)
    if not observed.any():
        return np.inf, gradient
    area = target.scale**2
    owner, of_pixels = _uncovered(points_px, valid, observed, target)
    for axis in (0, 1):
        gradient[:, axis] = np.bincount(owner, 2.0 * area**2 * of_pixels[:, axis], len(points_px))
    outside, of_points = _outside_mask(points_px, observed, target)
    weight = np.full((len(outside), 1), REFERENCE_POINTS / len(points_px))
    if resolved is not None:
        weight *= resolved[outside, None]
    gradient[outside] += 2.0 * area * weight * of_points
    squares = area * np.square(of_pixels).sum() + (weight * np.square(of_points)).sum()
    return float(area * squares), gradient


def resolved_share(parts_px: Array, cells_per_mask_pixel: float = 1.0) -> Array:
    """[N] how far pixels resolve the part of the cloud around each point, in [0, 1].

    A part that is very thin, or seen edge-on, can lie outside the mask only because the mask has
    lost it. ``parts_px`` [N, K, 2] are the projected neighbours of N points. Their variance across,
    in pixels of the original mask (see `MaskTarget`), over that of a part that is fully resolved.
    """
    x, y = np.moveaxis(parts_px - parts_px.mean(1, keepdims=True), 2, 0)
    xx, yy, xy = (np.einsum("nk,nk->n", *pair) for pair in ((x, x), (y, y), (x, y)))
    # The smaller eigenvalue of the covariance is the variance across.
    across = ((xx + yy) / 2.0 - np.hypot((xx - yy) / 2.0, xy)) / parts_px.shape[1]
    share: Array = np.clip(across / (RESOLVED * cells_per_mask_pixel) ** 2, 0.0, 1.0)
    return share


def _uncovered(
    points_px: Array, valid: Bits, observed: Bits, target: MaskTarget
) -> tuple[NDArray[np.int64], Array]:
    """The nearest point [P] of each uncovered foreground pixel, and point minus pixel [P, 2].

    A pixel is left out if its nearest point is not observed.
    """
    (candidates,) = np.nonzero(valid)
    if not len(candidates):
        return np.empty(0, np.int64), np.empty((0, 2))
    within = COVERED_WITHIN * target.cells_per_mask_pixel
    # Most pixels are covered by a point on them or next to them, which is quickly seen.
    around = np.rint(points_px) + NEIGHBOURS[:, None]
    right, down = np.moveaxis(around - points_px, -1, 0)
    covering = around[valid & (right * right + down * down <= within**2)]
    pixel, in_image = pixels_under(covering, np.ones(len(covering), bool), *target.inside.shape)
    uncovered = target.inside.copy()
    uncovered.ravel()[pixel[in_image]] = False
    rows, columns = np.nonzero(uncovered)
    pixels = np.stack([columns, rows], 1).astype(float)
    owner = candidates[nearest(pixels, points_px[candidates])]
    offsets = points_px[owner] - pixels
    far = observed[owner] & (np.square(offsets).sum(1) > within**2)
    return owner[far], offsets[far]


def _outside_mask(
    points_px: Array, observed: Bits, target: MaskTarget
) -> tuple[NDArray[np.int64], Array]:
    """The points on background [P], and each minus the foreground pixel nearest to it [P, 2]."""
    height, width = target.inside.shape
    compared = observed & target.in_image(points_px)
    # The image beyond the mask's part of it is as the nearest pixel of this part.
    clamped = np.clip(np.where(compared[:, None], points_px, 0.0), 0.0, (width - 1.0, height - 1.0))
    pixel, _ = pixels_under(clamped, compared, height, width)
    (outside,) = np.nonzero(compared & target.outside.ravel()[pixel])
    row, column = target.nearest_foreground.reshape(-1, 2)[pixel[outside]].T
    return outside, points_px[outside] - np.stack([column, row], 1)
