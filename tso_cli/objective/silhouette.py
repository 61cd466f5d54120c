"""The paper's silhouette (Eq. 2, 3) and its cross-entropy with a mask (Eq. 4): value and gradient by projected points."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .mask_chamfer import REFERENCE_SIDE
from .nearest import nearest

Array = NDArray[np.floating]

# Pixels whose sum is below this are attracted by their nearest point alone.
NEGLIGIBLE = 1e-8


def default_sigma_sq(width: int, height: int) -> float:
    """The paper's 0.4 px^2 of a 64x64 grid, for an image of another size."""
    return 0.4 * (max(width, height) / 64.0) ** 2


def silhouette_sums(points_px: Array, valid: NDArray[np.bool_], height: int, width: int, sigma_sq: float) -> Array:
    """The sums [H, W] of Gaussians whose tanh is the silhouette (Eq. 2)."""
    along_x, along_y = _weights(points_px[valid], height, width, sigma_sq)
    sums: Array = along_y.T @ along_x
    return sums


def _weights(points_px: Array, height: int, width: int, sigma_sq: float) -> tuple[Array, Array]:
    """The Gaussians' factors [N, W] along x and [N, H] along y: the sum over points of their product is a matrix product."""
    steps = (np.arange(width) - points_px[:, :1], np.arange(height) - points_px[:, 1:])
    # Below this the value is denormal, and a product of denormals is ten times slower; the true value is under 1e-300.
    along_x, along_y = (np.exp(np.maximum(np.square(step) * (-0.5 / sigma_sq), -700.0)) for step in steps)
    return along_x, along_y


def silhouette_bce(
    points_px: Array, valid: NDArray[np.bool_], foreground: Array, background: Array, sigma_sq: float
) -> tuple[float, Array]:
    """Binary cross-entropy between mask and silhouette (Eq. 4), computed from the sum s and not from tanh(s).

    ``-log(1 - tanh s) = softplus(2 s) - log 2`` neither overflows nor loses its gradient where many points stack. At mask
    pixels whose sum is negligible (under 1e-8), s is that of the nearest projected point alone,
    ``log s = -d^2 / (2 sigma^2)``: far pixels attract too, and attract the right point.

    Parameters
    ----------
    points_px, valid : [N, 2] column and row, [N] bool; at least one is valid.
    foreground, background : [H, W] weights of covering a pixel, and of leaving it free.

    Returns
    -------
    The sum over pixels, weighted by 64^2 / (W H) so that settings hold at any resolution; its gradient [N, 2].
    """
    height, width = foreground.shape
    gradient = np.zeros((len(points_px), 2))
    chosen = points_px[valid]
    along_x, along_y = _weights(chosen, height, width, sigma_sq)
    s = along_y.T @ along_x
    covered = s > NEGLIGIBLE
    safe = np.where(covered, s, 1.0)
    power = np.exp(-2.0 * safe)
    missed = np.log1p(power) - np.log(-np.expm1(-2.0 * safe))  # -log tanh s
    stray = np.logaddexp(0.0, 2.0 * s) - math.log(2.0)
    value = float((np.where(covered, missed, 0.0) * foreground + stray * background).sum())
    # d(-log tanh s) / ds = -2 / sinh(2 s)
    by_sum = 2.0 * background / (1.0 + np.exp(-2.0 * s))
    by_sum -= np.where(covered, foreground * 4.0 * power / -np.expm1(-4.0 * safe), 0.0)

    by_tap = along_y @ by_sum  # [N, W]
    gradient_x = (by_tap * along_x * (np.arange(width) - chosen[:, :1])).sum(1)
    by_tap = along_x @ by_sum.T  # [N, H]
    gradient_y = (by_tap * along_y * (np.arange(height) - chosen[:, 1:])).sum(1)
    gradient[valid] = np.stack([gradient_x, gradient_y], 1) / sigma_sq

    rows, columns = np.nonzero(~covered & (foreground > 0.0))
    if len(rows):
        pixels = np.stack([columns, rows], 1).astype(float)
        owner = np.flatnonzero(valid)[nearest(pixels, chosen)]
        offsets = points_px[owner] - pixels
        weights = foreground[rows, columns] * (0.5 / sigma_sq)
        value += float((weights * np.square(offsets).sum(1)).sum())
        for axis in (0, 1):
            gradient[:, axis] += np.bincount(owner, 2.0 * weights * offsets[:, axis], len(gradient))
    share = REFERENCE_SIDE**2 / (width * height)
    return share * value, share * gradient
