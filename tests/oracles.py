"""Plain formulas, as the paper prints them, to hold the fast code against. Slow and in float64."""

import math

import torch
from torch import Tensor

from tso_cli import Camera


def project(points: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """Eq. 1: pixels [N, 2] and depths [N] of points [N, 3]."""
    K, R, t = (torch.tensor(part) for part in (camera.K, camera.R, camera.t))
    in_camera = points @ R.T + t
    plane = in_camera / in_camera[:, 2:] if camera.model == "perspective" else in_camera
    return plane[:, :2] @ K[:2, :2].T + K[:2, 2], in_camera[:, 2]


def robust(squared: Tensor, scale: float) -> Tensor:
    """The cost of a squared distance, bounded by that of ``scale``."""
    return squared * scale**2 / (scale**2 + squared)


def silhouette_sums(points_px: Tensor, height: int, width: int, sigma_sq: float) -> Tensor:
    """Eq. 2 and 3 before the tanh: [N, 2] -> [H, W], an N x H x W tensor."""
    return torch.exp(_exponents(points_px, height, width, sigma_sq)).sum(0)


def _exponents(points_px: Tensor, height: int, width: int, sigma_sq: float) -> Tensor:
    dx = points_px[:, 0, None, None] - torch.arange(width, dtype=points_px.dtype)
    dy = points_px[:, 1, None, None] - torch.arange(height, dtype=points_px.dtype)[:, None]
    return -(dx**2 + dy**2) / (2 * sigma_sq)


def bce(points_px: Tensor, mask: Tensor, sigma_sq: float) -> Tensor:
    """Eq. 4 with every point and pixel, by log-sum-exp, weighted by 64^2 / (W H)."""
    height, width = mask.shape
    log_s = torch.logsumexp(_exponents(points_px, height, width, sigma_sq), 0)
    s = torch.exp(log_s)
    log_one_minus = math.log(2.0) - torch.nn.functional.softplus(2.0 * s)
    # log tanh s = log s + log(tanh(s) / s), and the second term vanishes with s
    large = torch.where(s > 1e-6, s, 1.0)
    ratio = torch.where(s > 1e-6, torch.log(torch.tanh(large) / large), 0.0)
    loss = -mask * (log_s + ratio) - (1.0 - mask) * log_one_minus
    return loss.sum() * 4096.0 / (height * width)


def affinity_paper(silhouette: Tensor, mask: Tensor) -> Tensor:
    """Eq. 5 as printed, by all pairs of pixels, M^+ being values over 0.5."""
    height, width = mask.shape
    pixels = torch.stack(
        torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij"), -1
    ).reshape(-1, 2)
    total = silhouette.new_zeros(())
    for source, goal in ((silhouette, mask), (mask, silhouette)):
        marked = torch.nonzero(goal > 0.5)
        squared = (pixels[:, None] - marked[None]).square().sum(-1)
        products = squared * source.reshape(-1, 1) * goal[marked[:, 0], marked[:, 1]]
        total = total + products.min(1).values.sum()
    return total * (4096.0 / (height * width)) ** 2


def chamfer(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """(b -> a, a -> b), squared, means over points, by all pairs."""
    squared = (a[:, None] - b[None]).square().sum(-1)
    return squared.min(0).values.mean(), squared.min(1).values.mean()
