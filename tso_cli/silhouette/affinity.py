"""The nearest-point affinity loss against outliers (Eq. 5), on points or as printed."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..kernels.nearest import PAIRS_PER_CHUNK, nearest_marked
from .bce import pixel_weight, pixels_to_points
from .projection import pixels_under

# The sum at which the silhouette is 0.5.
SUM_AT_HALF = math.atanh(0.5)


def affinity(
    sums: Tensor, mask: Tensor, points_px: Tensor, valid: Tensor, form: str = "points"
) -> Tensor:
    """Nearest-point affinity loss (Eq. 5).

    ``sums``, ``mask``, ``points_px`` and ``valid`` are as in `silhouette_bce`.

    Parameters
    ----------
    form : "paper" or "points".

    1. "paper" is Eq. 5 as printed, over all pairs of pixels, except that M^+ holds the pixels over
       0.5. With all pixels over 0, the least product would lie on the rim of a Gaussian and half of
       the loss would vanish. A silhouette pixel outside the mask costs the least product of the
       squared distance to a mask pixel and the mask there. A mask pixel costs the least product of
       the squared distance to a silhouette pixel and the silhouette there; this rewards a dimmer
       silhouette.
    2. "points" takes O(HW). Each uncovered mask pixel (silhouette <= 0.5) attracts its nearest
       projected point. Each point on background inside the image is attracted by the mask pixel
       nearest to the point's own pixel. Of several equally near any may be chosen.

    Returns
    -------
    [M] squared pixels, weighted by 64^4 / (W H)^2: distances and areas of a 64x64 mask.
    """
    inside, predicted = mask > 0.5, sums.detach() > SUM_AT_HALF
    if form == "points":
        outside = _points_to_mask(points_px, valid, inside)
        total = outside + pixels_to_points(inside & ~predicted, mask, points_px, valid, 1.0)
    else:
        silhouette = torch.tanh(sums)
        total = _least_products(silhouette, mask, inside) + _least_products(
            mask, silhouette, predicted
        )
    return total * pixel_weight(mask) ** 2


def _least_products(source: Tensor, target: Tensor, marked: Tensor) -> Tensor:
    """Sum [M] over pixels of ``source`` * the least squared distance * ``target``.

    The least product is taken over the ``marked`` pixels.

    All pairs are compared, because no distance transform finds a product that depends on values.
    """
    width, terms = source.shape[-1], []
    for weight, values, marks in zip(
        source.flatten(1), target.flatten(1), marked.flatten(1), strict=True
    ):
        # A marked pixel is at distance 0 from itself.
        pixels = torch.nonzero((weight > 0.0) & ~marks).squeeze(1)
        candidates = torch.nonzero(marks).squeeze(1)
        if len(pixels) == 0 or len(candidates) == 0:
            terms.append(weight.sum() * 0.0)
            continue
        with torch.no_grad():
            from_px, to_px = (
                torch.stack([i // width, i % width], -1).to(weight.dtype)
                for i in (pixels, candidates)
            )
            centre = to_px.mean(0)
            x, p = from_px - centre, to_px - centre
            # v |x - p|^2 = (|x|^2, x, 1) . (v, -2 v p, v |p|^2), one matrix product
            left = torch.cat([x.square().sum(1, keepdim=True), x, torch.ones_like(x[:, :1])], 1)
            right = torch.cat(
                [torch.ones_like(p[:, :1]), -2.0 * p, p.square().sum(1, keepdim=True)], 1
            )
            right = right * values[candidates].unsqueeze(1)
            parts = left.split(max(1, PAIRS_PER_CHUNK // len(candidates)))
            best = torch.cat([(part @ right.T).argmin(1) for part in parts])
            squared = (from_px - to_px[best]).square().sum(1)
        terms.append((squared * weight[pixels] * values[candidates[best]]).sum())
    return torch.stack(terms)


def _points_to_mask(points_px: Tensor, valid: Tensor, inside: Tensor) -> Tensor:
    """Sum [M] over points outside the mask of the squared distance to the nearest mask pixel."""
    rows, columns = nearest_marked(inside)
    pixel, in_image = pixels_under(points_px, valid, *inside.shape[-2:])
    nearest_px = torch.stack([index.flatten(1).gather(1, pixel) for index in (columns, rows)], -1)
    outside = in_image & ~inside.flatten(1).gather(1, pixel) & (nearest_px[..., 0] >= 0)
    return torch.where(outside.unsqueeze(-1), points_px - nearest_px, 0.0).square().sum((-1, -2))
