"""Other packages that do a part of the same work, measured where they are installed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from ...silhouette.projection import project
from .material import SIGMA_SQ, Projection

Term = Callable[[Tensor], Tensor]
# Makes a contestant's term, or says why there is none.
Make = Callable[[], Term | str]
NOT_INSTALLED = "not installed"
# These compare all pairs of points.
COMPARE_ALL = ("chamferdist", "pykeops", "pytorch3d")


def chamfer_terms(initial: Tensor) -> dict[str, Make]:
    """Package -> what makes its Chamfer distance from a cloud [1, N, 3] to ``initial`` [1, N, 3], both ways."""
    makers = {
        "chamferdist": _chamferdist,
        "pykeops": _pykeops,
        "point_cloud_utils": _point_cloud_utils,
        "pytorch3d": _pytorch3d,
    }
    return {package: partial(_tried, package, maker, initial, initial) for package, maker in makers.items()}


def splatters(scene: Projection) -> dict[str, Make]:
    """Package -> what makes the summed silhouette of points [1, N, 3]."""
    makers = {"pytorch3d": _pytorch3d_points, "gsplat": _gsplat}
    return {package: partial(_tried, package, maker, scene, scene.points) for package, maker in makers.items()}


def _tried(package: str, maker: Callable[[Any, Any], Term], material: Tensor | Projection, points: Tensor) -> Term | str:
    """The package's term if one call of it at ``points``, forward and backward, succeeds."""
    # A package may print; stdout is for the answer alone.
    with redirect_stdout(sys.stderr):
        try:
            module = import_module(package)
        except ImportError as error:
            missing = isinstance(error, ModuleNotFoundError) and error.name == package
            return NOT_INSTALLED if missing else f"cannot be imported ({_line(error)})"
        try:
            term = maker(module, material)
            leaf = points.clone().requires_grad_()
            torch.autograd.grad(term(leaf).sum(), leaf)
        except Exception as error:
            # Whatever another package raises, the run goes on without it.
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
        squared = ((lazy(moved[0].detach()[:, None]) - lazy(initial[0][None])) ** 2).sum(-1)  # [N, N], never held
        return gathered(initial, moved, squared.argmin(1).flatten(), squared.argmin(0).flatten())

    return term


def _point_cloud_utils(module: Any, initial: Tensor) -> Term:
    start = initial[0].cpu().numpy()

    def term(moved: Tensor) -> Tensor:
        end = moved[0].detach().cpu().numpy()
        indices = (module.k_nearest_neighbors(a, b, 1)[1].reshape(-1) for a, b in ((end, start), (start, end)))
        return gathered(initial, moved, *(torch.from_numpy(index) for index in indices))

    return term


def _pytorch3d(module: Any, initial: Tensor) -> Term:
    distance = import_module("pytorch3d.loss").chamfer_distance
    return lambda moved: distance(moved, initial)[0]


def gathered(initial: Tensor, moved: Tensor, to_initial: Tensor, to_moved: Tensor) -> Tensor:
    """Chamfer distance by the indices [N] of each moved point's nearest initial point, and of the reverse."""
    start, end = initial[0], moved[0]
    return (end - start[to_initial.long()]).square().sum(1).mean() + (start - end[to_moved.long()]).square().sum(1).mean()


def _pytorch3d_points(module: Any, scene: Projection) -> Term:
    """Discs of the window's radius, the eight nearest of a pixel, weighted by the Gaussian."""
    rasterize = import_module("pytorch3d.renderer.points").rasterize_points
    clouds = import_module("pytorch3d.structures").Pointclouds
    # Its axes point left and up, and the picture spans -1 to 1.
    unit, radius = 2.0 / scene.side, 4.5
    shift = 1.0 - unit / 2.0

    def term(points: Tensor) -> Tensor:
        points_px = project(points, scene.cameras).points_px[:, 0]
        placed = torch.cat([shift - points_px * unit, torch.ones_like(points_px[..., :1])], -1)
        index, _, squared = rasterize(clouds(placed), scene.side, radius * unit, 8)
        weights = torch.exp(squared / unit**2 * (-0.5 / SIGMA_SQ)) * (index >= 0)
        return torch.tanh(weights.sum(-1)).sum()

    return term


def _gsplat(module: Any, scene: Projection) -> Term:
    """Spheres of variance sigma^2 at the cloud's centre, blended by depth rather than summed."""
    count, like = scene.points.shape[1], scene.points
    camera_from_world = torch.eye(4, device=like.device)
    camera_from_world[:3, :3], camera_from_world[:3, 3] = scene.cameras.R[0], scene.cameras.t[0]
    size = SIGMA_SQ**0.5 * scene.cameras.t[0].norm() / scene.cameras.K[0, 0, 0]
    scales = size.expand(count, 3).contiguous()
    quaternions = like.new_tensor([1.0, 0.0, 0.0, 0.0]).expand(count, 4).contiguous()
    opacities, colours = (like.new_full(shape, 0.99) for shape in ((count,), (count, 1)))
    fixed = (quaternions, scales, opacities, colours, camera_from_world[None], scene.cameras.K, scene.side, scene.side)
    return lambda points: module.rasterization(points[0], *fixed, eps2d=0.0)[1].sum()
