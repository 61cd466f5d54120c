"""The mask Chamfer loss for your own networks: points in, a value with a gradient out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..errors import InputError
from ..geometry.view import View
from ..optimisation.objective import ViewTargets
from ..optimisation.presets import SIGMA_SQ
from ..optimisation.resampled_view import CELLS, resample_view


class MaskLoss:
    """How far clouds are from agreeing with masks, as a function that torch differentiates.

    It is the mask Chamfer loss of points mode. Each uncovered foreground cell attracts its nearest
    point, and each point outside the mask is attracted by the nearest foreground cell. The depth
    maps of views count too. Value and gradient are computed on the CPU, in float64.

    Parameters
    ----------
    views : masks and their cameras; the cameras are in the units of the points.
    cells : along each side of the window around the object, to which masks are resampled.

    Raises InputError if no cell of a window is known to be foreground, or if a depth map is not
    along z.
    """

    def __init__(self, views: View | Sequence[View], cells: int = CELLS) -> None:
        several = [views] if isinstance(views, View) else list(views)
        for view in several:
            if view.depth is not None and view.depth_kind not in ("auto", "z"):
                raise InputError(
                    f"{view.name}: its depth map is of kind {view.depth_kind}, expected z"
                )
        resampled = [
            resample_view(view, SIGMA_SQ, np.zeros(3), 1.0, cells=cells) for view in several
        ]
        targets = ViewTargets.of(resampled, [1.0 / len(several)] * len(several))
        self._targets = targets

    def __call__(self, points: Tensor) -> Tensor:
        """The loss [] of a cloud [N, 3], or [B] of clouds [B, N, 3], per foreground pixel.

        It is infinite, without a gradient, where a view shows no point. Raises InputError for
        another shape.
        """
        if points.ndim not in (2, 3) or points.shape[-1] != 3 or not points.shape[-2]:
            raise InputError(
                f"points have shape {list(points.shape)}, expected [N, 3] or [B, N, 3]"
            )
        loss: Tensor = _Loss.apply(points, self)
        return loss

    def value_and_gradient(self, points: Any) -> tuple[float, Any]:
        """The loss of a cloud [N, 3], and its gradient [N, 3], as numpy has them."""
        value, gradient = self._targets.loss(np.ascontiguousarray(points, dtype=np.float64))
        return value / self._targets.pixels, gradient / self._targets.pixels


class _Loss(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, loss: MaskLoss) -> Tensor:
        clouds = points.detach().reshape(-1, *points.shape[-2:]).cpu().numpy()
        both = [loss.value_and_gradient(cloud) for cloud in clouds]
        gradients = np.stack([gradient for _, gradient in both]).reshape(points.shape)
        ctx.save_for_backward(torch.from_numpy(gradients).to(points))
        values = torch.tensor([value for value, _ in both], dtype=torch.float64)
        return values.reshape(points.shape[:-2]).to(points)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return grad_outputs[0][..., None, None] * gradient, None
