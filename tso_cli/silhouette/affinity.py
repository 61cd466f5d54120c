"""The nearest-point affinity loss against outliers (Eq. 5), on points or as printed."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..kernels.nearest import PAIRS_PER_CHUNK, nearest_marked
from ..kernels.tensors import PrecomputedGradient, called, use_numba
from .bce import pixel_weight, pixels_to_points
from .projection import pixels_under

# Where the sum is this, the silhouette is 0.5.
HALF = math.atanh(0.5)


def affinity(
    sums: Tensor, mask: Tensor, points_px: Tensor, valid: Tensor, form: str = "points"
) -> Tensor:
    """Nearest-point affinity loss (Eq. 5); ``sums``, ``mask``, ``points_px`` and ``valid`` as in `silhouette_bce`.

    Parameters
    ----------
    form : "paper" is Eq. 5 as printed, over all pairs of pixels, except that M^+ are the pixels over 0.5: among all that are
        not zero, the least product lies on the rim of a Gaussian and half of the loss vanishes. A stray silhouette pixel
        costs the least product of squared distance to a mask pixel and the mask there; a mask pixel the least product of
        squared distance to a silhouette pixel and the silhouette there, which rewards dimming that pixel.
        "points": each uncovered mask pixel (silhouette <= 0.5) attracts its nearest projected point, and each point on
        background inside the image is attracted by the mask pixel nearest to its pixel; where several are equally near,
        plain torch, numba and Triton may differ in which. O(HW).

    Returns
    -------
    [M] squared pixels, weighted by 64^4 / (W H)^2: distances and pixels are those of a 64x64 mask.
    """
    inside, predicted = mask > 0.5, sums.detach() > HALF
    if form == "points":
        total = _points_to_mask(points_px, valid, inside) + pixels_to_points(
            inside & ~predicted, mask, points_px, valid, 1.0
        )
    else:
        silhouette = torch.tanh(sums)
        total = _least_products(silhouette, mask, inside) + _least_products(
            mask, silhouette, predicted
        )
    return total * pixel_weight(mask) ** 2


def _least_products(source: Tensor, target: Tensor, marked: Tensor) -> Tensor:
    """Sum [M] over pixels of ``source`` times the least squared distance * ``target`` over the ``marked`` pixels.

    All pairs: where the least product lies depends on the values, so no distance transform finds it.
    """
    width, terms = source.shape[-1], []
    for weight, values, marks in zip(
        source.flatten(1), target.flatten(1), marked.flatten(1), strict=True
    ):
        # A marked pixel is at distance 0 from itself.
        pixels, candidates = (
            torch.nonzero((weight > 0.0) & ~marks).squeeze(1),
            torch.nonzero(marks).squeeze(1),
        )
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
    """Sum [M] over points on background of the squared distance to the nearest pixel ``inside``."""
    if use_numba(points_px):
        from ..kernels.losses_numba import points_to_mask

        attraction: Tensor = PrecomputedGradient.apply(
            points_px, *called(points_to_mask, points_px, valid, inside)
        )
        return attraction
    rows, columns = nearest_marked(inside)
    pixel, in_image = pixels_under(points_px, valid, *inside.shape[-2:])
    nearest_px = torch.stack([index.flatten(1).gather(1, pixel) for index in (columns, rows)], -1)
    stray = in_image & ~inside.flatten(1).gather(1, pixel) & (nearest_px[..., 0] >= 0)
    return torch.where(stray.unsqueeze(-1), points_px - nearest_px, 0.0).square().sum((-1, -2))
