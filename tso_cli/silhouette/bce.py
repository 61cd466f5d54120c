"""Binary cross-entropy between masks and the silhouettes of projected points (Eq. 4)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..kernels.nearest import nearest_points
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
    """Binary cross-entropy of mask and silhouette (Eq. 4), from the sum s and not from tanh(s).

    The formulas are explained in `tso_cli.losses.silhouette.silhouette_bce`.

    Parameters
    ----------
    sums : [M, H, W] from `silhouette_sums` of ``points_px`` [M, N, 2] and ``valid`` [M, N].
    mask : [M, H, W] in [0, 1]. known : [M, H, W] weight in [0, 1] of each pixel; None for 1.

    Returns
    -------
    [M] sum over pixels, weighted by 64^2 / (W H) so that settings hold at any resolution.
    """
    foreground, background = mask, 1.0 - mask
    if known is not None:
        foreground, background = mask * known, (1.0 - mask) * known
    covered, waiting = _cross_entropy(sums, foreground, background)
    uncovered = pixels_to_points(waiting, foreground, points_px, valid, 0.5 / sigma_sq)
    return (covered + uncovered) * pixel_weight(sums)


def pixel_weight(image: Tensor) -> float:
    """Pixels of a 64x64 mask in one pixel of ``image`` [..., H, W]."""
    return REFERENCE_PIXELS / (image.shape[-1] * image.shape[-2])


def _cross_entropy(sums: Tensor, foreground: Tensor, background: Tensor) -> tuple[Tensor, Tensor]:
    """Sum [M] of the cross-entropy without uncovered mask pixels, and these pixels [M, H, W].

    ``foreground`` and ``background`` [M, H, W] are the weights of the two terms of Eq. 4.
    """
    covered = sums > NEGLIGIBLE
    s = torch.where(covered, sums, 1.0)
    log_tanh = torch.log(-torch.expm1(-2.0 * s)) - torch.log1p(torch.exp(-2.0 * s))
    missed = torch.where(covered, -log_tanh, 0.0)
    extra = torch.nn.functional.softplus(2.0 * sums) - math.log(2.0)
    total = (missed * foreground + extra * background).sum((-1, -2))
    return total, (sums <= NEGLIGIBLE) & (foreground > 0.0)


def pixels_to_points(
    pixels: Tensor, weight: Tensor, points_px: Tensor, valid: Tensor, factor: float
) -> Tensor:
    """Sum [M] over ``pixels`` [M, H, W] of ``weight`` * ``factor`` * squared distance.

    The distance is to the nearest projected point.
    """
    index = nearest_points(pixels, points_px, valid).flatten(1)
    width, count = pixels.shape[2], points_px.shape[1]
    number = torch.arange(index.shape[1], device=index.device)
    paired = index >= 0
    # Each pixel without a point takes another point: zeros that a GPU adds to a single point would
    # wait for one another.
    partner = torch.where(paired, index, number % count)
    centres = torch.stack([number % width, number // width], 1)
    squared = (centres - torch.take_along_dim(points_px, partner.unsqueeze(-1), 1)).square().sum(-1)
    return torch.where(paired, squared * weight.flatten(1) * factor, 0.0).sum(-1)
