"""Mask Chamfer loss: points cover each foreground pixel and do not fall on background."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import torch
from torch import Tensor

from ..kernels.dispatch import use_numba
from ..kernels.nearest import nearest_marked, nearest_points
from .projection import pixels_under

# Lengths are stated in pixels of an image whose longer side has 64.
REFERENCE_SIDE = 64.0
# A point covers a pixel whose centre is this near, px: as far as a point may be from the nearest pixel's centre.
COVERED_WITHIN = 0.7
# Largest radius, px, within which the pixels around a point are marked as covered; beyond it, as in much enlarged masks, pixels
# search for their nearest point and measure the distance.
MARKED_WITHIN = 3.0
# Standard deviations across a part, px, that pixels just fail to resolve, and that they surely resolve.
THIN, THICK = 0.2, 0.8
# Stray points are weighted as if a cloud had so many: sampling density says nothing of how wrong a cloud is.
REFERENCE_POINTS = 1024.0


class MaskTarget(NamedTuple):
    """M masks, prepared for the mask Chamfer loss.

    Attributes
    ----------
    inside, outside : [M, H, W] bool, pixels known to be foreground and background.
    nearest_rows, nearest_columns : [M, H, W] int64, the foreground pixel nearest to each pixel, -1 without any.
    bounds : [M, 4] left, top, right, bottom edges of the image that the mask is a part of, in pixels of the mask.
    grain : [M] factor by which the mask was enlarged: no detail finer than so many of its pixels is known.
    truncated : [M] bool, whether the object extends beyond the border of its image; None where none does.
    """

    inside: Tensor
    outside: Tensor
    nearest_rows: Tensor
    nearest_columns: Tensor
    bounds: Tensor
    grain: Tensor
    truncated: Tensor | None

    @classmethod
    def of(
        cls, mask: Tensor, known: Tensor | None = None, bounds: Tensor | None = None, grain: Tensor | None = None
    ) -> MaskTarget:
        """``mask`` [M, H, W] in [0, 1]; ``known`` [M, H, W], unknown under 0.5; ``bounds`` [M, 4], None for a mask that is the
        whole image; ``grain`` [M], None for 1."""
        inside, outside = sides(mask, known)
        if bounds is None:
            height, width = mask.shape[1:]
            bounds = mask.new_tensor([-0.5, -0.5, width - 0.5, height - 0.5]).expand(len(mask), 4)
        truncated = _touches_border(inside, bounds)
        grain = mask.new_ones(len(mask)) if grain is None else grain
        return cls(inside, outside, *nearest_marked(inside), bounds, grain, truncated if bool(truncated.any()) else None)

    @property
    def scale(self) -> float:
        """Pixels of an image of 64 to one of the mask."""
        return REFERENCE_SIDE / max(self.inside.shape[-2:])

    def observed(self, points_px: Tensor, valid: Tensor) -> Tensor:
        """[M, N] which points [M, N, 2] a mask can judge: of a truncated object, those within the image."""
        if self.truncated is None:
            return valid
        return torch.where(self.truncated.unsqueeze(1), valid & self.in_image(points_px), valid)

    def in_image(self, points_px: Tensor) -> Tensor:
        """[M, N] which points [M, N, 2] fall within the image, in the mask's part of it or beside that."""
        first, last = self.bounds[:, None, :2], self.bounds[:, None, 2:]
        return ((points_px >= first) & (points_px <= last)).all(-1)

    def pixels(self) -> Tensor:
        """[M] foreground pixels, of an image of 64."""
        return self.inside.flatten(1).sum(1) * self.scale**2


def _touches_border(inside: Tensor, bounds: Tensor) -> Tensor:
    """[M] whether foreground [M, H, W] lies next to a border of the image that is within the mask."""
    touches = torch.zeros(len(inside), dtype=torch.bool, device=inside.device)
    for marked, first, last in ((inside.any(1), bounds[:, 0], bounds[:, 2]), (inside.any(2), bounds[:, 1], bounds[:, 3])):
        size = marked.shape[1]
        # The pixels next to the border; it may cut through one of them.
        for place in (first.ceil(), last.floor()):
            exists = (place >= -0.5) & (place < size)
            touches |= exists & marked.gather(1, place.clamp(0, size - 1).long().unsqueeze(1)).squeeze(1)
    return touches


