"""What a cloud is asked: to cover the mask (BCE, Eq. 4), without outliers (affinity, Eq. 5), near its start (Chamfer)."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ..kernels.dispatch import use_numba, whole_batches
from ..kernels.nearest import PAIRS_PER_CHUNK, StaticNearest, nearest_both_ways, nearest_in_rows, nearest_marked, nearest_points
from ..kernels.splat import NEGLIGIBLE, cheapest, splat, window_radius
from .projection import pixels_under

# Windows are square: a sum below this may come from the corner of one while a nearer point lies beyond its side.
UNCOVERED = NEGLIGIBLE
AFFINITIES = ("points", "paper")
"""Forms of the affinity loss."""
# Where the sum is this, the silhouette is 0.5.
HALF = math.atanh(0.5)
# Losses are stated for a 64x64 mask.
REFERENCE_PIXELS = 64.0 * 64.0


def silhouette_bce(
    sums: Tensor,  # [M, H, W]
    mask: Tensor,  # [M, H, W]
    points_px: Tensor,  # [M, N, 2]
    valid: Tensor,  # [M, N]
    sigma_sq: float,
    known: Tensor | None = None,  # [M, H, W]
) -> Tensor:
    """Binary cross-entropy between mask and silhouette (Eq. 4), computed from the sum s and not from tanh(s).

    ``-log(1 - tanh s) = softplus(2 s) - log 2`` neither overflows nor dies where many points stack. At mask pixels
    whose sum is negligible (under 1e-8: no window reaches them, or only a corner of one), s is that of the nearest projected
    point alone, ``log s = -d^2 / (2 sigma^2)``, so that far pixels pull too, and pull the right point.

    Parameters
    ----------
    sums : [M, H, W] from `silhouette_sums`.
    mask : [M, H, W] in [0, 1]; soft values are kept.
    points_px, valid : [M, N, 2], [M, N], where the sums came from.
    sigma_sq : px^2.
    known : [M, H, W] weight in [0, 1] of each pixel; 0 says nothing. None: every pixel counts.

    Returns
    -------
    [M] sum over pixels, weighted by 64^2 / (W H) so that settings hold at any resolution.
    """
    target = PixelWeights.of(mask, known)
    total = _cross_entropy(sums, target, use_numba(points_px))
    waiting = (sums <= UNCOVERED) & (target.wanted > 0.0)
    return (total + _far_pixels(waiting, target.wanted, points_px, valid, 0.5 / sigma_sq)) * _per_reference_pixel(mask)


class PixelWeights(NamedTuple):
    """What a mask asks of each pixel."""

    wanted: Tensor  # [M, H, W] weight of being covered
    unwanted: Tensor  # [M, H, W] weight of being left free

    @classmethod
    def of(cls, mask: Tensor, known: Tensor | None = None) -> PixelWeights:
        """``mask`` [M, H, W] in [0, 1], ``known`` [M, H, W] the weight of each pixel; None counts all alike."""
        if known is None:
            return cls(mask, 1.0 - mask)
        return cls(mask * known, (1.0 - mask) * known)


def mask_loss(points_px: Tensor, valid: Tensor, target: PixelWeights, sigma_sq: float, kernel: str = "auto") -> Tensor:
    """`silhouette_bce` of projected points and their own sums; in compiled code all of it is one function.

    Parameters
    ----------
    points_px, valid : [M, N, 2] column and row, [M, N] bool.
    target : weights of the pixels, [M, H, W].
    sigma_sq : px^2.
    kernel : as in `splat`.

    Returns
    -------
    [M], differentiable in ``points_px``.
    """
    height, width = target.wanted.shape[-2:]
    if kernel == "auto":
        kernel = cheapest(points_px, height, width, sigma_sq)
    if kernel == "compiled":
        from ..kernels.mask_bce_numba import mask_loss as compiled_loss

        total = compiled_loss(points_px, valid, target.wanted, target.unwanted, sigma_sq, window_radius(sigma_sq), UNCOVERED)
    else:
        sums = splat(points_px, valid, height, width, sigma_sq, kernel)
        waiting = (sums <= UNCOVERED) & (target.wanted > 0.0)
        total = _cross_entropy(sums, target, False) + _far_pixels(waiting, target.wanted, points_px, valid, 0.5 / sigma_sq)
    return total * _per_reference_pixel(target.wanted)


def _per_reference_pixel(image: Tensor) -> float:
    """What the pixels of an image count for, in pixels of a 64x64 mask."""
    return REFERENCE_PIXELS / (image.shape[-1] * image.shape[-2])


def _cross_entropy(sums: Tensor, target: PixelWeights, compiled: bool) -> Tensor:
    """Sum [M] over pixels of the cross-entropy; mask pixels whose sum is negligible add nothing."""
    if compiled:
        from ..kernels.losses_numba import cross_entropy

        return cross_entropy(sums, *target, UNCOVERED)
    covered = sums > UNCOVERED
    s = torch.where(covered, sums, 1.0)
    log_tanh = torch.log(-torch.expm1(-2.0 * s)) - torch.log1p(torch.exp(-2.0 * s))
    miss = torch.where(covered, -log_tanh, 0.0)
    stray = torch.nn.functional.softplus(2.0 * sums) - math.log(2.0)
    return (miss * target.wanted + stray * target.unwanted).sum((-1, -2))


def _far_pixels(pixels: Tensor, weight: Tensor, points_px: Tensor, valid: Tensor, factor: float) -> Tensor:
    """Sum [M] over the marked pixels of weight * factor * squared distance to the nearest projected point."""
    if use_numba(points_px):
        from ..kernels.losses_numba import pull_to_pixels

        return pull_to_pixels(pixels, weight, points_px, valid, factor)
    index = nearest_points(pixels, points_px, valid).flatten(1)
    width, count = pixels.shape[2], points_px.shape[1]
    number = torch.arange(index.shape[1], device=index.device)
    pulls = index >= 0
    # A pixel without a point is given one in turn: the zeros of all of them, added to one point, would wait for each other.
    taken = torch.where(pulls, index, number % count)
    centres = torch.stack([number % width, number // width], 1)
    squared = (centres - torch.take_along_dim(points_px, taken.unsqueeze(-1), 1)).square().sum(-1)
    return torch.where(pulls, squared * weight.flatten(1) * factor, 0.0).sum(-1)


def affinity(
    sums: Tensor,  # [M, H, W]
    mask: Tensor,  # [M, H, W]
    points_px: Tensor,  # [M, N, 2]
    valid: Tensor,  # [M, N]
    form: str = "points",
) -> Tensor:
    """Nearest-point affinity loss (Eq. 5).

    Parameters
    ----------
    sums, mask, points_px, valid : as in `silhouette_bce`.
    form : "paper", Eq. 5 as printed, but for M^+, here the pixels over 0.5. The paper has all that are not zero: the rim of a
        Gaussian is as good as zero, the least product lies there, and half of the loss vanishes. A stray silhouette pixel pays
        the least product of squared distance to a mask pixel and the mask there; a mask pixel the least product of squared
        distance to a silhouette pixel and the silhouette there, which rewards dimming that pixel. "points": each
        uncovered mask pixel (silhouette <= 0.5) pulls its nearest projected point, each point that falls on background inside
        the image is pulled to the nearest mask pixel: nearest to the pixel it falls on, any of those that are equally near.
        Which one is taken may differ between the plain form, the compiled one and a GPU's, and with it what the point pays
        beside the centre of its pixel. O(HW) by distance transforms; the printed form compares all pairs of pixels.

    Returns
    -------
    [M] squared pixels, weighted by 64^4 / (W H)^2: distances and pixels are those of a 64x64 mask.
    """
    if form not in AFFINITIES:
        raise ValueError(f"form is {form!r}, expected one of {AFFINITIES}")
    inside, predicted = mask > 0.5, sums.detach() > HALF
    if form == "points":
        term = _stray_points(points_px, valid, inside) + _far_pixels(inside & ~predicted, mask, points_px, valid, 1.0)
    else:
        silhouette = torch.tanh(sums)
        term = _far_values(silhouette, mask, inside) + _far_values(mask, silhouette, predicted)
    return term * _per_reference_pixel(mask) ** 2


def _far_values(source: Tensor, goal: Tensor, marked: Tensor) -> Tensor:
    """Sum [M] over pixels of ``source`` times the least product of squared distance and ``goal`` over the ``marked`` pixels.

    By all pairs: where the least product lies depends on the values, so that no distance transform finds it.
    """
    width, terms = source.shape[-1], []
    for own, values, there in zip(source.flatten(1), goal.flatten(1), marked.flatten(1), strict=True):
        # A marked pixel is at distance 0 from itself.
        asking, places = torch.nonzero((own > 0.0) & ~there).squeeze(1), torch.nonzero(there).squeeze(1)
        if len(asking) == 0 or len(places) == 0:
            terms.append(own.sum() * 0.0)
            continue
        with torch.no_grad():
            from_px, to_px = (torch.stack([i // width, i % width], -1).to(own.dtype) for i in (asking, places))
            middle = to_px.mean(0)
            one, other = from_px - middle, to_px - middle
            # v |x - p|^2 = (|x|^2, x, 1) . (v, -2 v p, v |p|^2), one matrix product
            left = torch.cat([one.square().sum(1, keepdim=True), one, torch.ones_like(one[:, :1])], 1)
            right = torch.cat([torch.ones_like(other[:, :1]), -2.0 * other, other.square().sum(1, keepdim=True)], 1)
            right = right * values[places].unsqueeze(1)
            parts = left.split(max(1, PAIRS_PER_CHUNK // len(places)))
            best = torch.cat([(part @ right.T).argmin(1) for part in parts])
            squared = (from_px - to_px[best]).square().sum(1)
        terms.append((squared * own[asking] * values[places[best]]).sum())
    return torch.stack(terms)


def _stray_points(points_px: Tensor, valid: Tensor, inside: Tensor) -> Tensor:
    """Sum [M] over the points that fall on background of the squared distance to the nearest pixel that is ``inside``."""
    if use_numba(points_px):
        from ..kernels.losses_numba import pull_to_mask

        return pull_to_mask(points_px, valid, inside)
    rows, columns = nearest_marked(inside)
    place, seen = pixels_under(points_px, valid, *inside.shape[-2:])
    goal = torch.stack([index.flatten(1).gather(1, place) for index in (columns, rows)], -1)
    stray = seen & ~inside.flatten(1).gather(1, place) & (goal[..., 0] >= 0)
    return torch.where(stray.unsqueeze(-1), points_px - goal, 0.0).square().sum((-1, -2))


def chamfer(prediction: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Chamfer distance by exact nearest neighbours, differentiable in both clouds.

    Parameters
    ----------
    prediction : [B, N, 3]
    target : [B, M, 3]

    Returns
    -------
    forward [B], target -> prediction, and backward [B], prediction -> target: squared distances, mean over points.
    """
    to_target, to_prediction = nearest_both_ways(prediction, target)
    forward = target - torch.take_along_dim(prediction, to_prediction.unsqueeze(-1), 1)
    backward = prediction - torch.take_along_dim(target, to_target.unsqueeze(-1), 1)
    return forward.square().sum(-1).mean(-1), backward.square().sum(-1).mean(-1)


