"""The preset "best": pulled by the mask, held by the start, and points from coarse to fine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..silhouette.mask_chamfer import REFERENCE_POINTS
from .adam import Adam, UniformAdam
from .objective import MaskChamferObjective
from .optimise import Descent, Objective, Progress, descend
from .photometric import PhotometricLoss
from .smooth_field import NODES, SmoothField


@dataclass(frozen=True)
class Stage:
    """An equal part of the steps.

    Parameters
    ----------
    smoothness : lambda of `SmoothField`. reach : of `mask_chamfer_loss`, px.
    pace : share of the learning rate. nodes : of the field.
    share : of its best iterate in the result, a mean over the stages.
    blur : of `PhotometricLoss.look`, px.
    finest : on the grid of `finest_grid` cells a side in place of 64. Lengths stay stated in
        64ths of the window.
    """

    smoothness: float
    reach: float
    pace: float
    nodes: int = NODES
    share: float = 1.0
    blur: float = 0.5
    finest: bool = False


# First the cloud moves nearly as a whole and hears of pixels far away, at last almost point by point and of near ones only.
# What the stages disagree on is about as often wrong as right: their mean is about as near to the truth as the last, and more
# seldom further from it than the start.
STAGES = (
    Stage(100.0, 6.0, 1.0, 256, 1.0, 2.0),
    Stage(10.0, 3.0, 0.75, 512, 2.0, 1.0),
    Stage(1.0, 3.0, 0.35, NODES, 3.0, finest=True),
)
ANCHOR_REACH = 4.0
# A part of the cloud is off on its own where the mean cost of its pixels is over this, px^2 of a window of 64; the smoothness
# of that mean, as of a stage.
LOCAL_FROM, LOCAL_SMOOTHNESS = 1.0, 1.0


@dataclass(frozen=True)
class CoarseToFineConfig:
    """What the preset is made of; a study changes one ingredient at a time.

    Parameters
    ----------
    stages : share the steps evenly, in this order; their shares of the result are those of one picture.
    anchor : what it costs a point to leave its start, squared distance (longest side 1), for a start whose mask pixels are
        e = 1 px^2 off on average. A start that is further off is trusted less, anchor / e^decay; ``least_anchor``, for one
        picture, and ``most_anchor`` bound it.
    by_area : whether points hold by the surface that they stand for, or all alike.
    cut : how many times as much it costs all points of an object that no view shows whole.
    unseen : how far those of them move that no view shows, beyond the borders, in units of how far the field would take them.
    optimiser : of every stage. looks : whether parts that pixels do not show are left alone.
    weighs : whether views count for less that others contradict or repeat, or all in full.
    local : whether what is off in one place is held less there, however right the rest is.
    """

    stages: tuple[Stage, ...] = STAGES
    anchor: float = 300.0
    decay: float = 1.0
    least_anchor: float = 200.0
    most_anchor: float = 3000.0
    by_area: bool = True
    cut: float = 3.0
    unseen: float = 0.1
    optimiser: type[Adam] | type[UniformAdam] = UniformAdam
    looks: bool = True
    weighs: bool = True
    local: bool = False


BEST = CoarseToFineConfig(local=True)
# Of the modes that move a network: its weights take many points along anyway, and where its prediction is far off the picture
# it has mistaken the shape, which no small change of weights puts right.
NETWORK = CoarseToFineConfig(stages=(Stage(0.0, 3.0, 1.0),), anchor=500.0, decay=0.5, least_anchor=30.0)


def mask_chamfer_with_prior(
    first: Tensor, counts: Tensor, pull: MaskChamferObjective, config: CoarseToFineConfig = NETWORK
) -> Objective:
    """The pull of the masks and what it costs to leave the start, for B clouds ``first`` [B, N, 3] of ``counts`` [B] points."""
    field = SmoothField(first, counts)
    anchors = prior_weights(first, counts, pull, field, config)
    pull.look(first, field)
    (stage,) = config.stages

    def objective(moved: Tensor) -> Tensor:
        return pull(moved, stage.reach) + cost(moved, first, anchors)

    return objective


def prior_weights(
    first: Tensor,
    counts: Tensor,
    pull: MaskChamferObjective,
    field: SmoothField,
    config: CoarseToFineConfig,
    pictures: Tensor | None = None,
) -> Tensor:
    """[B, N] what the square of a point's way from its start costs; ``pictures`` as in `coarse_to_fine_descent`."""
    off = (pull(first, ANCHOR_REACH) / pull.pixels).unsqueeze(1)
    if config.local:
        each = pull.of_points(first, ANCHOR_REACH) * (counts.to(first) / pull.pixels).unsqueeze(1)
        around = field.averaged(each, LOCAL_SMOOTHNESS)
        off = torch.maximum(off, torch.where(around > LOCAL_FROM, around, 0.0))
    # What one picture leaves open others tell: the start is needed less.
    least = (config.least_anchor / _squared(pictures, first)).unsqueeze(1)
    trusted = torch.maximum((config.anchor / off**config.decay).clamp_max(config.most_anchor), least)
    each = trusted * (REFERENCE_POINTS / counts).to(first).unsqueeze(1)
    # What holds a piece of surface is as strong where points are few as where they are many.
    areas = field.areas(first, counts) if config.by_area else torch.ones_like(first[..., 0])
    each = torch.where(pull.cut.unsqueeze(1), config.cut * each, each)
    return each * areas


