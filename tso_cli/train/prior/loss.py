"""The loss of a learned prior: how far its displacements leave a start from the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
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
    Sight,
    features,
    front_of,
)
from ...prior.network import TROUBLES, Answers, fused, predict
from ...prior.torch_backend import TORCH, nearest_few
from .masks import HALF_SIDE

if TYPE_CHECKING:
    from .starts import Batch

PARTS = ("moves", "variances", "cells", "troubles")
# This share of a batch is first moved by the network itself, so that it learns its second pass.
SECOND_PASS = 0.4
# With half as many nodes a step takes a fifth less time.
FEW_NODES_CHANCE = 0.6
# Points of the start, and of the truth, that are compared in one step.
COMPARED = 128
# Chamfer distance of two samplings of one shape, by so few points; it can never be undone.
FLOOR = 0.5e-3
# No start counts for more than this many times its own error.
MOST = 6.0
# A start whose points are known at the truth is held to them by this share of its loss. Between two
# samplings of a shape the Chamfer distance hides small steps.
OF_COUNTERPARTS, SMALLEST_SQUARE = 0.7, 1e-4
# Shares of the loss of all but the error that is left.
OF_FOREIGN_POINTS, OF_VARIANCES, OF_CELLS, OF_TROUBLES = 0.05, 0.02, 3.0, 0.3
# The deviation whose logarithm of a weight is 0.
DEVIATION = 0.02
# Of the robust line: rounds; fewer common cells than these are not fitted.
FIT_ROUNDS, FEWEST_CELLS = 6, 12


def loss(
    weights: Mapping[str, Tensor],
    batch: Batch,
    generator: torch.Generator,
    precision: str = "float32",
) -> Tensor:
    """The parts of the loss, by the names of `PARTS`; their sum is the loss.

    The first is the mean over starts of the error that is left, divided by the error of the start.
    Each start is moved as its first view, its second view, and both together ask for. The others
    are of what the network says of variances, of the cells of the masks, and of troubles.
    """
    frame = _Frame.of(batch)
    points = start = frame.points(batch.start)
    ask = partial(_ask, weights, generator=generator, precision=precision)
    if second := round(SECOND_PASS * len(points)):
        first = points[:second]
        with torch.no_grad():
            steps = ask(frame.part(second), first, first).displacements
            # In use there may be one view or several.
            asked = torch.randint(steps.shape[1], (second,), generator=generator)
            step = steps[torch.arange(second), asked.to(steps.device)]
        points = torch.cat([first + step, points[second:]])
    target = frame.points(batch.target)
    counterpart = frame.points(batch.counterpart)
    asked_for = ask(frame, start, points)
    result = points[:, None] + asked_for.displacements
    some = torch.randperm(points.shape[1], generator=generator)[:COMPARED].to(points.device)
    others = torch.randperm(target.shape[1], generator=generator)[:COMPARED].to(points.device)
    own = 1.0 - batch.foreign_points
    before = _chamfer(points[:, None], target, some, others, own)
    left = (_chamfer(result, target, some, others, own) / before.clamp_min(FLOOR)).clamp_max(
        MOST
    )  # [B, 3]
    known = ~counterpart.isnan().any(-1) & (own > 0.0)  # [B, M]
    step = torch.where(known[..., None], counterpart - points, 0.0)
    apart = (result - points[:, None] - step[:, None]).square().sum(-1) * known[:, None]
    of_step = step.square().sum((1, 2)) / known.sum(1).clamp_min(1) + SMALLEST_SQUARE
    off = apart.sum(-1) / known.sum(1).clamp_min(1)[:, None] / of_step[:, None]
    held = (1.0 - OF_COUNTERPARTS) * left + OF_COUNTERPARTS * off.clamp_max(MOST)
    moved = torch.where(known.any(1)[:, None], held, left)
    foreign = (result - points[:, None]).square().sum(-1) * batch.foreign_points[:, None]
    foreign = foreign.sum(-1) / batch.foreign_points.sum(1).clamp_min(1.0)[:, None]
    moved = moved + OF_FOREIGN_POINTS * (foreign / FLOOR).clamp_max(MOST)
    # A view of something else says nothing; both views together should know.
    related = 1.0 - batch.troubles[..., TROUBLES.index("unrelated")]
    counts = torch.cat([related, torch.ones_like(related[:, :1])], 1)
    said = asked_for.answers
    troubles = functional.binary_cross_entropy_with_logits(
        said.troubles, batch.troubles.flatten(0, 1)
    )
    return torch.stack(
        [
            (moved * counts).sum() / counts.sum(),
            OF_VARIANCES * _variances(frame, points, said, target, counterpart, own),
            OF_CELLS * _cells(frame, said.cells),
            OF_TROUBLES * troubles,
        ]
    )


def _variances(
    frame: _Frame,
    points: Tensor,
    said: Answers,
    target: Tensor,
    counterpart: Tensor,
    own: Tensor,
) -> Tensor:
    """Negative log-likelihood of what is left at the nodes, by the variances that are said.

    What is left at a node is the way to its counterpart, or else to the nearest point of the truth.
    """
    nodes = said.displacements.shape[1]
    moved = torch.einsum("bvij,bnj->bvni", frame.rotation, points[:, :nodes]).flatten(0, 1)
    moved = moved + said.displacements.detach()
    truth, known = (
        torch.einsum("bvij,bnj->bvni", frame.rotation, cloud).flatten(0, 1)
        for cloud in (target, counterpart[:, :nodes])
    )
    nearest = TORCH.rows(truth, TORCH.nearest(moved, truth))
    left = torch.where(known.isnan(), nearest, known) - moved
    of_axes = (left / DEVIATION).square() * said.log_weights.exp() - said.log_weights
    weight = own[:, None, :nodes].expand(-1, frame.rotation.shape[1], -1).flatten(0, 1)
    return 0.5 * (of_axes.sum(-1) * weight).sum() / weight.sum().clamp_min(1.0)


def _cells(frame: _Frame, said: Tensor) -> Tensor:
    """Cross entropy of what cells show, where the picture is."""
    truth = torch.stack([frame.foreign, frame.hidden], 2).flatten(0, 1)
    weight = frame.known.flatten(0, 1)[:, None]
    entropy = functional.binary_cross_entropy_with_logits(said, truth, reduction="none")
    return (entropy * weight).sum() / weight.sum() / said.shape[1]


class _Frame:
    """What the views show, for starts that are centred and scaled to longest side 1.

    rotation [B, V, 3, 3]; closeness, metric and size [B, V]; the maps [B, V, GRID, GRID].
    """

    def __init__(self, centre: Tensor, scale: Tensor, views: dict[str, Tensor]) -> None:
        self.centre, self.scale, self.views = centre, scale, views
        self.rotation, self.closeness = views["rotation"], views["closeness"]
        self.distance, self.known = views["distance"], views["known"]
        self.foreign, self.hidden = views["foreign"], views["hidden"]

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

    def part(self, count: int) -> _Frame:
        """Of the first starts."""
        views = {name: value[:count] for name, value in self.views.items()}
        return _Frame(self.centre[:count], self.scale[:count], views)


def _fit_depths(frame: _Frame, start: Tensor) -> None:
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


@dataclass(frozen=True, eq=False)
class _Asked:
    """displacements : [B, 3, M, 3]: as the first view, the second view and both ask for, in axes of
    the cloud. answers : of the nodes, for [B * V] views.
    """

    displacements: Tensor
    answers: Answers


def _ask(
    weights: Mapping[str, Tensor],
    frame: _Frame,
    start: Tensor,
    points: Tensor,
    generator: torch.Generator,
    precision: str,
) -> _Asked:
    """What the network answers; ``points`` [B, M, 3] is where the ``start`` has got to."""
    batch, count = points.shape[:2]
    few = float(torch.rand((), generator=generator)) < FEW_NODES_CHANCE
    nodes = min(NODES // 2 if few else NODES, count)
    with torch.no_grad():
        given = _features(frame, points, nodes, generator)
        index, share = _interpolation(start, nodes)
    with torch.autocast(points.device.type, torch.bfloat16, enabled=precision == "bfloat16"):
        said = predict(TORCH, weights, given)
    said = Answers(**{name: value.to(points.dtype) for name, value in vars(said).items()})
    displacements, log_weights = (
        values.unflatten(0, (batch, 2)) for values in (said.displacements, said.log_weights)
    )
    both = fused(TORCH, displacements, log_weights, frame.rotation)
    alone = torch.einsum("bvij,bvni->bvnj", frame.rotation, displacements)
    of_nodes = torch.cat([alone, both[:, None]], 1).permute(0, 2, 1, 3).flatten(2)  # [B, N, 9]
    near = TORCH.rows(of_nodes, index.flatten(1)).view(batch, count, INTERPOLATED_FROM, 9)
    moved = (near * share[..., None]).sum(2).view(batch, count, 3, 3).transpose(1, 2)
    return _Asked(moved, said)


def _features(frame: _Frame, points: Tensor, nodes: int, generator: torch.Generator) -> Features:
    seen = torch.einsum("bvij,bnj->bvni", frame.rotation, points).flatten(0, 1)
    flat = {name: value.flatten(0, 1) for name, value in frame.views.items()}
    distance, known = flat["distance"], flat["known"]
    # Some cells of the foreground, evenly spread over all of them, at random places in them.
    inside = ((distance < 0.3 * CELL) & (known > 0.5)).flatten(1).to(distance)
    total = inside.cumsum(1)
    shape = (len(inside), int(CELLS))
    share = (torch.arange(shape[1]) + torch.rand(shape, generator=generator)) / shape[1]
    cells = torch.searchsorted(total, share.to(total) * total[:, -1:], right=True)
    cells = cells.clamp_max(GRID * GRID - 1)
    grid = torch.stack([cells % GRID, cells // GRID], -1).to(distance) + 0.5
    jitter = torch.rand(grid.shape, generator=generator).to(grid) - 0.5
    places = (grid + 0.8 * jitter) * CELL - HALF
    counted = torch.gather(inside, 1, cells)
    counted = counted * (TORCH.sampled(distance[:, None], places / HALF)[..., 0] < 0.0)
    names = ("closeness", "distance", "known", "depth", "measured", "metric", "size")
    sight = Sight(cells=places, counted=counted, **{name: flat[name] for name in names})
    return features(TORCH, seen, nodes, sight)


def _interpolation(points: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
    """[B, M, k] the nodes nearest to each point, and their weights: `falling_weights` in torch."""
    index = nearest_few(points, points[:, :nodes], INTERPOLATED_FROM)
    near = TORCH.rows(points, index.flatten(1)).unflatten(1, index.shape[1:])
    distance = (points[:, :, None] - near).norm(dim=-1)
    share = distance / distance[..., -1:].clamp_min(1e-9)
    weights = (1.0 - share.square()).square() + 1e-6
    return index, weights / weights.sum(-1, keepdim=True)


def _chamfer(moved: Tensor, target: Tensor, some: Tensor, others: Tensor, own: Tensor) -> Tensor:
    """[B, V]: Chamfer distance of ``moved`` [B, V, M, 3] and ``target`` [B, T, 3], by ``some``.

    Points count by ``own`` [B, M] on their way to the target.
    """
    batch, variants = moved.shape[:2]
    flat = moved.flatten(0, 1)
    repeated = target[:, None].expand(-1, variants, -1, -1).flatten(0, 1)
    part, aim = flat[:, some], repeated[:, others]
    with torch.no_grad():
        forth = TORCH.nearest(part, repeated)
        back = TORCH.nearest(aim, flat)
    weight = own[:, None, some].expand(-1, variants, -1).flatten(0, 1)
    there = (part - TORCH.rows(repeated, forth)).square().sum(-1)
    there = (there * weight).sum(1) / weight.sum(1).clamp_min(1.0)
    here = (aim - TORCH.rows(flat, back)).square().sum(-1).mean(1)
    return (there + here).unflatten(0, (batch, variants))
