"""World points -> pixels (Eq. 1) and back, as compiled loops on the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .jit import compiled, part, share

# Basic steps for one point in one view.
PER_POINT = 32


def project(points: Tensor, K: Tensor, R: Tensor, t: Tensor, near: float) -> tuple[Tensor, Tensor]:
    """As `tso_cli.silhouette.projection.project`, with ``K``, ``R`` [B, V, 3, 3] and ``t`` [B, V, 3].

    Points whose depth is at most ``near`` fall on the principal point; minus infinity stands for orthographic cameras.
    """
    points_px, valid = _Project.apply(points, K, R, t, near)
    return points_px, valid


class _Project(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, K: Tensor, R: Tensor, t: Tensor, near: float) -> tuple[Tensor, Tensor]:
        clouds, views, count = len(points), K.shape[1], points.shape[1]
        points_px = points.new_empty(clouds, views, count, 2)
        valid = torch.empty(clouds, views, count, dtype=torch.bool, device=points.device)
        share(clouds * count, PER_POINT * valid.numel(), _project, points, K, R, t, near, points_px, valid)
        ctx.save_for_backward(points, K, R, t)
        ctx.near = near
        ctx.mark_non_differentiable(valid)
        return points_px, valid

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        points, K, R, t = ctx.saved_tensors
        slope = torch.empty_like(points, memory_format=torch.contiguous_format)
        steps = PER_POINT * grad_outputs[0].numel()
        share(len(points) * points.shape[1], steps, _gradient, points, K, R, t, ctx.near, grad_outputs[0], slope)
        return slope, None, None, None, None


@part
def _in_camera(point, R, t):  # type: ignore[no-untyped-def]
    """The point in the frame of a camera."""
    x = R[0, 0] * point[0] + R[0, 1] * point[1] + R[0, 2] * point[2] + t[0]
    y = R[1, 0] * point[0] + R[1, 1] * point[1] + R[1, 2] * point[2] + t[1]
    z = R[2, 0] * point[0] + R[2, 1] * point[1] + R[2, 2] * point[2] + t[2]
    return x, y, z


@compiled
def _project(first, last, points, K, R, t, near, points_px, valid):  # type: ignore[no-untyped-def]
    """Project the points ``first`` to ``last``, counted through all clouds, into every view."""
    count, views = points.shape[1], K.shape[1]
    zero, one = points.dtype.type(0.0), points.dtype.type(1.0)
    for cloud in range(first // count, -(-last // count)):
        for view in range(views):
            k = K[cloud, view]
            for n in range(max(first - cloud * count, 0), min(last - cloud * count, count)):
                x, y, z = _in_camera(points[cloud, n], R[cloud, view], t[cloud, view])
                ahead = z > near or near == -np.inf
                inverse = one if near == -np.inf else (one / z if ahead else zero)
                x, y = x * inverse, y * inverse
                valid[cloud, view, n] = ahead
                points_px[cloud, view, n, 0] = k[0, 0] * x + k[0, 1] * y + k[0, 2]
                points_px[cloud, view, n, 1] = k[1, 0] * x + k[1, 1] * y + k[1, 2]


@compiled
def _gradient(first, last, points, K, R, t, near, grad_px, slope):  # type: ignore[no-untyped-def]
    """Derivative by the points ``first`` to ``last``, counted through all clouds."""
    count, views = points.shape[1], K.shape[1]
    zero = points.dtype.type(0.0)
    for cloud in range(first // count, -(-last // count)):
        for n in range(max(first - cloud * count, 0), min(last - cloud * count, count)):
            slope[cloud, n, 0] = slope[cloud, n, 1] = slope[cloud, n, 2] = zero
            for view in range(views):
                k, r = K[cloud, view], R[cloud, view]
                x, y, z = _in_camera(points[cloud, n], r, t[cloud, view])
                u, v = grad_px[cloud, view, n, 0], grad_px[cloud, view, n, 1]
                by_x, by_y, by_z = k[0, 0] * u + k[1, 0] * v, k[0, 1] * u + k[1, 1] * v, zero
                if near != -np.inf:
                    if not z > near:
                        continue
                    by_x, by_y = by_x / z, by_y / z
                    by_z = -(by_x * x + by_y * y) / z
                for axis in range(3):
                    slope[cloud, n, axis] += r[0, axis] * by_x + r[1, axis] * by_y + r[2, axis] * by_z
