"""The loss of a learned prior: how far its displacements leave a start from the truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn import functional

from ...prior.features import (
    CELL,
    CELLS,
    GRID,
    HALF,
    INTERPOLATED_FROM,
    LEFT_OUT,
    NODES,
    Features,
    features,
)
from ...prior.network import fused, predict
from ...prior.torch_backend import TORCH
from .masks import HALF_SIDE

if TYPE_CHECKING:
    from .starts import Batch

# This share of a batch is first moved by the network itself, so that it learns its second pass.
SECOND_PASS = 0.4
# Points of the start, and of the truth, that are compared in one step.
COMPARED = 128
# Chamfer distance of two samplings of one shape, by so few points; it can never be undone.
FLOOR = 0.5e-3
# No start counts for more than this many times its own error.
MOST = 6.0
# A start whose points are known at the truth is held to them by this share of its loss. Between two
# samplings of a shape the Chamfer distance hides small steps.
OF_COUNTERPARTS, SMALLEST_SQUARE = 0.7, 1e-4


def loss(weights: Mapping[str, Tensor], batch: Batch, generator: torch.Generator) -> Tensor:
    """The mean over starts of the error that is left, divided by the error of the start.

    Each start is moved as its first view, its second view, and both together ask for.
    """
    frame = _Frame.of(batch)
    points = start = frame.points(batch.start)
    if second := round(SECOND_PASS * len(points)):
        first = points[:second]
        with torch.no_grad():
            steps = _displacements(weights, frame.part(second), first, first, generator)
            # In use there may be one view or several.
            asked = torch.randint(steps.shape[1], (second,), generator=generator)
            step = steps[torch.arange(second), asked.to(steps.device)]
        points = torch.cat([first + step, points[second:]])
    target = frame.points(batch.target)
    counterpart = frame.points(batch.counterpart)
    result = points[:, None] + _displacements(weights, frame, start, points, generator)
    some = torch.randperm(points.shape[1], generator=generator)[:COMPARED].to(points.device)
    others = torch.randperm(target.shape[1], generator=generator)[:COMPARED].to(points.device)
    before = _chamfer(points[:, None], target, some, others)
    left = (_chamfer(result, target, some, others) / before.clamp_min(FLOOR)).clamp_max(
        MOST
    )  # [B, 3]
    known = ~counterpart.isnan().any(-1)  # [B, M]
    step = torch.where(known[..., None], counterpart - points, 0.0)
    apart = (result - points[:, None] - step[:, None]).square().sum(-1) * known[:, None]
    of_step = step.square().sum((1, 2)) / known.sum(1).clamp_min(1) + SMALLEST_SQUARE
    off = apart.sum(-1) / known.sum(1).clamp_min(1)[:, None] / of_step[:, None]
    held = (1.0 - OF_COUNTERPARTS) * left + OF_COUNTERPARTS * off.clamp_max(MOST)
    return torch.where(known.any(1)[:, None], held, left).mean()


class _Frame:
    """What the views show, for starts that are centred and scaled to longest side 1.

    rotation [B, V, 3, 3], closeness [B, V], distance and known [B, V, GRID, GRID].
    """

    def __init__(self, centre: Tensor, scale: Tensor, *views: Tensor) -> None:
        self.centre, self.scale = centre, scale
        self.rotation, self.closeness, self.distance, self.known = views

    @classmethod
    def of(cls, batch: Batch) -> _Frame:
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
        depth = 1.0 + closeness[..., None, None, None] * places[..., 2:]
        places = (places[..., :2] / depth).flatten(0, 1) / HALF_SIDE
        shown = torch.stack([batch.distance, batch.known], 2).flatten(0, 1)
        shown = functional.grid_sample(shown, places, padding_mode="border", align_corners=False)
        shown = shown.unflatten(0, closeness.shape)
        distance = shown[:, :, 0] * (away / scale[:, None])[..., None, None]
        known = (shown[:, :, 1] > 0.5).to(distance)
        closer = closeness * scale[:, None] / away
        return cls(centre, scale, turn @ batch.rotation, closer, distance, known)

    def points(self, points: Tensor) -> Tensor:
        """[B, N, 3] in this frame."""
        return (points - self.centre[:, None]) / self.scale[:, None, None]

    def part(self, count: int) -> _Frame:
        """Of the first starts."""
        return _Frame(*(value[:count] for value in vars(self).values()))


def _turn_to_front(direction: Tensor) -> Tensor:
    """[..., 3, 3], the least rotation of each ``direction`` [..., 3] to the z axis."""
    x, y, z = (direction / direction.norm(dim=-1, keepdim=True)).unbind(-1)
    zero = torch.zeros_like(x)
    rows = [torch.stack(row, -1) for row in ((zero, zero, -x), (zero, zero, -y), (x, y, zero))]
    across = torch.stack(rows, -2)
    identity = torch.eye(3, dtype=x.dtype, device=x.device)
    return identity + across + across @ across / (1.0 + z)[..., None, None]


def _displacements(
    weights: Mapping[str, Tensor],
    frame: _Frame,
    start: Tensor,
    points: Tensor,
    generator: torch.Generator,
) -> Tensor:
    """[B, 3, M, 3]: as the first view, the second view and both ask for, in axes of the cloud.

    ``points`` [B, M, 3] is where the ``start`` [B, M, 3] has got to.
    """
    batch, count = points.shape[:2]
    nodes = min(NODES, count)
    with torch.no_grad():
        given = _features(frame, points, nodes, generator)
        index, share = _interpolation(start, nodes)
    displacements, log_weights = predict(TORCH, weights, given)
    displacements, log_weights = (
        values.unflatten(0, (batch, 2)) for values in (displacements, log_weights)
    )
    both = fused(TORCH, displacements, log_weights, frame.rotation)
    alone = torch.einsum("bvij,bvni->bvnj", frame.rotation, displacements)
    of_nodes = torch.cat([alone, both[:, None]], 1).permute(0, 2, 1, 3).flatten(2)  # [B, N, 9]
    near = TORCH.rows(of_nodes, index.flatten(1)).view(batch, count, INTERPOLATED_FROM, 9)
    return (near * share[..., None]).sum(2).view(batch, count, 3, 3).transpose(1, 2)


def _features(frame: _Frame, points: Tensor, nodes: int, generator: torch.Generator) -> Features:
    seen = torch.einsum("bvij,bnj->bvni", frame.rotation, points).flatten(0, 1)
    distance, known = frame.distance.flatten(0, 1), frame.known.flatten(0, 1)
    # Some cells of the foreground, at random places in them.
    inside = ((distance < 0.3 * CELL) & (known > 0.5)).flatten(1).to(distance)
    drawn = torch.rand(inside.shape, generator=generator).to(inside) + inside
    cells = drawn.topk(int(CELLS), 1, sorted=False).indices
    grid = torch.stack([cells % GRID, cells // GRID], -1).to(distance) + 0.5
    jitter = torch.rand(grid.shape, generator=generator).to(grid) - 0.5
    places = (grid + 0.8 * jitter) * CELL - HALF
    counted = torch.gather(inside, 1, cells)
    counted = counted * (TORCH.sampled(distance[:, None], places / HALF)[..., 0] < 0.0)
    return features(TORCH, seen, nodes, frame.closeness.flatten(), distance, known, places, counted)


def _interpolation(points: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
    """[B, M, k] the nodes nearest to each point, and their weights: `falling_weights` in torch."""
    index = _nearest_nodes(points, nodes)
    near = TORCH.rows(points, index.flatten(1)).unflatten(1, index.shape[1:])
    distance = (points[:, :, None] - near).norm(dim=-1)
    share = distance / distance[..., -1:].clamp_min(1e-9)
    weights = (1.0 - share.square()).square() + 1e-6
    return index, weights / weights.sum(-1, keepdim=True)


def _nearest_nodes(points: Tensor, nodes: int) -> Tensor:
    """[B, M, k], in order of increasing distance."""
    distance = torch.cdist(points, points[:, :nodes])
    return distance.topk(INTERPOLATED_FROM, dim=2, largest=False).indices


def _chamfer(moved: Tensor, target: Tensor, some: Tensor, others: Tensor) -> Tensor:
    """[B, V]: Chamfer distance of ``moved`` [B, V, M, 3] and ``target`` [B, T, 3], by ``some``."""
    batch, variants = moved.shape[:2]
    flat = moved.flatten(0, 1)
    repeated = target[:, None].expand(-1, variants, -1, -1).flatten(0, 1)
    part, aim = flat[:, some], repeated[:, others]
    with torch.no_grad():
        forth = TORCH.nearest(part, repeated)
        back = TORCH.nearest(aim, flat)
    there = (part - TORCH.rows(repeated, forth)).square().sum(-1).mean(1)
    here = (aim - TORCH.rows(flat, back)).square().sum(-1).mean(1)
    return (there + here).unflatten(0, (batch, variants))
