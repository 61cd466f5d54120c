"""The exact separable product: Eq. 2 and 3 of the paper for every point and pixel. The oracle of the fast kernels."""

from __future__ import annotations

import torch
from torch import Tensor


def splat_exact(points_px: Tensor, valid: Tensor, height: int, width: int, sigma_sq: float) -> Tensor:
    """As `splat`, with no window.

    The sum over points of phi(x - i) phi(y - j) is the matrix product of phi(y - j) [H, N] and phi(x - i) [N, W]: no
    N x H x W tensor is needed.
    """
    columns = torch.arange(width, device=points_px.device, dtype=points_px.dtype)
    rows = torch.arange(height, device=points_px.device, dtype=points_px.dtype)
    x, y = torch.where(valid.unsqueeze(-1), points_px, 0.0).unbind(-1)
    along_x = _gaussian(x.unsqueeze(-1) - columns, sigma_sq) * valid.unsqueeze(-1)  # [M, N, W]
    along_y = _gaussian(y.unsqueeze(-1) - rows, sigma_sq)  # [M, N, H]
    return along_y.transpose(-1, -2) @ along_x


def _gaussian(distance: Tensor, sigma_sq: float) -> Tensor:
    exponent = distance.square() * (-0.5 / sigma_sq)
    # Below this the value is denormal, and a product of denormals is ten times slower; the true value is under 1e-37.
    smallest = -85.0 if distance.dtype == torch.float32 else -700.0
    return torch.exp(exponent.clamp_min(smallest)) * (exponent > smallest)