def sides(mask: Tensor, known: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Pixels [M, H, W] known to be foreground and background; ``mask`` and ``known`` as in `MaskTarget.of`.

    Foreground is over half covered; of an object so thin that no pixel is, over half as covered as its best.
    """
    covered = mask if known is None else torch.where(known >= 0.5, mask, 0.0)
    most = covered.flatten(1).amax(1)
    inside = covered > 0.5 * torch.where(most > 0.5, 1.0, most).view(-1, 1, 1)
    return inside, ~inside if known is None else ~inside & (known >= 0.5)


def mask_chamfer_loss(
    points_px: Tensor,
    valid: Tensor,
    target: MaskTarget,
    robust_scale: float,
    counts: Tensor | None = None,
    resolvability: Tensor | None = None,
) -> Tensor:
    """Attract points to uncovered foreground pixels, and points on background to the mask.

    A foreground pixel whose nearest point is further than 0.7 px attracts that point; the nearest foreground pixel attracts a
    point on a background pixel. With d the distance in pixels of an image whose longer side has 64, each pair costs
    ``rho(d) = d^2 r^2 / (r^2 + d^2)`` (Geman and McClure): the square of small distances, while pairs many times the robust
    scale r apart, likely no counterparts, have next to no gradient. Where the border truncates the object, points beyond it
    cost nothing, nor do pixels whose nearest point is one of them.

    Parameters
    ----------
    points_px, valid : [M, N, 2] column and row, [M, N] bool.
    robust_scale : r, pixels of an image of 64. counts : [M] points of each cloud; None for N.
    resolvability : [M, N] weights in [0, 1] of points on background; None for 1.

    Returns
    -------
    [M], differentiable in ``points_px``: sum over pixels of an image of 64, and over points as if a cloud had 1,024.
    """
    if not use_numba(points_px):
        return mask_chamfer_of_points(points_px, valid, target, robust_scale, counts, resolvability).sum(1)
    from ..kernels.mask_chamfer_numba import mask_chamfer_loss as compiled

    observed, weights, factor = _weights(points_px, valid, target, counts, resolvability)
    within = COVERED_WITHIN * target.grain
    return compiled(points_px, valid, observed, weights * factor, target[:5], within, target.scale, robust_scale)


def mask_chamfer_of_points(
    points_px: Tensor,
    valid: Tensor,
    target: MaskTarget,
    robust_scale: float,
    counts: Tensor | None = None,
    resolvability: Tensor | None = None,
) -> Tensor:
    """[M, N] what each point adds to `mask_chamfer_loss`; a pixel's cost goes to the point it attracts."""
    observed, weights, factor = _weights(points_px, valid, target, counts, resolvability)
    uncovered = _uncovered_cost(points_px, valid, observed, target, robust_scale)
    return uncovered + weights * _background_cost(points_px, observed, target, robust_scale) * factor


def _weights(
    points_px: Tensor, valid: Tensor, target: MaskTarget, counts: Tensor | None, resolvability: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    """[M, N] the observed points, [M, N] their weights on background, and [M, 1] a factor of these."""
    observed = target.observed(points_px.detach(), valid)
    size = points_px.new_full((len(valid),), points_px.shape[1]) if counts is None else counts.to(points_px)
    weights = observed.to(points_px) if resolvability is None else torch.where(observed, resolvability, 0.0)
    return observed, weights, (REFERENCE_POINTS / size).unsqueeze(1)


def resolvability(patches_px: Tensor, grain: Tensor | None = None) -> Tensor:
    """How far pixels resolve a part: one seen edge-on, or very thin, says little by lying beside the mask.

    Of the projected neighbours ``patches_px`` [..., K, 2] of a point, the smaller standard deviation in pixels of ``grain``
    [...] (as in `MaskTarget`; None for 1) gives 0 under 0.2 px, that of a strip 0.7 px wide, 1 over 0.8 px, linear between.
    """
    x, y = (patches_px - patches_px.mean(-2, keepdim=True)).unbind(-1)
    xx, yy, xy = x.square().mean(-1), y.square().mean(-1), (x * y).mean(-1)
    # The smaller eigenvalue of the covariance is the variance across.
    mean, difference = (xx + yy) / 2.0, ((xx - yy) / 2.0).square() + xy.square()
    across = (mean - difference.sqrt()).clamp_min(0.0).sqrt()
    if grain is not None:
        across = across / grain
    return ((across - THIN) / (THICK - THIN)).clamp(0.0, 1.0)


def _uncovered_cost(points_px: Tensor, valid: Tensor, observed: Tensor, target: MaskTarget, robust_scale: float) -> Tensor:
    """[M, N] cost of the uncovered foreground pixels, at the observed points nearest to them."""
    within, pixels = COVERED_WITHIN * target.grain, target.inside
    marked = bool((within <= MARKED_WITHIN).all())
    if marked:
        pixels = pixels & ~_covered(points_px.detach(), valid, target.inside.shape[-2:], within)
    index = nearest_points(pixels, points_px, valid)
    index = torch.where(observed.gather(1, index.clamp_min(0).flatten(1)).view_as(index), index, -1)
    image, row, column = torch.nonzero(index >= 0, as_tuple=True)
    centres = torch.stack([column, row], 1).to(points_px)
    squared = (points_px[image, index[image, row, column]] - centres).square().sum(1)
    if not marked:
        far = squared.detach() > within[image].square()
        image, row, column, squared = image[far], row[far], column[far], squared[far]
    area = target.scale**2
    number = image * points_px.shape[1] + index[image, row, column]
    cost = points_px.new_zeros(points_px.shape[:2].numel()).index_add(0, number, robust(squared * area, robust_scale) * area)
    return cost.view(points_px.shape[:2])


def _covered(points_px: Tensor, valid: Tensor, size: torch.Size, within: Tensor) -> Tensor:
    """[M, H, W], whether a point lies ``within`` [M] px of the pixel's centre: these need not search for their nearest."""
    height, width = size
    radius, squared = float(within.max()), within.square().unsqueeze(1)
    # A border of one pixel takes what falls outside, and invalid points.
    covered = torch.zeros(len(points_px), (height + 2) * (width + 2), dtype=torch.bool, device=points_px.device)
    x, y = torch.where(valid.unsqueeze(-1), points_px, -2.0 - radius).movedim(-1, 0).contiguous()
    # A point further outside than this is near no pixel, and its number would not fit.
    x, y = x.clamp(-2.0 - radius, width + radius + 1.0), y.clamp(-2.0 - radius, height + radius + 1.0)
    column, row = x.round(), y.round()
    steps = range(-math.ceil(radius + 0.5) + 1, math.ceil(radius + 0.5))
    across, down = ([((c + step), (c + step - x).square()) for step in steps] for x, c in ((x, column), (y, row)))
    for (columns, x_squared), (rows, y_squared) in itertools.product(across, down):
        inside = (x_squared + y_squared <= squared) & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        covered.scatter_(1, torch.where(inside, (rows + 1.0) * (width + 2) + columns + 1.0, 0.0).long(), True)
    return covered.view(-1, height + 2, width + 2)[:, 1:-1, 1:-1]


def _background_cost(points_px: Tensor, observed: Tensor, target: MaskTarget, robust_scale: float) -> Tensor:
    """[M, N] cost of the points on background, by their distance to the mask; 0 for all others."""
    height, width = target.inside.shape[-2:]
    # Beside the mask's part of the image it is background like that part's rim.
    clamped = torch.minimum(points_px.detach().clamp_min(0.0), points_px.new_tensor([width - 1.0, height - 1.0]))
    pixel, in_image = pixels_under(clamped, observed & target.in_image(points_px.detach()), height, width)
    rows, columns, outside = (
        image.flatten(1).gather(1, pixel) for image in (target.nearest_rows, target.nearest_columns, target.outside)
    )
    stray = in_image & outside & (rows >= 0)
    nearest_px = torch.stack([columns, rows], -1).to(points_px)
    squared = torch.where(stray.unsqueeze(-1), points_px - nearest_px, 0.0).square().sum(-1) * target.scale**2
    return robust(squared, robust_scale)


def robust(squared: Tensor, robust_scale: float) -> Tensor:
    """Geman and McClure's cost of squared distances: the square where small, at most ``robust_scale`` squared."""
    return squared * robust_scale**2 / (robust_scale**2 + squared)
