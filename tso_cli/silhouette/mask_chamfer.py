"""What a mask asks of projected points directly: cover each of its pixels, and do not fall beside it."""

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
# A pixel is covered once a point falls this near to its centre, px: as far as a point may be from the nearest pixel's centre.
COVERED_WITHIN = 0.7
# Cells around a point that are marked one by one as near to it, at most so far away; of a mask enlarged by more, cells look for
# their nearest point all the same.
MARKED_WITHIN = 3.0
# Standard deviations across parts, px: those that pixels just do not show, and those that they surely do.
THIN, THICK = 0.2, 0.8
# Points that stray are counted as if a cloud had so many: how densely a cloud is sampled says nothing of how wrong it is.
REFERENCE_POINTS = 1024.0


class MaskTarget(NamedTuple):
    """What M masks ask of points.

    Attributes
    ----------
    inside, outside : [M, H, W] bool, pixels known to be foreground and background.
    goal_rows, goal_columns : [M, H, W] int64, the foreground pixel nearest to each pixel.
    bounds : [M, 4] left, top, right, bottom edges of the image that the mask is a part of, in pixels of the mask.
    grain : [M] how many times the mask was enlarged: nothing finer than so many of its pixels is known.
    cut : [M] bool, whether the object goes on beyond the border of its image; None where none does.
    """

    inside: Tensor
    outside: Tensor
    goal_rows: Tensor
    goal_columns: Tensor
    bounds: Tensor
    grain: Tensor
    cut: Tensor | None

    @classmethod
    def of(
        cls, mask: Tensor, known: Tensor | None = None, bounds: Tensor | None = None, grain: Tensor | None = None
    ) -> MaskTarget:
        """``mask`` [M, H, W] in [0, 1]; ``known`` [M, H, W], where it is under 0.5 nothing is asked; ``bounds`` [M, 4], None
        for a mask that is the whole image; ``grain`` [M], how many times the mask was enlarged, None for 1."""
        inside, outside = sides(mask, known)
        if bounds is None:
            height, width = mask.shape[1:]
            bounds = mask.new_tensor([-0.5, -0.5, width - 0.5, height - 0.5]).expand(len(mask), 4)
        cut = _touches(inside, bounds)
        grain = mask.new_ones(len(mask)) if grain is None else grain
        return cls(inside, outside, *nearest_marked(inside), bounds, grain, cut if bool(cut.any()) else None)

    @property
    def side(self) -> int:
        """Pixels along the longer side."""
        return max(self.inside.shape[-2:])

    def asked(self, points_px: Tensor, valid: Tensor) -> Tensor:
        """[M, N] which points [M, N, 2] a mask tells something of: of a cut object, those within the picture."""
        if self.cut is None:
            return valid
        return torch.where(self.cut.unsqueeze(1), valid & self.shows(points_px), valid)

    def shows(self, points_px: Tensor) -> Tensor:
        """[M, N] which points [M, N, 2] fall within the image, in the mask's part of it or beside that."""
        first, last = self.bounds[:, None, :2], self.bounds[:, None, 2:]
        return ((points_px >= first) & (points_px <= last)).all(-1)

    def pixels(self) -> Tensor:
        """[M] foreground pixels, of an image of 64."""
        return self.inside.flatten(1).sum(1) * (REFERENCE_SIDE / self.side) ** 2


def _touches(inside: Tensor, bounds: Tensor) -> Tensor:
    """[M] whether foreground [M, H, W] lies next to a border of the image, as far as the image's borders are in sight."""
    rows, columns = inside.any(2), inside.any(1)
    found = torch.zeros(len(inside), dtype=torch.bool, device=inside.device)
    for marked, first, last in ((columns, bounds[:, 0], bounds[:, 2]), (rows, bounds[:, 1], bounds[:, 3])):
        size = marked.shape[1]
        # The pixels next to the border; one of them may be cut by it.
        for place in (first.ceil(), last.floor()):
            there = (place >= -0.5) & (place < size)
            found |= there & marked.gather(1, place.clamp(0, size - 1).long().unsqueeze(1)).squeeze(1)
    return found


