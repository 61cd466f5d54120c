"""Where the optimisation begins: the start of a cloud, moved by the learned prior."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..cloud.smooth_field import SmoothField
from ..geometry.arrays import Array
from ..losses.projection import project_differentiably
from ..prior import Frame, LearnedPrior, SeenCloud, Shown
from .objective import MaskChamferObjective, ViewTargets
from .position_prior import START_ROBUST_SCALE, start_loss
from .problem import Problem

# How often the network looks at the cloud; each time it sees where the cloud has got to.
PASSES = 2
# The root mean square of the first step, in longest sides: a start that is right is asked to move
# by less than the first, another shape by more than the second. Between them the step is scaled.
RIGHT, OTHER = 0.003, 0.006
# A start that fits its masks, by its mean loss in px^2 per mask pixel, moves half as far as one
# that does not: it gains less, and loses as much where the prior is wrong.
FITS, FITS_NOT = 0.5, 2.0
LEAST_SHARE = 0.5
# With this lambda of `SmoothField` the prior's step fades out where pictures end.
OBSERVED_SMOOTHNESS = 5.0


@dataclass(frozen=True, eq=False)
class Beginning:
    """Where an optimisation begins.

    points : [N, 3].
    rightness : in [0, 1], how far the learned prior finds that the start is right already; 0
        without an answer of the learned prior.
    sureness : of its first answer, `Answer.sureness`; None without one.
    """

    points: Array
    rightness: float = 0.0
    sureness: float | None = None


def beginning(
    problem: Problem, weights: Sequence[float], field: SmoothField, prior: LearnedPrior
) -> Beginning:
    """The start of the ``problem``, moved as the ``prior`` asks for where the masks agree.

    ``weights`` are of the given views; ``field`` is of the start.
    """
    start = problem.cloud.start
    targets, frame = problem.targets(weights), Frame.of(start)
    shown = [
        Shown.of(view.camera, view.target, start, frame, weight)
        for view, weight in zip(problem.resampled, problem.all_weights(weights), strict=True)
        if weight > 0.0
    ]
    seen = SeenCloud(start, frame, [view for view in shown if view is not None])
    if not seen.views:
        return Beginning(start)
    resolvability = targets.resolvability(start, field)
    objective = MaskChamferObjective(targets, START_ROBUST_SCALE, resolvability)
    first = answer = seen.ask(prior, start)
    if first is None:
        return Beginning(start)
    observed = _observed(start, targets, field)
    asked_of = observed * first.displacements
    asked = float(np.sqrt(np.square(asked_of).sum(1).mean())) / frame.scale
    other = float(np.clip((asked - RIGHT) / (OTHER - RIGHT), 0.0, 1.0))
    taken = other * _share(start_loss(start, targets)) * observed
    points, lowest = start, objective(start)[0]
    for number in range(PASSES):
        if number:
            answer = seen.ask(prior, points)
        if answer is None:
            break
        moved = points + taken * answer.displacements
        loss = objective(moved)[0]
        if not loss < lowest:
            break
        points, lowest = moved, loss
    # A start that the masks find right may be wrong by a depth map or a photo.
    right = 1.0 - other if problem.masks_alone else 0.0
    return Beginning(points, right, first.sureness)


def _share(loss: float) -> float:
    """The share of a displacement that is taken, by the mean ``loss`` of the start."""
    misfit = math.log(max(loss, FITS) / FITS) / math.log(FITS_NOT / FITS)
    return LEAST_SHARE + (1.0 - LEAST_SHARE) * min(misfit, 1.0)


def _observed(start: Array, targets: ViewTargets, field: SmoothField) -> Array:
    """[N, 1] in [0, 1]: how far a picture shows the part around each point.

    Points beyond the borders of all pictures that truncate the object are not observed.
    """
    observed = np.zeros(len(start), bool)
    for view in targets.views:
        projected = project_differentiably(start, view.camera)
        observed |= view.mask.observed(projected.points_px, projected.valid)
    if observed.all():
        return np.ones((len(start), 1))
    at_nodes = observed[field.nodes, None].astype(float)
    share: Array = field.spread(field.smoothed(at_nodes, OBSERVED_SMOOTHNESS))
    return share
