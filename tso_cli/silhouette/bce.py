"""Binary cross-entropy between masks and the silhouettes of projected points (Eq. 4)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..kernels.nearest import nearest_points
from ..kernels.tensors import PrecomputedGradient, called, use_numba
from ..kernels.window import NEGLIGIBLE

# Losses are stated for a 64x64 mask.
REFERENCE_PIXELS = 64.0 * 64.0


def silhouette_bce(
    sums: Tensor,
    mask: Tensor,
    points_px: Tensor,
    valid: Tensor,
    sigma_sq: float,
    known: Tensor | None = None,
) -> Tensor:
    """Binary cross-entropy between mask and silhouette (Eq. 4), computed from the sum s and not from tanh(s).

    ``-log(1 - tanh s) = softplus(2 s) - log 2`` neither overflows nor loses its gradient where many points stack. At mask
    pixels whose sum is negligible (under 1e-8), s is that of the nearest projected point alone,
    ``log s = -d^2 / (2 sigma^2)``: far pixels attract too, and attract the right point.

    Parameters
    ----------
    sums : [M, H, W] from `silhouette_sums` of ``points_px`` [M, N, 2] and ``valid`` [M, N].
    mask : [M, H, W] in [0, 1]. known : [M, H, W] weight in [0, 1] of each pixel; None for 1.

    Returns
    -------
    [M] sum over pixels, weighted by 64^2 / (W H) so that settings hold at any resolution.
    """
    covering, freeing = (
        (mask, 1.0 - mask) if known is None else (mask * known, (1.0 - mask) * known)
    )
    if use_numba(points_px):
        from ..kernels.losses_numba import cross_entropy

        value, by_sums, waiting = called(cross_entropy, sums, covering, freeing, NEGLIGIBLE)
        covered = PrecomputedGradient.apply(sums, value, by_sums)
    else:
        covered, waiting = _cross_entropy(sums, covering, freeing)
    return (
        covered + pixels_to_points(waiting, covering, points_px, valid, 0.5 / sigma_sq)
    ) * pixel_weight(sums)


def pixel_weight(image: Tensor) -> float:
    """Pixels of a 64x64 mask to one of ``image`` [..., H, W]."""
    return REFERENCE_PIXELS / (image.shape[-1] * image.shape[-2])


def _cross_entropy(sums: Tensor, covering: Tensor, freeing: Tensor) -> tuple[Tensor, Tensor]:
    """Sum [M] of the cross-entropy without uncovered mask pixels, and which pixels [M, H, W] these are.

    ``covering`` and ``freeing`` [M, H, W] are the weights of the two terms of Eq. 4.
    """
    covered = sums > NEGLIGIBLE
    s = torch.where(covered, sums, 1.0)
    log_tanh = torch.log(-torch.expm1(-2.0 * s)) - torch.log1p(torch.exp(-2.0 * s))
    missed = torch.where(covered, -log_tanh, 0.0)
    stray = torch.nn.functional.softplus(2.0 * sums) - math.log(2.0)
    total = (missed * covering + stray * freeing).sum((-1, -2))
    return total, (sums <= NEGLIGIBLE) & (covering > 0.0)


def pixels_to_points(
    pixels: Tensor, weight: Tensor, points_px: Tensor, valid: Tensor, factor: float
) -> Tensor:
    """Sum [M] over ``pixels`` [M, H, W] of weight * factor * squared distance to the nearest projected point."""
    if use_numba(points_px):
        from ..kernels.losses_numba import pixels_to_points as compiled

        attraction: Tensor = PrecomputedGradient.apply(
            points_px, *called(compiled, pixels, weight, points_px, valid, factor)
        )
        return attraction
    index = nearest_points(pixels, points_px, valid).flatten(1)
    width, count = pixels.shape[2], points_px.shape[1]
    number = torch.arange(index.shape[1], device=index.device)
    paired = index >= 0
    # Pixels without a point take one in turn: zeros added to one and the same point would wait for each other on a GPU.
    partner = torch.where(paired, index, number % count)
    centres = torch.stack([number % width, number // width], 1)
    squared = (centres - torch.take_along_dim(points_px, partner.unsqueeze(-1), 1)).square().sum(-1)
    return torch.where(paired, squared * weight.flatten(1) * factor, 0.0).sum(-1)