def sides(mask: Tensor, known: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Pixels [M, H, W] known to be foreground and background, of masks and what is known of them as in `MaskTarget.of`.

    Foreground is what is over half covered; of an object so thin that no pixel is, what is over half as covered as its best.
    """
    seen = mask if known is None else torch.where(known >= 0.5, mask, 0.0)
    most = seen.flatten(1).amax(1)
    inside = seen > 0.5 * torch.where(most > 0.5, 1.0, most).view(-1, 1, 1)
    return inside, ~inside if known is None else ~inside & (known >= 0.5)


def mask_chamfer_loss(
    points_px: Tensor,
    valid: Tensor,
    target: MaskTarget,
    reach: float,
    counts: Tensor | None = None,
    shown: Tensor | None = None,
) -> Tensor:
    """Pull points to foreground pixels that none covers, and points on background back to the mask.

    A foreground pixel whose nearest point is further than 0.7 px pulls that point; a point that falls on a background pixel
    is pulled to the nearest foreground pixel. What is covered asks for nothing. With d the distance in pixels of an image whose
    longer side has 64, each pair costs ``rho(d) = d^2 r^2 / (r^2 + d^2)`` (Geman and McClure): the square of what is near; what
    is many times the reach r away hardly pulls, since it may be no counterpart at all. Where the border cuts the object, points
    beyond it are where they should be, for all one knows, and a pixel whose nearest point is one of them asks for nothing.

    Parameters
    ----------
    points_px, valid : [M, N, 2] column and row, [M, N] bool.
    target : of M masks.
    reach : r, pixels of an image of 64.
    counts : [M] points of each cloud; None for N.
    shown : [M, N] how much it tells that a point is beside the mask, 0 to 1: see `resolved`; None for 1.

    Returns
    -------
    [M], differentiable in ``points_px``: sum over pixels of an image of 64, and over points as if a cloud had 1,024.
    """
    scale = REFERENCE_SIDE / target.side
    asked, counted, share = _asked(points_px, valid, target, counts, shown)
    if use_numba(points_px):
        from ..kernels.mask_chamfer_numba import mask_chamfer_loss as compiled_pull

        return compiled_pull(points_px, valid, asked, counted, *target[:6], scale, COVERED_WITHIN, reach, share)
    return _each(points_px, valid, asked, counted, target, scale, reach, share).sum(1)


def mask_chamfer_of_points(
    points_px: Tensor, valid: Tensor, target: MaskTarget, reach: float, counts: Tensor, shown: Tensor | None = None
) -> Tensor:
    """[M, N] what each point adds to `mask_chamfer_loss`: of a pixel, the point that it pulls."""
    asked, counted, share = _asked(points_px, valid, target, counts, shown)
    return _each(points_px, valid, asked, counted, target, REFERENCE_SIDE / target.side, reach, share)


def _asked(
    points_px: Tensor, valid: Tensor, target: MaskTarget, counts: Tensor | None, shown: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    """[M, N] which points are asked, [M, N] what each counts as a stray, and [M] what that is times."""
    asked = target.asked(points_px.detach(), valid)
    size = points_px.new_full((len(valid),), points_px.shape[1]) if counts is None else counts.to(points_px)
    return asked, asked.to(points_px) if shown is None else torch.where(asked, shown, 0.0), REFERENCE_POINTS / size


def _each(
    points_px: Tensor,
    valid: Tensor,
    asked: Tensor,
    counted: Tensor,
    target: MaskTarget,
    scale: float,
    reach: float,
    share: Tensor,
) -> Tensor:
    uncovered = _uncovered(points_px, valid, asked, target, scale, reach)
    return uncovered + counted * _stray(points_px, asked, target, scale, reach) * share.unsqueeze(1)


def resolved(patches_px: Tensor, grain: Tensor | None = None) -> Tensor:
    """Whether pixels show a part, or it is seen so edge-on, or so thin, that it tells nothing if it is beside the mask.

    Parameters
    ----------
    patches_px : [..., K, 2] where the neighbours of a point fall.

    Returns
    -------
    [...] 0 where their standard deviation across is under 0.2 px, that of a strip 0.7 px wide; 1 where it
    is over 0.8 px; evenly rising between.
    """
    x, y = (patches_px - patches_px.mean(-2, keepdim=True)).unbind(-1)
    xx, yy, xy = x.square().mean(-1), y.square().mean(-1), (x * y).mean(-1)
    half, apart = (xx + yy) / 2.0, ((xx - yy) / 2.0).square() + xy.square()
    across = (half - apart.sqrt()).clamp_min(0.0).sqrt()
    if grain is not None:
        across = across / grain
    return ((across - THIN) / (THICK - THIN)).clamp(0.0, 1.0)


def _uncovered(points_px: Tensor, valid: Tensor, asked: Tensor, target: MaskTarget, scale: float, reach: float) -> Tensor:
    reaches, asking = COVERED_WITHIN * target.grain, target.inside
    marked = bool((reaches <= MARKED_WITHIN).all())
    if marked:
        asking = asking & ~_covered(points_px.detach(), valid, target.inside.shape[-2:], reaches)
    index = nearest_points(asking, points_px, valid)
    index = torch.where(asked.gather(1, index.clamp_min(0).flatten(1)).view_as(index), index, -1)
    image, row, column = torch.nonzero(index >= 0, as_tuple=True)
    centres = torch.stack([column, row], 1).to(points_px)
    squared = (points_px[image, index[image, row, column]] - centres).square().sum(1)
    if not marked:
        far = squared.detach() > reaches[image].square()
        image, row, column, squared = image[far], row[far], column[far], squared[far]
    squared = squared * scale**2
    number = image * points_px.shape[1] + index[image, row, column]
    each = points_px.new_zeros(points_px.shape[:2].numel()).index_add(0, number, robust(squared, reach) * scale**2)
    return each.view(points_px.shape[:2])


def _covered(points_px: Tensor, valid: Tensor, size: torch.Size, reaches: Tensor) -> Tensor:
    """[M, H, W], whether a point lies so near [M] to the pixel's centre: what is covered need not look for its nearest."""
    height, width = size
    within, squared = float(reaches.max()), reaches.square().unsqueeze(1)
    # One more pixel all around takes what falls outside, and what is not there.
    found = torch.zeros(len(points_px), (height + 2) * (width + 2), dtype=torch.bool, device=points_px.device)
    x, y = torch.where(valid.unsqueeze(-1), points_px, -2.0 - within).movedim(-1, 0).contiguous()
    # A point further outside than this is near no pixel, and its number would not fit.
    x, y = x.clamp(-2.0 - within, width + within + 1.0), y.clamp(-2.0 - within, height + within + 1.0)
    column, row = x.round(), y.round()
    around = range(-math.ceil(within + 0.5) + 1, math.ceil(within + 0.5))
    across, down = ([((to + by), (to + by - at).square()) for by in around] for to, at in ((column, x), (row, y)))
    for (columns, far_x), (rows, far_y) in itertools.product(across, down):
        inside = (far_x + far_y <= squared) & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        found.scatter_(1, torch.where(inside, (rows + 1.0) * (width + 2) + columns + 1.0, 0.0).long(), True)
    return found.view(-1, height + 2, width + 2)[:, 1:-1, 1:-1]


def _stray(points_px: Tensor, valid: Tensor, target: MaskTarget, scale: float, reach: float) -> Tensor:
    height, width = target.inside.shape[-2:]
    # Beside the mask's part of the image it is background like that part's rim.
    nearest_px = torch.minimum(points_px.detach().clamp_min(0.0), points_px.new_tensor([width - 1.0, height - 1.0]))
    place, seen = pixels_under(nearest_px, valid & target.shows(points_px.detach()), height, width)
    rows, columns, outside = (
        image.flatten(1).gather(1, place) for image in (target.goal_rows, target.goal_columns, target.outside)
    )
    stray = seen & outside & (rows >= 0)
    goal = torch.stack([columns, rows], -1).to(points_px)
    squared = torch.where(stray.unsqueeze(-1), points_px - goal, 0.0).square().sum(-1) * scale**2
    return robust(squared, reach)


def robust(squared: Tensor, reach: float) -> Tensor:
    """Geman and McClure's cost of squared distances: the square of what is near, at most ``reach`` squared."""
    return squared * reach**2 / (reach**2 + squared)
