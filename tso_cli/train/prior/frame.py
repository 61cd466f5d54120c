"""What the views of a batch show, in the frames of its starts, as the network is given it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn import functional

from ...prior.features import CELL, GRID, HALF, LEFT_OUT, front_of
from ...prior.torch_backend import TORCH
from .masks import HALF_SIDE

if TYPE_CHECKING:
    from .starts import Batch

# Of the robust line: rounds; fewer common cells than these are not fitted.
FIT_ROUNDS, FEWEST_CELLS = 6, 12


class StartFrame:
    """What the views show, for starts that are centred and scaled to longest side 1.

    rotation [B, V, 3, 3]; closeness, metric and size [B, V]; the maps [B, V, GRID, GRID].
    """

    def __init__(self, centre: Tensor, scale: Tensor, views: dict[str, Tensor]) -> None:
        self.centre, self.scale, self.views = centre, scale, views
        self.rotation, self.closeness = views["rotation"], views["closeness"]
        self.distance, self.known = views["distance"], views["known"]
        self.foreign, self.hidden = views["foreign"], views["hidden"]

    @classmethod
    def of(cls, batch: Batch) -> StartFrame:
        """The maps of the batch are in the frame of the truth: they are sampled anew."""
        ordered = batch.start.sort(1).values
        left_out = int(LEFT_OUT * batch.start.shape[1])
        low, high = ordered[:, left_out], ordered[:, -1 - left_out]
        centre, scale = (low + high) / 2.0, (high - low).amax(1)
        closeness = batch.closeness
        # The middle of the start, in units of the distance of the camera: it comes to the axis.
        middle = torch.einsum("bvij,bj->bvi", batch.rotation, centre)
        toward = closeness[..., None] * middle + middle.new_tensor([0.0, 0.0, 1.0])
        turn, away = _turn_to_front(toward), toward.norm(dim=-1)
        grid = torch.arange(GRID, device=scale.device, dtype=scale.dtype) * CELL + CELL / 2 - HALF
        places = torch.stack(torch.meshgrid(grid, grid, indexing="xy"), -1)
        places = torch.einsum("ijk,bvkl->bvijl", places, turn[:, :, :2])
        places = middle[:, :, None, None] + scale[:, None, None, None, None] * places
        ahead = 1.0 + closeness[..., None, None, None] * places[..., 2:]
        w = places[..., :2] / ahead
        seen = batch.zoom[..., None, None, None] * w + batch.shift[:, :, None, None]
        seen = seen.flatten(0, 1) / HALF_SIDE
        smooth = torch.stack([batch.distance, batch.known], 2).flatten(0, 1)
        smooth = functional.grid_sample(smooth, seen, padding_mode="border", align_corners=False)
        smooth = smooth.unflatten(0, closeness.shape)
        sharp = torch.stack([batch.foreign, batch.hidden, batch.depth], 2).flatten(0, 1)
        sharp = functional.grid_sample(sharp, seen, "nearest", "zeros", align_corners=False)
        sharp = sharp.unflatten(0, closeness.shape)
        foreign, hidden, z = sharp.unbind(2)
        inside = (seen.abs().amax(-1) <= 1.0).unflatten(0, closeness.shape)
        measured = (~z.isnan() & inside).to(z)
        z = z.nan_to_num()
        surface = torch.cat(
            [w * (1.0 + closeness[..., None, None, None] * z[..., None]), z[..., None]], -1
        )
        surface = surface - middle[:, :, None, None]
        depth = torch.einsum("bvj,bvxyj->bvxy", turn[:, :, 2], surface) / scale[:, None, None, None]
        per_unit = (away / scale[:, None] / batch.zoom)[..., None, None]
        views = {
            "rotation": turn @ batch.rotation,
            "closeness": closeness * scale[:, None] / away,
            "distance": smooth[:, :, 0] * per_unit,
            "known": (smooth[:, :, 1] > 0.5).to(z),
            "foreign": foreign,
            "hidden": hidden,
            "depth": depth * measured,
            "measured": measured,
            "metric": batch.metric,
            "size": batch.size * scale[:, None],
        }
        frame = cls(centre, scale, views)
        _fit_depths(frame, frame.points(batch.start))
        return frame

    def points(self, points: Tensor) -> Tensor:
        """[B, N, 3] in this frame."""
        return (points - self.centre[:, None]) / self.scale[:, None, None]

    def part(self, count: int) -> StartFrame:
        """Of the first starts."""
        views = {name: value[:count] for name, value in self.views.items()}
        return StartFrame(self.centre[:count], self.scale[:count], views)


def _fit_depths(frame: StartFrame, start: Tensor) -> None:
    """Fit the depth maps that are not metric to the front of the start, as `tso refine` does.

    A robust line; a map that runs against the front is left out.
    """
    depth, measured = (frame.views[name].flatten(0, 1) for name in ("depth", "measured"))
    fitted = (frame.views["metric"].flatten() == 0.0) & (measured.flatten(1).amax(1) > 0.0)
    rows = fitted.nonzero()[:, 0]
    if not len(rows):
        return
    seen = torch.einsum("bvij,bnj->bvni", frame.rotation, start).flatten(0, 1)[rows]
    front, closed = front_of(TORCH, seen, frame.closeness.flatten()[rows])
    x, y = depth[rows].flatten(1), front.flatten(1)
    common = (measured[rows] * closed).flatten(1)
    weight = common
    for _ in range(FIT_ROUNDS):
        total = weight.sum(1, keepdim=True).clamp_min(1e-6)
        mean_x, mean_y = ((weight * v).sum(1, keepdim=True) / total for v in (x, y))
        square = (weight * (x - mean_x).square()).sum(1, keepdim=True)
        product = (weight * (x - mean_x) * (y - mean_y)).sum(1, keepdim=True)
        slope = product / square.clamp_min(1e-9)
        error = (y - mean_y - slope * (x - mean_x)).abs()
        spread = (common * error).sum(1, keepdim=True) / common.sum(1, keepdim=True).clamp_min(1.0)
        weight = common / (1.0 + (error / spread.clamp_min(1e-6)).square()).square()
    related = ((slope > 0.0) & (common.sum(1, keepdim=True) >= FEWEST_CELLS))[..., None]
    line = (mean_y + slope * (x - mean_x)).unflatten(1, (GRID, GRID))
    kept = measured[rows] * related
    depth, measured = depth.clone(), measured.clone()
    depth[rows], measured[rows] = line * kept, kept
    shape = frame.closeness.shape
    frame.views["depth"] = depth.unflatten(0, shape)
    frame.views["measured"] = measured.unflatten(0, shape)


def _turn_to_front(direction: Tensor) -> Tensor:
    """[..., 3, 3], the least rotation of each ``direction`` [..., 3] to the z axis."""
    x, y, z = (direction / direction.norm(dim=-1, keepdim=True)).unbind(-1)
    zero = torch.zeros_like(x)
    rows = [torch.stack(row, -1) for row in ((zero, zero, -x), (zero, zero, -y), (x, y, zero))]
    across = torch.stack(rows, -2)
    identity = torch.eye(3, dtype=x.dtype, device=x.device)
    return identity + across + across @ across / (1.0 + z)[..., None, None]
