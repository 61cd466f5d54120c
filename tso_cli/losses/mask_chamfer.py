"""Mask Chamfer loss: points cover each foreground pixel and do not fall on background."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .nearest import nearest
from .projection import pixels_under

Array = NDArray[np.float64]
Marks = NDArray[np.bool_]

# Lengths are stated in pixels of an image whose longer side has 64.
REFERENCE_SIDE = 64.0
# Distance, px, at which a point covers a pixel's centre: half the diagonal of a pixel, the most to the nearest centre.
COVERED_WITHIN = 0.7
# Pixels at most so far from a point's own, along rows and columns, are tried first as those that it is nearest to.
REACH = 2
# Standard deviations across a part, px, that pixels just fail to resolve, and that they surely resolve.
THIN, THICK = 0.2, 0.8
# Stray points are weighted as if a cloud had so many: sampling density says nothing of how wrong a cloud is.
REFERENCE_POINTS = 1024.0


@dataclass(frozen=True, eq=False)
class MaskTarget:
    """A mask, prepared for the mask Chamfer loss.

    Attributes
    ----------
    inside, outside : [H, W] bool, pixels known to be foreground and background.
    bounds : left, top, right, bottom edges of the image that the mask is a part of, in pixels of the mask.
    grain : factor by which the mask was enlarged: no detail finer than so many of its pixels is known.
    truncated : whether the object extends beyond the border of its image.
    """

    inside: Marks
    outside: Marks
    bounds: tuple[float, float, float, float]
    grain: float = 1.0
    truncated: bool = False

    @classmethod
    def of(
        cls,
        mask: Array,
        known: Array | None = None,
        bounds: tuple[float, float, float, float] | None = None,
        grain: float = 1.0,
        truncated: bool = False,
    ) -> MaskTarget:
        """``mask`` [H, W] in [0, 1]; ``known`` [H, W], unknown under 0.5; ``bounds`` None for a whole image."""
        height, width = mask.shape
        return cls(
            *sides(mask, known), bounds or (-0.5, -0.5, width - 0.5, height - 0.5), grain, truncated
        )

    @property
    def scale(self) -> float:
        """Pixels of an image of 64 to one of the mask."""
        return REFERENCE_SIDE / max(self.inside.shape)

    @cached_property
    def pixels(self) -> float:
        """Foreground pixels, of an image of 64."""
        return float(self.inside.sum()) * self.scale**2

    @cached_property
    def foreground(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows and columns of the foreground pixels."""
        rows, columns = np.nonzero(self.inside)
        return rows, columns

    @cached_property
    def nearest_in_column(self) -> NDArray[np.int64]:
        """[H, W] row of the foreground pixel nearest to each pixel among those of its column, of two the upper; -1 without."""
        height = len(self.inside)
        rows = np.arange(height)[:, None]
        above = np.maximum.accumulate(np.where(self.inside, rows, -height), 0)
        below = np.minimum.accumulate(np.where(self.inside, rows, 2 * height)[::-1], 0)[::-1]
        near = np.where(rows - above <= below - rows, above, below)
        return np.where((near >= 0) & (near < height), near, -1)

    @cached_property
    def nearest_foreground(self) -> NDArray[np.int64]:
        """[H, W, 2] row and column of the foreground pixel nearest to each pixel, of equals the leftmost."""
        height, width = self.inside.shape
        near = self.nearest_in_column
        squared = np.where(near < 0, 1 << 40, np.square(near - np.arange(height)[:, None]))
        across = np.square(np.arange(width)[:, None] - np.arange(width))  # [W, W]
        columns = np.stack([(across + line).argmin(1) for line in squared])  # [H, W]
        return np.stack([np.take_along_axis(near, columns, 1), columns], -1)

    def observed(self, points_px: Array, valid: Marks) -> Marks:
        """[N] which points the mask can judge: of a truncated object, those within the image."""
        return valid & self.in_image(points_px) if self.truncated else valid

    def in_image(self, points_px: Array) -> Marks:
        """[N] which points [N, 2] fall within the image, in the mask's part of it or beside that."""
        return np.asarray(((points_px >= self.bounds[:2]) & (points_px <= self.bounds[2:])).all(1))


