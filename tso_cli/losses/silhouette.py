"""The paper's silhouette (Eq. 2, 3), and its cross-entropy with a mask (Eq. 4)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.camera import Camera
from ..geometry.resampling import area_resize
from ..kernels.splat_numpy import Splat
from ..kernels.window import NEGLIGIBLE
from .mask_chamfer import REFERENCE_SIDE
from .nearest import nearest
from .projection import project_differentiably

# A silhouette blurred by this variance (px^2) changes little from one pixel to the next.
SMOOTH_SIGMA_SQ = 6.4
# Points that `silhouette_of` draws at once; it bounds the memory.
POINTS_AT_ONCE = 1 << 13


def silhouette_sums(
    points_px: Array, valid: NDArray[np.bool_], height: int, width: int, sigma_sq: float
) -> Array:
    """The sums [H, W] of Gaussians whose tanh is the silhouette (Eq. 2)."""
    return Splat(points_px[valid], height, width, sigma_sq).sums


def silhouette_bce(
    points_px: Array,
    valid: NDArray[np.bool_],
    foreground: Array,
    background: Array,
    sigma_sq: float,
) -> tuple[float, Array]:
    """Binary cross-entropy of mask and silhouette (Eq. 4), from the sum s and not from tanh(s).

    ``-log(1 - tanh s) = softplus(2 s) - log 2`` neither overflows nor loses its gradient where many
    points lie on one pixel. Where the sum at a mask pixel is negligible (under 1e-8), s is the
    value of the nearest projected point alone, ``log s = -d^2 / (2 sigma^2)``. So far pixels
    attract a point too, and it is the nearest one.

    Parameters
    ----------
    points_px, valid : [N, 2] column and row, [N] bool; at least one is valid.
    foreground, background : [H, W] weights of covering a pixel, and of leaving it free.

    Returns
    -------
    The sum over pixels, weighted by 64^2 / (W H) so that settings hold at any resolution. Its
    gradient [N, 2].
    """
    height, width = foreground.shape
    share = REFERENCE_SIDE**2 / (width * height)
    gradient = np.zeros((len(points_px), 2))
    valid_px = points_px[valid]
    splat = Splat(valid_px, height, width, sigma_sq)
    s = splat.sums
    covered = s > NEGLIGIBLE
    complement = -np.expm1(-2.0 * s)
    power = 1.0 - complement  # e^-2s
    complement[~covered] = 1.0
    more = np.log1p(power)
    missed = more - np.log(complement)  # -log tanh s
    extra = 2.0 * s + more - math.log(2.0)  # -log(1 - tanh s)
    value = float((np.where(covered, missed, 0.0) * foreground + extra * background).sum())
    # d(-log tanh s) / ds = -2 / sinh(2 s)
    toward = np.where(covered, 4.0 * power / complement, 0.0)
    gradient[valid] = splat.gradient((2.0 * background - foreground * toward) / (1.0 + power))

    rows, columns = np.nonzero(~covered & (foreground > 0.0))
    if len(rows):
        pixels = np.stack([columns, rows], 1).astype(float)
        owner = np.flatnonzero(valid)[nearest(pixels, valid_px)]
        offsets = points_px[owner] - pixels
        weights = foreground[rows, columns] * (0.5 / sigma_sq)
        value += float((weights * np.square(offsets).sum(1)).sum())
        for axis in (0, 1):
            gradient[:, axis] += np.bincount(owner, 2.0 * weights * offsets[:, axis], len(gradient))
    return share * value, share * gradient


def silhouette_of(
    points: Array, camera: Camera, sigma_sq: float | None = None
) -> NDArray[np.float32]:
    """The silhouette [H, W] in [0, 1] of a cloud [N, 3], as the paper's projector draws it (Eq. 2).

    If the Gaussian spans many pixels, the sums are computed on a coarser grid (variance 6.4
    cells^2) and interpolated. The result is within 0.04 of the exact value at each pixel, and the
    cost does not grow with the photo. ``sigma_sq`` is in px^2 of the camera's image, by default the
    paper's: 0.4 (max(W, H) / 64)^2.
    """
    height, width = camera.height, camera.width
    if sigma_sq is None:
        sigma_sq = 0.4 * (max(width, height) / REFERENCE_SIDE) ** 2
    cloud = np.asarray(points, dtype=np.float64)
    centre = (cloud.min(0) + cloud.max(0)) / 2.0
    scale = float((cloud.max(0) - cloud.min(0)).max()) or 1.0
    coarse, sigma_sq = _coarsened(camera, sigma_sq)
    projected = project_differentiably(
        (cloud - centre) / scale, coarse.for_normalised(centre, scale)
    )
    sums = np.zeros((coarse.height, coarse.width))
    for start in range(0, len(cloud), POINTS_AT_ONCE):
        part = slice(start, start + POINTS_AT_ONCE)
        sums += silhouette_sums(
            projected.points_px[part], projected.valid[part], *sums.shape, sigma_sq
        )
    if sums.shape != (height, width):
        whole = (-0.5, -0.5, coarse.width - 0.5, coarse.height - 0.5)
        sums = area_resize(sums, whole, width, height, interpolate=True)[0]
    return np.tanh(sums).astype(np.float32)


def _coarsened(camera: Camera, sigma_sq: float) -> tuple[Camera, float]:
    """The camera of a grid on which ``sigma_sq`` is at most about 6.4, and its value there."""
    if sigma_sq <= SMOOTH_SIGMA_SQ:
        return camera, sigma_sq
    shrink = math.sqrt(SMOOTH_SIGMA_SQ / sigma_sq)
    width, height = (max(1, round(side * shrink)) for side in (camera.width, camera.height))
    ratio = max(width, height) / max(camera.width, camera.height)
    return camera.resized(width, height), sigma_sq * ratio**2