class ChamferToInitial:
    """The regulariser d(y, y^) of Eq. 7: Chamfer between initial clouds and the same clouds being moved.

    Parameters
    ----------
    initial : [B, N, 3]
    counts : [B], how many points of each row are there; None for all.
    """

    def __init__(self, initial: Tensor, counts: Tensor | None = None) -> None:
        self.initial = initial.detach()
        self.counts = torch.full((len(initial),), initial.shape[1]) if counts is None else counts
        self._compiled = use_numba(self.initial)
        if self._compiled:
            from ..kernels.static_chamfer_numba import StaticTrees

            self._trees = StaticTrees(self.initial, self.counts)
        elif whole_batches(self.initial):
            there = torch.arange(initial.shape[1]) < self.counts.unsqueeze(1)
            self._there = there.to(initial.device)
            self._share = (there / self.counts.unsqueeze(1)).to(self.initial)
        else:
            rows = zip(self.initial, self.counts.tolist(), strict=True)
            self._nearest = [StaticNearest(cloud[:count]) for cloud, count in rows]

    def __call__(self, points: Tensor) -> Tensor:
        """Both directions summed [B], squared distances, mean over points; differentiable in ``points`` [B, N, 3]."""
        if self._compiled:
            return self._trees.chamfer(points)
        if whole_batches(points):
            to_points = nearest_in_rows(self.initial, points, self._there, self._there).clamp_min_(0)
            to_initial = nearest_in_rows(points, self.initial, self._there, self._there).clamp_min_(0)
            forward = self.initial - torch.take_along_dim(points, to_points.unsqueeze(-1), 1)
            backward = points - torch.take_along_dim(self.initial, to_initial.unsqueeze(-1), 1)
            return ((forward.square() + backward.square()).sum(-1) * self._share).sum(-1)
        terms = []
        for start, moved, nearest in zip(self.initial, points, self._nearest, strict=True):
            start, moved = start[: len(nearest.start)], moved[: len(nearest.start)]
            to_points, to_initial = nearest(moved)
            forward = (start - moved[to_points]).square().sum(1).mean()
            terms.append(forward + (moved - start[to_initial]).square().sum(1).mean())
        return torch.stack(terms)
