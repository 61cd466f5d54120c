"""What a cloud is asked: to cover the mask (BCE, Eq. 4), without outliers (affinity, Eq. 5), near its start (Chamfer)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from .kernels.nearest import StaticNearest, nearest
from .kernels.splat import NEGLIGIBLE

# Windows are square: a sum below this may come from the corner of one while a nearer point lies beyond its side.
UNCOVERED = NEGLIGIBLE
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
    sums : [M, H, W] from :func:`tso_cli.projection.silhouette_sums`.
    mask : [M, H, W] in [0, 1]; soft values are kept.
    points_px, valid : [M, N, 2], [M, N], where the sums came from.
    sigma_sq : px^2.
    known : [M, H, W] weight in [0, 1] of each pixel; 0 says nothing. None: every pixel counts.

    Returns
    -------
    [M] sum over pixels, weighted by 64^2 / (W H) so that settings hold at any resolution.
    """
    covered = sums > UNCOVERED
    s = torch.where(covered, sums, 1.0)
    log_tanh = torch.log(-torch.expm1(-2.0 * s)) - torch.log1p(torch.exp(-2.0 * s))
    miss = torch.where(covered, -log_tanh, 0.0) * mask
    stray = (torch.nn.functional.softplus(2.0 * sums) - math.log(2.0)) * (1.0 - mask)
    loss = miss + stray if known is None else (miss + stray) * known
    total = loss.sum((-1, -2))
    waiting = ~covered & (mask > 0.0)
    if known is not None:
        waiting &= known > 0.0
    if waiting.any():
        weight = mask if known is None else mask * known
        total = total + _far_pixels(waiting, weight, points_px, valid, 0.5 / sigma_sq)
    return total * (REFERENCE_PIXELS / (mask.shape[-1] * mask.shape[-2]))


def _far_pixels(pixels: Tensor, weight: Tensor, points_px: Tensor, valid: Tensor, factor: float) -> Tensor:
    """Sum [M] over the marked pixels of weight * factor * squared distance to the nearest projected point."""
    terms = []
    for i in range(len(pixels)):
        alive = points_px[i][valid[i]]
        rows, columns = torch.nonzero(pixels[i], as_tuple=True)
        if len(alive) == 0 or len(rows) == 0:
            terms.append(points_px[i].sum() * 0.0)
            continue
        centres = torch.stack([columns, rows], 1).to(alive.dtype)
        squared = (centres - alive[nearest(centres, alive)]).square().sum(1)
        terms.append((squared * weight[i, rows, columns]).sum() * factor)
    return torch.stack(terms)


def affinity(
    sums: Tensor,  # [M, H, W]
    mask: Tensor,  # [M, H, W]
    points_px: Tensor,  # [M, N, 2]
    valid: Tensor,  # [M, N]
    form: str = "points",
) -> Tensor:
    """Nearest-point affinity loss (Eq. 5), O(HW): by distance transforms, never by pairs of pixels.

    Parameters
    ----------
    sums, mask, points_px, valid : as in :func:`silhouette_bce`.
    form : "paper", Eq. 5 as printed with M^+ the pixels of a silhouette over 0.5: a stray silhouette pixel pays its squared
        distance to the mask; a mask pixel pays its squared distance to the silhouette times the value there, which rewards
        dimming that pixel. "points": each uncovered mask pixel (silhouette <= 0.5) pulls its nearest projected point, each
        point that falls on background inside the image is pulled to the nearest mask pixel.

    Returns
    -------
    [M] squared pixels, weighted by 64^4 / (W H)^2: distances and pixels are those of a 64x64 mask.
    """
    if form not in ("paper", "points"):
        raise ValueError(f"form is {form!r}, expected paper or points")
    silhouette = torch.tanh(sums)
    height, width = mask.shape[-2:]
    terms = []
    for i in range(len(mask)):
        term = points_px[i].sum() * 0.0
        inside = mask[i] > 0.5
        if inside.any():
            rows, columns, squared = _nearest_pixel(inside)
            if form == "paper":
                term = term + (squared * silhouette[i] * mask[i, rows, columns]).sum()
            else:
                term = term + _stray_points(points_px[i], valid[i], inside, rows, columns)
        predicted = silhouette[i].detach() > 0.5
        if form == "points":
            uncovered = (inside & ~predicted).unsqueeze(0)
            term = term + _far_pixels(uncovered, mask[i : i + 1], points_px[i : i + 1], valid[i : i + 1], 1.0)[0]
        elif predicted.any():
            rows, columns, squared = _nearest_pixel(predicted)
            term = term + (squared * mask[i] * silhouette[i, rows, columns]).sum()
        terms.append(term)
    return torch.stack(terms) * (REFERENCE_PIXELS / (height * width)) ** 2


def _nearest_pixel(marked: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Row, column [H, W] of the marked pixel nearest to each pixel, and the squared distance to it."""
    from scipy.ndimage import distance_transform_edt

    distance, index = distance_transform_edt(~marked.cpu().numpy(), return_indices=True)
    rows, columns = torch.from_numpy(index).long().to(marked.device)
    return rows, columns, torch.from_numpy(distance**2).to(marked.device, torch.float32)


def _stray_points(points_px: Tensor, valid: Tensor, inside: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    height, width = inside.shape
    pixel = points_px.detach().round()
    # What lies outside the image is unknown, not background.
    seen = valid & (pixel >= 0).all(1) & (pixel[:, 0] < width) & (pixel[:, 1] < height)
    column, row = torch.where(seen.unsqueeze(1), pixel, 0.0).long().unbind(1)
    stray = seen & ~inside[row, column]
    goal = torch.stack([columns[row, column], rows[row, column]], 1).to(points_px.dtype)
    return ((points_px - goal)[stray]).square().sum()


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
    forward, backward = [], []
    for ours, theirs in zip(prediction, target, strict=True):
        forward.append((theirs - ours[nearest(theirs, ours)]).square().sum(1).mean())
        backward.append((ours - theirs[nearest(ours, theirs)]).square().sum(1).mean())
    return torch.stack(forward), torch.stack(backward)


class ChamferToInitial:
    """The regulariser d(y, y^) of Eq. 7: Chamfer between the initial cloud and the cloud being moved.

    Parameters
    ----------
    initial : [N, 3]
    """

    def __init__(self, initial: Tensor) -> None:
        self.initial = initial.detach()
        self._nearest = StaticNearest(self.initial)

    def __call__(self, points: Tensor) -> Tensor:
        """Both directions summed, squared distances, mean over points; differentiable in ``points`` [N, 3]."""
        to_points, to_initial = self._nearest(points)
        forward = (self.initial - points[to_points]).square().sum(1).mean()
        return forward + (points - self.initial[to_initial]).square().sum(1).mean()