def _squared(pictures: Tensor | None, like: Tensor) -> Tensor:
    return torch.ones_like(like[:, 0, 0]) if pictures is None else pictures.to(like).square()


def cost(moved: Tensor, first: Tensor, anchors: Tensor) -> Tensor:
    """[B] of leaving the start."""
    return (anchors * (moved - first).square().sum(2)).sum(1)


def coarse_to_fine_descent(
    first: Tensor,
    counts: Tensor,
    pull_at: Callable[[Tensor, bool], MaskChamferObjective],
    further: Objective | None,
    steps: int,
    learning_rate: float,
    progress: Progress | None = None,
    config: CoarseToFineConfig = BEST,
    fields: dict[int, SmoothField] | None = None,
    colours: PhotometricLoss | None = None,
    pictures: Tensor | None = None,
) -> Descent:
    """Move B clouds by smooth fields.

    Parameters
    ----------
    first : [B, N, 3] normalised; counts : [B].
    pull_at : the pull of the masks, seen in windows that suit the clouds [B, N, 3] it is given,
        on the finest grids or on those of 64 cells. further : another term, or None.
    steps : of all stages together.
    learning_rate : about how far the node that is pulled hardest moves in one of the first steps.
    config : what else the descent is made of.
    fields : those of ``first`` by their nodes, as far as they are known; further ones are added.
    colours : of the one cloud, None where no image asks for them.
    pictures : [B] how much each goes by, `Problem.pictures`; None for one mask. The more there
        are the less is the last stage's detail a guess: its share of the result grows with their square.

    Returns
    -------
    Descent; ``best`` is the mean of every stage's best, by their shares, or the start where that has the lower loss by the last
    objective.
    """
    pull = pull_at(first, False)
    if pictures is not None:
        # What is cut off in all of them is as unknown with many as with one.
        pictures = torch.where(pull.cut.to(pictures.device), 1.0, pictures)
    stages = config.stages
    fields = {} if fields is None else fields
    for nodes in {stage.nodes for stage in stages} - fields.keys():
        fields[nodes] = SmoothField(first, counts, nodes)
    finest = fields[max(stage.nodes for stage in stages)]
    anchors = prior_weights(first, counts, pull, finest, config, pictures)
    followed = torch.where(pull.asked(first), 1.0, config.unseen).to(first).unsqueeze(-1)

    def objective(moved: Tensor) -> Tensor:
        loss = pull(moved, stage.reach) + cost(moved, first, anchors)
        if colours:
            loss = loss + colours(moved)
        return loss + further(moved) if further else loss

    parts, done, found = [], 0, first
    ends = [round(steps * (i + 1) / len(stages)) for i in range(len(stages))]
    for stage, end in zip(stages, ends, strict=True):
        field = fields[stage.nodes]
        seen_before, pull = pull, pull_at(found, stage.finest)
        if pull is not seen_before:
            anchors = prior_weights(first, counts, pull, finest, config, pictures)
        if config.looks:
            pull.look(found, finest)
        if colours:
            colours.look(found, stage.blur)
        smoother = field.smoother(stage.smoothness)
        moving = torch.zeros(field.shape, dtype=first.dtype, device=first.device, requires_grad=True)

        def produce(
            base: Tensor = found, field: SmoothField = field, smoother: Tensor = smoother, moving: Tensor = moving
        ) -> Tensor:
            return base + followed * field.displacement(smoother, moving)

        def told(step: int, steps_here: int, loss: float, before: int = done) -> None:
            assert progress is not None
            progress(before + step, steps, loss)

        rate = stage.pace * learning_rate
        part = descend(produce, [moving], objective, end - done, rate, told if progress else None, config.optimiser)
        parts.append(part)
        found, done = part.best, end
        if part.interrupted:
            break
    shares = [torch.full_like(first[:, 0, 0], stage.share) for stage in stages]
    shares[-1] = shares[-1] * _squared(pictures, first)
    return _joined(parts, torch.stack(shares[: len(parts)]), first, objective)


def _joined(parts: list[Descent], shares: Tensor, first: Tensor, objective: Objective) -> Descent:
    """The whole way, and the mean of what its P parts came to, by their ``shares`` [P, B], judged by the last objective."""
    last = parts[-1]
    # Of ways from the start: what nothing moved keeps every bit.
    ways = torch.stack([part.best - first for part in parts])
    mean = first + ((shares / shares.sum(0)).view(*shares.shape, 1, 1) * ways).sum(0)
    with torch.no_grad():
        at_start, at_mean = objective(first).double(), objective(mean).double()
    better = at_mean < at_start
    before = sum(len(part.losses) - 1 for part in parts[:-1])
    losses = np.concatenate([parts[0].losses, *(part.losses[1:] for part in parts[1:])])
    return Descent(
        torch.where(better.view(-1, 1, 1), mean, first),
        np.where(better.cpu().numpy(), last.best_step + before, 0),
        losses,
        last.interrupted,
        at_start.cpu().numpy(),
        torch.where(better, at_mean, at_start).cpu().numpy(),
    )
