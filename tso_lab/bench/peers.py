"""Other silhouettes of points, in place of the paper's, in its own optimisation (50 steps)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from tso_cli.geometry.camera import NEAR, Array
from tso_cli.geometry.points import bounding_box_normalisation
from tso_cli.geometry.view import View
from tso_cli.geometry.window import window_of
from tso_cli.losses.chamfer import ChamferToStart
from tso_cli.optimisation.presets import PAPER_POINTS, SIGMA_SQ
from tso_cli.optimisation.resampled_view import CELLS, ResampledView, resample_view

EPSILON = 1e-8
"""In the logarithms of the cross-entropy, as it is usually written."""
RADIUS = 1.5
"""Cells of a point's disc, as PyTorch3D draws points."""
MOST_POWER = 40.0
"""Beyond it a product of two Gaussians is denormal: slow, and nothing compared with 1e-8."""


def _gaussians(points_px: Tensor) -> Tensor:
    cells = torch.arange(CELLS)
    powers = (0.5 / SIGMA_SQ * (cells - places[:, None]) ** 2 for places in points_px.T)
    along_x, along_y = (torch.exp(-power.clamp(max=MOST_POWER)) for power in powers)
    return torch.tanh(along_y.T @ along_x)


def _on_cells(points_px: Tensor, values: Tensor) -> Tensor:
    """The sums [H, W] of ``values`` [N] in the cells that points fall on."""
    column, row = points_px.detach().round().long().unbind(-1)
    inside = (column >= 0) & (column < CELLS) & (row >= 0) & (row < CELLS)
    flat = torch.zeros(CELLS * CELLS).index_add(0, (row * CELLS + column)[inside], values[inside])
    return flat.view(CELLS, CELLS)


def _discretised(points_px: Tensor) -> Tensor:
    """1 where a point is rounded to; as that has no derivative, the gradient is the Gaussians'."""
    soft = _gaussians(points_px)
    return (_on_cells(points_px, torch.ones(len(points_px))) > 0.0).float() + soft - soft.detach()


def _alpha_points(points_px: Tensor) -> Tensor:
    """Discs of opacity 1 - d^2 / r^2, composited: of one colour, in any order."""
    reach = torch.arange(-int(RADIUS + 0.5), int(RADIUS + 0.5) + 1)
    places = points_px.detach().round()[:, None] + torch.cartesian_prod(reach, reach)
    squared = (places - points_px[:, None]).square().sum(-1)
    clear = torch.log1p(-(1.0 - squared / RADIUS**2).clamp(0.0, 0.999))
    return 1.0 - torch.exp(_on_cells(places.flatten(0, 1), clear.flatten()))


def _optimised(silhouette: Callable[[Tensor], Tensor]) -> Callable[[Array, Sequence[View]], Array]:
    def refined(points: Array, views: Sequence[View]) -> Array:
        torch.set_num_threads(1)  # several would wait for one another on a busy machine
        centre, scale = bounding_box_normalisation(points)
        seen = [
            resample_view(view, SIGMA_SQ, centre, scale, window_of(view, points)) for view in views
        ]
        start = (points - centre) / scale
        moved = torch.tensor(start, dtype=torch.float32, requires_grad=True)
        to_start = ChamferToStart(start)
        adam = torch.optim.Adam([moved], lr=PAPER_POINTS.learning_rate)
        for _ in range(PAPER_POINTS.steps):
            gradient = to_start(moved.detach().double().numpy())[1]
            by_start = torch.as_tensor(gradient, dtype=torch.float32)
            loss = sum((_cross_entropy(silhouette, moved, view) for view in seen), torch.zeros(()))
            (by_masks,) = torch.autograd.grad(loss, moved)
            moved.grad = by_masks + PAPER_POINTS.gamma * by_start
            adam.step()
        moved_back: Array = centre + scale * moved.detach().double().numpy()
        return moved_back

    return refined


def _cross_entropy(
    silhouette: Callable[[Tensor], Tensor], points: Tensor, view: ResampledView
) -> Tensor:
    K, R, t, mask, background = (
        torch.as_tensor(values, dtype=torch.float32)
        for values in (view.camera.K, view.camera.R, view.camera.t, *view.pixel_weights)
    )
    camera = points @ R.T + t
    front = camera[camera[:, 2] > NEAR]
    drawn = silhouette(front[:, :2] / front[:, 2:] @ K[:2, :2].T + K[:2, 2])
    inside, outside = torch.log(drawn + EPSILON), torch.log(1.0 - drawn + EPSILON)
    return -(mask * inside + background * outside).sum()


PEERS = {
    "log(tanh + 1e-8)": _optimised(_gaussians),
    "discretised projection": _optimised(_discretised),
    "alpha points": _optimised(_alpha_points),
}