def sides(mask: Array, known: Array | None = None) -> tuple[Marks, Marks]:
    """Pixels [H, W] known to be foreground and background; ``mask`` and ``known`` as in `MaskTarget.of`.

    Foreground is over half covered; of an object so thin that no pixel is, over half as covered as its best.
    """
    covered = mask if known is None else np.where(known >= 0.5, mask, 0.0)
    most = covered.max()
    inside = covered > 0.5 * (1.0 if most > 0.5 else most)
    return inside, ~inside if known is None else ~inside & (known >= 0.5)


def mask_chamfer(
    points_px: Array,
    valid: Marks,
    target: MaskTarget,
    robust_scale: float,
    resolvability: Array | None = None,
) -> tuple[Array, Array]:
    """Attract points to uncovered foreground pixels, and points on background to the mask.

    A foreground pixel whose nearest point is further than 0.7 px attracts that point; the nearest foreground pixel attracts a
    point on a background pixel. With d the distance in pixels of an image whose longer side has 64, each pair costs
    ``rho(d) = d^2 r^2 / (r^2 + d^2)`` (Geman and McClure): the square of small distances, while pairs many times the robust
    scale r apart, likely no counterparts, have next to no gradient. Where the border truncates the object, points beyond it
    cost nothing, nor do pixels whose nearest point is one of them.

    Parameters
    ----------
    points_px, valid : [N, 2] column and row, [N] bool.
    robust_scale : r, pixels of an image of 64.
    resolvability : [N] weights in [0, 1] of points on background; None for 1.

    Returns
    -------
    [N] what each point adds to the loss, a sum over pixels of an image of 64, and over points as if the cloud had 1,024; a
    pixel's cost goes to the point it attracts. [N, 2] the gradient of the loss by ``points_px``.
    """
    costs, gradient = np.zeros(len(points_px)), np.zeros((len(points_px), 2))
    observed = target.observed(points_px, valid)
    area = target.scale**2

    owner, offsets = _uncovered(points_px, valid, observed, target)
    cost, slope = robust(np.square(offsets).sum(1) * area, robust_scale)
    costs += np.bincount(owner, cost * area, len(costs))
    for axis in (0, 1):
        gradient[:, axis] += np.bincount(
            owner, 2.0 * area * area * slope * offsets[:, axis], len(costs)
        )

    stray, offsets = _stray(points_px, observed, target)
    weight = (
        REFERENCE_POINTS / len(points_px) * (1.0 if resolvability is None else resolvability[stray])
    )
    cost, slope = robust(np.square(offsets).sum(1) * area, robust_scale)
    costs[stray] += weight * cost
    gradient[stray] += (2.0 * area * weight * slope)[:, None] * offsets
    return costs, gradient


def _uncovered(
    points_px: Array, valid: Marks, observed: Marks, target: MaskTarget
) -> tuple[NDArray[np.int64], Array]:
    """For each uncovered foreground pixel the point nearest to it [P], and that point minus the pixel [P, 2].

    Pixels whose nearest point is not observed are left out.
    """
    (candidates,) = np.nonzero(valid)
    if not len(candidates):
        return np.empty(0, np.int64), np.empty((0, 2))
    within = COVERED_WITHIN * target.grain
    near, pixels = _nearest_to_uncovered(REACH, points_px[candidates], target, within)
    (far,) = np.nonzero(near < 0)
    near[far] = nearest(pixels[far], points_px[candidates])
    owner = candidates[near]
    offsets = points_px[owner] - pixels
    kept = observed[owner] & (np.square(offsets).sum(1) > within**2)
    return owner[kept], offsets[kept]


