"""Other packages that do a piece of the same work: measured where they are installed, named where they are not."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from .material import SIGMA_SQ, Projection

Term = Callable[[Tensor], Tensor]
# Gives a peer's work, or says in words why there is none.
Make = Callable[[], Term | str]
NOT_INSTALLED = "not installed"
# Those that know no tree.
COMPARE_ALL = ("chamferdist", "pykeops", "pytorch3d")


def chamfer_terms(initial: Tensor) -> dict[str, Make]:
    """Peer -> what makes the Chamfer distance of a moved cloud [1, N, 3] to ``initial`` [1, N, 3], both ways."""
    makers = {
        "chamferdist": _chamferdist,
        "pykeops": _pykeops,
        "point_cloud_utils": _point_cloud_utils,
        "pytorch3d": _pytorch3d,
    }
    return {package: partial(_tried, package, maker, initial) for package, maker in makers.items()}


def splatters(scene: Projection) -> dict[str, Make]:
    """Peer -> what makes the sum of a silhouette drawn from points [1, N, 3]."""
    makers = {"pytorch3d": _pytorch3d_points, "gsplat": _gsplat}
    return {package: partial(_tried, package, maker, scene) for package, maker in makers.items()}


def _tried(package: str, maker: Callable[[Any, Any], Term], material: Tensor | Projection) -> Term | str:
    """The peer's work if one call of it, forward and backward, succeeds."""
    try:
        # what a package tells of itself is no part of the answer on stdout
        with redirect_stdout(sys.stderr):
            module = import_module(package)
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == package
        return NOT_INSTALLED if missing else f"cannot be imported ({_line(error)})"
    points = material.points if isinstance(material, Projection) else material
    try:
        with redirect_stdout(sys.stderr):
            term = maker(module, material)
            leaf = points.clone().requires_grad_()
            torch.autograd.grad(term(leaf).sum(), leaf)
    except Exception as error:
        # whatever another package raises: it is left out, and the run goes on
        return f"does not run here ({_line(error)})"
    return term


def _line(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 120 else text[:117] + "..."


def _chamferdist(module: Any, initial: Tensor) -> Term:
    distance = module.ChamferDistance()
    return lambda moved: distance(moved, initial, bidirectional=True, point_reduction="mean")


def _pykeops(module: Any, initial: Tensor) -> Term:
    lazy = import_module("pykeops.torch").LazyTensor

    def term(moved: Tensor) -> Tensor:
        now, start = moved[0].detach(), initial[0]
        squared = ((lazy(now[:, None]) - lazy(start[None])) ** 2).sum(-1)  # [N, N], never held
        return gathered(initial, moved, squared.argmin(1).flatten(), squared.argmin(0).flatten())

    return term


def _point_cloud_utils(module: Any, initial: Tensor) -> Term:
    start = initial[0].cpu().numpy()

    def term(moved: Tensor) -> Tensor:
        now = moved[0].detach().cpu().numpy()
        to_start, to_now = (module.k_nearest_neighbors(a, b, 1)[1].reshape(-1) for a, b in ((now, start), (start, now)))
        return gathered(initial, moved, torch.from_numpy(to_start), torch.from_numpy(to_now))

    return term


def _pytorch3d(module: Any, initial: Tensor) -> Term:
    distance = import_module("pytorch3d.loss").chamfer_distance
    return lambda moved: distance(moved, initial)[0]


def gathered(initial: Tensor, moved: Tensor, to_start: Tensor, to_now: Tensor) -> Tensor:
    """Chamfer from the indices of the nearest neighbours of each moved point [N], and of each start [N]."""
    start, now = initial[0], moved[0]
    return (now - start[to_start.long()]).square().sum(1).mean() + (start - now[to_now.long()]).square().sum(1).mean()


def _pytorch3d_points(module: Any, scene: Projection) -> Term:
    """Discs of the window's radius, the eight nearest a pixel, weighed by the Gaussian: what its renderer can hold."""
    rasterize = import_module("pytorch3d.renderer.points").rasterize_points
    clouds = import_module("pytorch3d.structures").Pointclouds
    # Its axes point left and up, and the picture spans -1 to 1.
    unit, radius = 2.0 / scene.side, 4.5
    shift = 1.0 - unit / 2.0

    def term(points: Tensor) -> Tensor:
        points_px = seen(scene, points)
        placed = torch.cat([shift - points_px * unit, torch.ones_like(points_px[..., :1])], -1)
        index, _, squared = rasterize(clouds(placed), scene.side, radius * unit, 8)
        weights = torch.exp(squared / unit**2 * (-0.5 / SIGMA_SQ)) * (index >= 0)
        return torch.tanh(weights.sum(-1)).sum()

    return term


def _gsplat(module: Any, scene: Projection) -> Term:
    """Spheres whose variance is sigma^2 where the middle of the cloud falls; composed in depth, not added up."""
    count = scene.points.shape[1]
    rotation = torch.eye(4, device=scene.points.device)
    rotation[:3, :3], rotation[:3, 3] = scene.cameras.R[0], scene.cameras.t[0]
    focal, distance = scene.cameras.K[0, 0, 0], scene.cameras.t[0].norm()
    scales = (SIGMA_SQ**0.5 * distance / focal).expand(count, 3).contiguous()
    quaternions = torch.tensor([1.0, 0.0, 0.0, 0.0], device=scene.points.device).expand(count, 4).contiguous()
    opacities, colours = (torch.full(shape, 0.99, device=scene.points.device) for shape in ((count,), (count, 1)))

    def term(points: Tensor) -> Tensor:
        _, alphas, _ = module.rasterization(
            points[0],
            quaternions,
            scales,
            opacities,
            colours,
            rotation[None],
            scene.cameras.K,
            scene.side,
            scene.side,
            eps2d=0.0,
        )
        return alphas.sum()

    return term


def seen(scene: Projection, points: Tensor) -> Tensor:
    """Where ``points`` [1, N, 3] fall in the picture of ``scene``, [1, N, 2]."""
    from ...silhouette.projection import project

    return project(points, scene.cameras).points_px[:, 0]
