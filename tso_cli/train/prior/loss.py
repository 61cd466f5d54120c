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
    NODES,
    Features,
    Sight,
    features,
)
from ...prior.network import TROUBLES, Answers, fused, predict
from ...prior.torch_backend import TORCH, nearest_few_in_rows
from .frame import StartFrame

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
# A right start is held to its own points, where they belong, by this share of its loss. Between two
# samplings of a shape the Chamfer distance hides small steps.
OF_COUNTERPARTS, SMALLEST_SQUARE = 0.7, 1e-4
# Shares of the loss of all but the error that is left.
OF_FOREIGN_POINTS, OF_VARIANCES, OF_CELLS, OF_TROUBLES = 0.05, 0.02, 3.0, 0.3
# The deviation whose logarithm of a weight is 0.
DEVIATION = 0.02


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the network makes of a batch, in the frames of the starts.

    points : [B, M, 3], where the starts are when the network is asked. target, counterpart, own :
        see `Batch`; own is 1 for points of the object.
    result : [B, 3, M, 3], moved as the first view, the second view and both ask for.
    left : [B, 3], Chamfer distance after it, divided by that of the start.
    answers : of the nodes, for [B * V] views.
    """

    frame: StartFrame
    points: Tensor
    target: Tensor
    counterpart: Tensor
    own: Tensor
    result: Tensor
    left: Tensor
    answers: Answers


def outcome(
    weights: Mapping[str, Tensor],
    batch: Batch,
    generator: torch.Generator,
    precision: str = "float32",
    second_pass: float = SECOND_PASS,
) -> Outcome:
    """What the network makes of a batch; it first moves a share of the starts itself."""
    frame = StartFrame.of(batch)
    points = start = frame.points(batch.start)
    ask = partial(_ask, weights, generator=generator, precision=precision)
    if second := round(second_pass * len(points)):
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
    after = _chamfer(result, target, some, others, own)
    left = after / before.clamp_min(FLOOR)
    return Outcome(frame, points, target, counterpart, own, result, left, asked_for.answers)


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
    came = outcome(weights, batch, generator, precision)
    points, own, counterpart = came.points, came.own, came.counterpart
    known = ~counterpart.isnan().any(-1) & (own > 0.0)  # [B, M]
    step = torch.where(known[..., None], counterpart - points, 0.0)
    moves = came.result - points[:, None]
    apart = (moves - step[:, None]).square().sum(-1) * known[:, None]
    of_step = step.square().sum((1, 2)) / known.sum(1).clamp_min(1) + SMALLEST_SQUARE
    off = apart.sum(-1) / known.sum(1).clamp_min(1)[:, None] / of_step[:, None]
    left = came.left.clamp_max(MOST)
    held = (1.0 - OF_COUNTERPARTS) * left + OF_COUNTERPARTS * off.clamp_max(MOST)
    right = batch.troubles[:, 0, TROUBLES.index("shape")] == 0.0
    moved = torch.where(right[:, None], held, left)
    foreign = moves.square().sum(-1) * batch.foreign_points[:, None]
    foreign = foreign.sum(-1) / batch.foreign_points.sum(1).clamp_min(1.0)[:, None]
    moved = moved + OF_FOREIGN_POINTS * (foreign / FLOOR).clamp_max(MOST)
    # A view of something else says nothing; both views together should know.
    related = 1.0 - batch.troubles[..., TROUBLES.index("unrelated")]
    counts = torch.cat([related, torch.ones_like(related[:, :1])], 1)
    troubles = functional.binary_cross_entropy_with_logits(
        came.answers.troubles, batch.troubles.flatten(0, 1)
    )
    return torch.stack(
        [
            (moved * counts).sum() / counts.sum(),
            OF_VARIANCES * _variances(came),
            OF_CELLS * _cells(came.frame, came.answers.cells),
            OF_TROUBLES * troubles,
        ]
    )


def _variances(came: Outcome) -> Tensor:
    """Negative log-likelihood of what is left at the nodes, by the variances that are said.

    What is left at a node is the way to its counterpart, or else to the nearest point of the truth.
    """
    rotation, said = came.frame.rotation, came.answers
    nodes = said.displacements.shape[1]
    moved = torch.einsum("bvij,bnj->bvni", rotation, came.points[:, :nodes]).flatten(0, 1)
    moved = moved + said.displacements.detach()
    truth, known = (
        torch.einsum("bvij,bnj->bvni", rotation, cloud).flatten(0, 1)
        for cloud in (came.target, came.counterpart[:, :nodes])
    )
    nearest = TORCH.rows(truth, TORCH.nearest(moved, truth))
    left = torch.where(known.isnan(), nearest, known) - moved
    of_axes = (left / DEVIATION).square() * said.log_weights.exp() - said.log_weights
    weight = came.own[:, None, :nodes].expand(-1, rotation.shape[1], -1).flatten(0, 1)
    return 0.5 * (of_axes.sum(-1) * weight).sum() / weight.sum().clamp_min(1.0)


def _cells(frame: StartFrame, said: Tensor) -> Tensor:
    """Cross entropy of what cells show, where the picture is."""
    truth = torch.stack([frame.foreign, frame.hidden], 2).flatten(0, 1)
    weight = frame.known.flatten(0, 1)[:, None]
    entropy = functional.binary_cross_entropy_with_logits(said, truth, reduction="none")
    return (entropy * weight).sum() / weight.sum() / said.shape[1]


@dataclass(frozen=True, eq=False)
class _Asked:
    """displacements : [B, 3, M, 3]: as the first view, the second view and both ask for, in axes of
    the cloud. answers : of the nodes, for [B * V] views.
    """

    displacements: Tensor
    answers: Answers


def _ask(
    weights: Mapping[str, Tensor],
    frame: StartFrame,
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


def _features(
    frame: StartFrame, points: Tensor, nodes: int, generator: torch.Generator
) -> Features:
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
    index = nearest_few_in_rows(points, points[:, :nodes], INTERPOLATED_FROM)
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