def _nearest_to_uncovered(
    reach: int, points_px: Array, target: MaskTarget, within: float
) -> tuple[NDArray[np.int64], Array]:
    """The foreground pixels [P, 2] with no point ``within`` so many px, and of each the nearest point's index [P].

    The index is -1 where no point is within ``reach`` + 0.5 px. Most pixels have one: trying the few pixels around each point
    is faster than all points for each pixel.
    """
    height, width = target.inside.shape
    margin = 2 * reach + 1
    padded = width + 2 * margin
    x, y = np.ascontiguousarray(points_px.T)
    (inside,) = np.nonzero(
        (x > -reach - 1.0) & (x < width + reach) & (y > -reach - 1.0) & (y < height + reach)
    )
    x, y = x[inside], y[inside]
    column, row = np.rint(x), np.rint(y)
    steps = np.arange(-reach, reach + 1)
    squared_rows, squared_columns = (
        np.square(nearest - at + steps[:, None]) for nearest, at in ((row, y), (column, x))
    )
    pixel = ((row + margin) * padded + column + margin).astype(np.int64) + steps[:, None]
    # One row of places around the points at a time: arrays that stay in the cache.
    pairs = [
        ((pixel + down * padded).ravel(), (squared + squared_columns).ravel())
        for down, squared in zip(steps, squared_rows, strict=True)
    ]
    point = np.tile(inside, len(steps))
    furthest = (reach + 0.5) ** 2
    least = np.full((height + 2 * margin) * padded, furthest)
    for pixels, squared in pairs:
        np.minimum.at(least, pixels, squared)
    rows, columns = target.foreground
    flat = (rows + margin) * padded + columns + margin
    (uncovered,) = np.nonzero((least[flat] > within**2) | (least[flat] >= furthest))
    flat = flat[uncovered]
    sought = np.full(len(least), -1.0)
    sought[flat] = least[flat]
    owner = np.full(len(least), len(points_px))
    for pixels, squared in pairs:
        (nearest_ones,) = np.nonzero(squared == sought[pixels])
        # Points that mirror each other are often equally far: the first is taken.
        np.minimum.at(owner, pixels[nearest_ones], point[nearest_ones])
    owner = np.where(owner < len(points_px), owner, -1)
    return owner[flat], np.stack([columns[uncovered], rows[uncovered]], 1).astype(float)


def _stray(
    points_px: Array, observed: Marks, target: MaskTarget
) -> tuple[NDArray[np.int64], Array]:
    """The points that fall on background [P], and each minus the foreground pixel nearest to its own pixel [P, 2]."""
    height, width = target.inside.shape
    judged = observed & target.in_image(points_px)
    # Beside the mask's part of the image it is background like that part's rim.
    clamped = np.clip(np.where(judged[:, None], points_px, 0.0), 0.0, (width - 1.0, height - 1.0))
    pixel, _ = pixels_under(clamped, judged, height, width)
    (stray,) = np.nonzero(judged & target.outside.ravel()[pixel])
    row, column = target.nearest_foreground.reshape(-1, 2)[pixel[stray]].T
    return stray, points_px[stray] - np.stack([column, row], 1)


def robust(squared: Array, robust_scale: float) -> tuple[Array, Array]:
    """Geman and McClure's cost of squared distances, and its derivative by them.

    The square where small, at most ``robust_scale`` squared.
    """
    inlier = robust_scale**2 / (robust_scale**2 + squared)
    return squared * inlier, np.square(inlier)


def resolvability(patches_px: Array, grain: float = 1.0) -> Array:
    """How far pixels resolve a part: one seen edge-on, or very thin, says little by lying beside the mask.

    Of the projected neighbours ``patches_px`` [M, K, 2] of a node, the smaller standard deviation in pixels of ``grain`` (as
    in `MaskTarget`) gives 0 under 0.2 px, that of a strip 0.7 px wide, 1 over 0.8 px, linear between. [M]
    """
    # A product with equal weights is a mean, and for so few neighbours five times as fast.
    equal = np.full(patches_px.shape[1], 1.0 / patches_px.shape[1])
    x, y = (part - (part @ equal)[:, None] for part in (patches_px[:, :, 0], patches_px[:, :, 1]))
    xx, yy, xy = np.square(x) @ equal, np.square(y) @ equal, (x * y) @ equal
    # The smaller eigenvalue of the covariance is the variance across.
    across = np.sqrt(np.maximum((xx + yy) / 2.0 - np.hypot((xx - yy) / 2.0, xy), 0.0)) / grain
    resolved: Array = np.clip((across - THIN) / (THICK - THIN), 0.0, 1.0)
    return resolved
